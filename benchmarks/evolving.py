"""Fifty steps of smoothing in a row: does a field that follows its mesh remain one that can be evolved?

    python benchmarks/evolving.py [SHAPE] [--rate 1e-3] [--dt 0.02] [--steps 50] [--resolution 96] [-o evolving.png]

A field is fitted to a mesh, the armadillo of the meshes' folder by default, and follows the mean curvature flow of its
own surface, extracted anew in every step. The same flow of the first surface alone, without any field, is beside it.

Columns:
    time     of the flow
    gap      the mean distance of the field's surface from the mesh that the last step ended with, in half boxes
    apart    the mean distance of the field's surface from the mesh that was smoothed without a field, in half boxes
    area     of the field's surface, as a part of that at first
    slope    the mean of |grad f| on the surface, and the mean of its distance from 1
    rounds   of training since the line before
    s        seconds since the start of the evolution, and of the processor

Reference:
    Mehta et al., A Level Set Theory for Neural Implicit Evolution under Explicit Flows, ECCV 2022, Secs. 4 and 6.1.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import torch
from PIL import Image

from levelflow import SIREN, Budget, Camera, Mesh, contact_sheet, evolve, extract, fit, flows
from levelflow.curvature import gradient_norm
from levelflow.evolution import Step
from levelflow.measures import surface_distance

FOLDER = Path(os.environ.get("LEVELFLOW_MESHES", Path(__file__).parents[2] / "shared" / "meshes"))
SHOWN = 6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("shape", nargs="?", type=Path, default=FOLDER / "armadillo.obj")
    parser.add_argument("--rate", type=float, default=1e-3)
    parser.add_argument("--dt", type=float, default=0.02)
    parser.add_argument("--steps", type=int, default=50)
    parser.add_argument("--resolution", type=int, default=96)
    parser.add_argument("--fit", type=int, default=1200, help="steps of the fit")
    parser.add_argument("--azimuth", type=float, default=0.0)
    parser.add_argument("-o", "--output", type=Path, default=Path("evolving.png"))
    options = parser.parse_args()

    started = time.perf_counter()
    field = fit(SIREN(), Mesh.read(options.shape), budget=Budget(options.fit))
    half, seconds = field.box.frame.scale, time.perf_counter() - started
    first = extract(field, resolution=options.resolution, refine=2)
    print(
        f"{options.shape.name}, fitted in {seconds:.0f} s, {len(first.vertices)} vertices; rate {options.rate:g}, "
        f"{options.steps} steps of {options.dt:g}; {torch.get_num_threads()} threads, PyTorch {torch.__version__}"
    )
    print(f"{'time':>8}{'gap':>9}{'apart':>9}{'area':>8}{'slope':>15}{'rounds':>8}{'s':>12}", flush=True)
    flow = flows.MeanCurvature(options.rate)
    alone, meshes, labels, rounds = first, [first], ["t = 0"], 0
    started, used = time.perf_counter(), time.process_time()
    every = max(1, options.steps // (SHOWN - 1))

    def on_step(step: Step) -> None:
        nonlocal alone, rounds
        rounds += step.rounds
        for _ in range(4):
            alone = Mesh(alone.vertices + flow.displacement(alone, options.dt / 4, time=step.time), alone.faces)
        if step.number % every and step.number < options.steps:
            return
        seconds, processor = time.perf_counter() - started, time.process_time() - used
        surface = extract(step.field, resolution=options.resolution, refine=2)
        with torch.no_grad():
            slope = gradient_norm(step.field.jet(torch.from_numpy(surface.vertices.copy()), order=1))
        apart = surface_distance(surface, alone, n=20_000, generator=torch.Generator().manual_seed(0)).chamfer
        print(
            f"{step.time:>8.3g}{step.gap / half:>9.5f}{apart / half:>9.5f}{surface.area / first.area:>8.3f}"
            f"{float(slope.mean()):>8.3f}{float((slope - 1).abs().mean()):>7.3f}{rounds:>8}"
            f"{seconds:>6.0f}{processor:>6.0f}",
            flush=True,
        )
        rounds = 0
        meshes.append(surface)
        labels.append(f"t = {step.time:.2g}, {step.number} steps")

    evolve(field, flow, dt=options.dt, steps=options.steps, resolution=options.resolution, on_step=on_step)
    meshes.append(alone)
    labels.append("without a field")
    camera = Camera.around(first.vertices, azimuth=options.azimuth)
    picture = contact_sheet(meshes, labels, camera=camera, columns=4, size=240)
    Image.fromarray(picture).quantize(128).save(options.output, optimize=True)
    print(options.output)


if __name__ == "__main__":
    main()
