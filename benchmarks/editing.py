"""Edits by handles of real meshes: a field that follows, beside as-rigid-as-possible deformation by libigl.

    python benchmarks/editing.py [armadillo] [cactus] [dino] [--steps 8] [--resolution 96] [-o docs/editing.md]

A field is fitted to each mesh, its surface extracted, and a few handles are held, moved and turned. `blended`, `arap`
and `shell` are what `levelflow edit` does with `--rigid`: the field follows in `--steps` steps, and its surface is
extracted at the end. `libigl` deforms the first of these surfaces once, in as many steps of its handles, with
100 iterations for each; there is no field. Writes a table and a picture.

Columns:
    handles   how far the places where handles want the surface are from it, on average and at most, in half boxes
    volume    the change of the volume, in per cent
    edges     the mean of |log| of the change of the edges' lengths; of a field, those of the first surface as the way
              of deformation alone takes it there
    apart     the mean distance of the field's surface from that deformed surface, in half boxes
    s         seconds from the fitted field to the edited one, extraction included, and of the processor

References:
    Mehta et al., A Level Set Theory for Neural Implicit Evolution under Explicit Flows, ECCV 2022, Sec. 6.3;
    Sorkine, Alexa, As-Rigid-As-Possible Surface Modeling, SGP 2007.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import igl
import numpy as np
import torch
from PIL import Image

from levelflow import SIREN, Box, Budget, Camera, Mesh, Placed, contact_sheet, evolve, extract, fit, flows
from levelflow.handles import BoxRegion, Handle, SphereRegion
from levelflow.measures import surface_distance
from levelflow.shapes.writing import replace_file

FOLDER = Path(os.environ.get("LEVELFLOW_MESHES", Path(__file__).parents[2] / "shared" / "meshes"))
FAR = 9.0


@dataclass(frozen=True)
class Task:
    """An edit.

    Attributes:
        file: The mesh.
        handles: What is held and where it goes.
        words: The same in words.
        view: Azimuth, elevation and what is up in its picture.
    """

    file: str
    handles: Sequence[Handle]
    words: str
    view: tuple[float, float, tuple[float, float, float]]


def beyond(axis: int, value: float, *, above: bool) -> BoxRegion:
    """What lies on one side of a plane."""
    lower, upper = [-FAR] * 3, [FAR] * 3
    (lower if above else upper)[axis] = value
    return BoxRegion(Box(tuple(lower), tuple(upper)))


TASKS: Mapping[str, Task] = {
    "armadillo": Task(
        "armadillo.obj",
        (
            Handle.fix(beyond(1, -0.45, above=False), name="feet"),
            Handle.fix(BoxRegion(Box((-FAR, 0.0, -FAR), (-0.3, FAR, FAR))), name="right hand"),
            Handle.move(BoxRegion(Box((0.3, 0.0, -FAR), (FAR, FAR, FAR))), by=(-0.05, 0.25, 0.1), name="left hand"),
            Handle.rotate(
                SphereRegion((0.0, 0.25, -0.2), 0.12), angle=30, axis=(0, 1, 0), center=(0.0, 0.2, 0.0), name="snout"
            ),
        ),
        "feet and one hand held, the other hand raised by a quarter of the height, the snout turned by 30 degrees",
        (0.0, 15.0, (0.0, 1.0, 0.0)),
    ),
    "cactus": Task(
        "cactus_highres.off",
        (
            Handle.fix(beyond(2, 0.15, above=False), name="foot"),
            Handle.rotate(beyond(2, 0.82, above=True), angle=60, axis=(1, 0, 0), center=(0.5, 0.5, 0.45), name="top"),
        ),
        "the foot held, the top turned by 60 degrees",
        (90.0, 10.0, (0.0, 0.0, 1.0)),
    ),
    "dino": Task(
        "dino.off",
        (
            Handle.fix(beyond(2, 0.28, above=True), name="feet"),
            Handle.fix(beyond(0, 0.45, above=True), name="tail"),
            Handle.move(BoxRegion(Box((-FAR,) * 3, (-0.2, FAR, -0.32))), by=(0.1, 0.0, -0.15), name="head"),
        ),
        "feet and the end of the tail held, the head raised by 0.15 and taken back by 0.1",
        (0.0, 15.0, (0.0, 0.0, -1.0)),
    ),
}
WAYS: Mapping[str, Callable[[], flows.Densify]] = {
    "blended": flows.BlendedMotions,
    "arap": flows.AsRigidAsPossible,
    "shell": flows.ThinShell,
}


def by_libigl(edit: flows.Edit, steps: int) -> Mesh:
    """The surface after the edit by libigl's ARAP, each step of the handles from where the last one ended."""
    surface = edit.surface
    pulls = edit.pulls(surface, 0.0, 1.0)
    held = np.concatenate([pull.vertices for pull in pulls]).astype(np.int32)
    data = igl.ARAPData()
    data.max_iter = 100
    igl.arap_precomputation(surface.vertices, surface.faces, 3, held, data)
    x = surface.vertices.copy()
    for step in range(1, steps + 1):
        part = edit.pulls(surface, 0.0, step / steps)
        wanted = np.concatenate([pull.carry(surface.vertices[pull.vertices]) for pull in part])
        x = igl.arap_solve(wanted, data, x)
    return Mesh(x, surface.faces)


def judged(edit: flows.Edit, after: Mesh, deformed: Mesh, half: float, seconds: float, processor: float) -> str:
    """A line of the table."""
    error, change = flows.handle_error(edit, after), flows.volume_change(edit.surface, after)
    apart = "" if after is deformed else f"{_apart(after, deformed) / half:.5f}"
    return (
        f"{error.mean / half:.5f}, {error.max / half:.4f} | {100 * change:+.2f} | "
        f"{flows.edge_distortion(edit.surface, deformed):.4f} | {apart} | {seconds:.0f}, {processor:.0f}"
    )


def _apart(a: Mesh, b: Mesh) -> float:
    return surface_distance(a, b, n=20_000, generator=torch.Generator().manual_seed(0)).chamfer


def edited(field: Placed, edit: flows.Edit, *, steps: int, resolution: int) -> Mesh:
    """The surface of the field after it has followed an edit."""
    room = Box.around(edit.deformed(steps=steps).vertices)
    box = field.box.union(room).expanded(0.125 * max(field.box.size))
    found = evolve(field, edit, dt=1 / steps, steps=steps, box=box, resolution=resolution, substeps=1, remesh=False)
    return extract(found.at(1.0), resolution=resolution, refine=2)


def rows(name: str, options: argparse.Namespace) -> tuple[list[str], list[Mesh], list[str]]:
    """The lines of one edit, and its pictures."""
    task = TASKS[name]
    started = time.perf_counter()
    field = fit(SIREN(), Mesh.read(FOLDER / task.file), budget=Budget(options.fit))
    half = field.box.frame.scale
    surface = extract(field, resolution=options.resolution, refine=2)
    lines = [
        f"**{name}**, {task.words}; {len(surface.vertices):,} vertices, fitted in "
        f"{time.perf_counter() - started:.0f} s | | | | |"
    ]
    meshes, labels = [surface], [name]
    for way in options.ways:
        started, used = time.perf_counter(), time.process_time()
        edit = flows.Edit(surface, task.handles, densify=WAYS.get(way, flows.BlendedMotions)())
        if way == "libigl":
            after = deformed = by_libigl(edit, options.steps)
        else:
            after = edited(field, edit, steps=options.steps, resolution=options.resolution)
        seconds, processor = time.perf_counter() - started, time.process_time() - used
        if way != "libigl":
            deformed = edit.deformed(steps=options.steps)
        lines.append(f"{way} | {judged(edit, after, deformed, half, seconds, processor)}")
        print(f"{name}: {lines[-1]}", flush=True)
        meshes.append(after)
        labels.append(way)
    return lines, meshes, labels


def document(lines: Sequence[str], picture: str, options: argparse.Namespace) -> str:
    """The page that is written."""
    head = f"""# Edits by handles

Made by `python benchmarks/editing.py`, which explains the columns; do not edit. Lengths are in half boxes.
{options.steps} steps, cells of 1/{options.resolution} of the box, {torch.get_num_threads()} threads, PyTorch
{torch.__version__}.

![Edits by handles]({picture})

| way | handles: mean, max | volume, % | edges | apart | s: wall, processor |
|---|---|---|---|---|---|
"""
    return head + "".join(f"| {line} |\n" for line in lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=[], metavar="NAME", help=f"all by default: {', '.join(TASKS)}")
    parser.add_argument("--ways", nargs="*", choices=[*WAYS, "libigl"], default=["blended", "arap", "libigl"])
    parser.add_argument("--steps", type=int, default=8)
    parser.add_argument("--resolution", type=int, default=96)
    parser.add_argument("--fit", type=int, default=1200, help="steps of the fit")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/editing.md"))
    options = parser.parse_args()
    if unknown := set(options.names) - set(TASKS):
        parser.error(f"there is no edit {', '.join(sorted(unknown))}; known are {', '.join(TASKS)}")
    lines: list[str] = []
    pictures = []
    for name in options.names or TASKS:
        found, meshes, labels = rows(name, options)
        lines += found
        azimuth, elevation, up = TASKS[name].view
        camera = Camera.around(np.concatenate([mesh.vertices for mesh in meshes]), azimuth, elevation=elevation, up=up)
        pictures.append(contact_sheet(meshes, labels, camera=camera, columns=len(meshes), size=240))
    picture = options.output.with_suffix(".png")
    Image.fromarray(np.concatenate(pictures)).quantize(128).save(picture, optimize=True)
    replace_file(options.output, document(lines, picture.name, options).encode())
    print(options.output)


if __name__ == "__main__":
    main()
