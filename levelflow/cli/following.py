"""The command that lets a field follow a flow of its mesh."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from levelflow._version import __version__
from levelflow.cli.names import box_of, half_box, key_named
from levelflow.cli.running import Run, folder_for

if TYPE_CHECKING:
    from levelflow.evolution import Step
    from levelflow.fields import Placed
    from levelflow.flows import Flow


def evolve(
    shape: Annotated[str, typer.Argument(metavar="SHAPE", help="A mesh, a built-in shape, or a field.")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="The folder for the results.")] = None,
    flow: Annotated[
        str, typer.Option(help="curvature, taubin, offset or area; curvature+keep and the like keep the volume.")
    ] = "curvature",
    rate: Annotated[
        float | None, typer.Option(help="Of the flow: length^2 per time, for offset length per time [by the size].")
    ] = None,
    dt: Annotated[float, typer.Option(help="The length of a step of time.")] = 0.1,
    count: Annotated[int, typer.Option(help="How many steps of time.")] = 10,
    resolution: Annotated[int, typer.Option(help="Cells of the mesh that moves, along the longest side.")] = 96,
    steps: Annotated[int | None, typer.Option(help="Training steps of the first fit.")] = None,
    seed: Annotated[int, typer.Option(help="Of every random choice.")] = 0,
    device: Annotated[str, typer.Option(help="cpu, cuda, ...")] = "cpu",
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but warnings and errors.")] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the last step in the output folder.")] = False,
    width: Annotated[int, typer.Option(help="Neurons of a layer.")] = 128,
    depth: Annotated[int, typer.Option(help="Hidden layers.")] = 3,
) -> None:
    """Move the mesh of a field by a flow, follow with the field, and repeat; saved after every step."""
    from levelflow.evolution import evolve as follow
    from levelflow.export.frames import write_frames
    from levelflow.fields import Placed
    from levelflow.saving import load, save
    from levelflow.shapes.writing import replace_file

    run = Run(steps, None, seed, device, quiet, resume, width, depth)
    if not dt > 0 or count < 1:
        raise ValueError(f"evolve --dt {dt:g} --count {count}: both must be positive.")
    key = key_named(shape)
    moving = flow_named(flow, rate, half_box(box_of(key)))
    folder = output or folder_for([shape], "evolve")
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"-o {folder}: this is a file; name a folder for the results.")
    file, started = folder / "field.safetensors", time.perf_counter()
    if resume and not file.exists():
        raise ValueError(f"--resume: there is no evolution in {folder}; leave --resume out.")
    folder.mkdir(parents=True, exist_ok=True)
    if resume:
        field = load(file)
        if not isinstance(field, Placed) or field.provenance.get("settings") != _settings(shape, flow, rate, dt, seed):
            raise ValueError(
                f"--resume: {file} comes from {field.provenance.get('settings', 'another command')}; repeat the "
                "command with the same shape, flow, rate, dt and seed."
            )
        done = int(field.provenance["steps"])
        run.say(f"going on from step {done} of {count}")
    else:
        field, done = _static(run, key, shape), 0
    records = list(field.provenance.get("followed", []))

    def on_step(step: Step) -> None:
        parts = f" in {step.parts} parts" if step.parts > 1 else ""
        run.say(f"  step {step.number} of {count}: t = {step.time:.6g}, followed within {step.gap:.3g}{parts}")
        records.append({"time": step.time, "gap": step.gap, "rounds": step.rounds, "parts": step.parts})

    while done < count:
        field = follow(field, moving, dt=dt, steps=1, resolution=resolution, seed=seed, on_step=on_step)
        done += 1
        field.provenance |= {
            "inputs": [shape], "settings": _settings(shape, flow, rate, dt, seed), "followed": records,
        }  # fmt: skip
        save(field, file)
    times = [dt * i for i in range(0, count + 1, max(1, math.ceil(count / 8)))]
    frames = write_frames(
        field, times, folder, resolution=resolution, title=f"{shape}: {flow}",
        on_frame=lambda frame: run.say(f"  {frame.file or f't = {frame.time:g}: the surface has vanished'}"),
    )  # fmt: skip
    report = {
        "levelflow": __version__,
        "verb": "evolve",
        "settings": {**_settings(shape, flow, rate, dt, seed), "resolution": resolution, "flow": repr(moving)},
        "followed": records,
        "seconds": time.perf_counter() - started,
        "frames": [frame.report() for frame in frames],
    }
    replace_file(folder / "report.json", json.dumps(report, indent=2).encode())
    run.say(f"{folder}: field.safetensors, {sum(f.mesh is not None for f in frames)} meshes, frames.png, report.json")


def flow_named(text: str, rate: float | None, unit: float) -> Flow:
    """The flow of a name, with a rate in the units of the shape; by default one that suits a shape of this half size.

    Raises:
        ValueError: If there is no such flow.
    """
    from levelflow import flows

    name, _, keep = text.partition("+")
    slow = 1e-3 * unit**2 if rate is None else rate
    known: dict[str, Callable[[], Flow]] = {
        "curvature": lambda: flows.MeanCurvature(slow),
        "taubin": lambda: flows.Taubin(slow, -1.03 * slow),
        "offset": lambda: flows.NormalOffset(0.1 * unit if rate is None else rate),
        "area": lambda: flows.Descent(flows.area, slow),
    }
    if name not in known or keep not in ("", "keep"):
        raise ValueError(f"--flow {text}: known are {', '.join(known)}, each with +keep for one that keeps the volume.")
    made = known[name]()
    return flows.VolumePreserving(made) if keep else made


def _settings(shape: str, flow: str, rate: float | None, dt: float, seed: int) -> dict[str, object]:
    return {"shape": shape, "flow": flow, "rate": rate, "dt": dt, "seed": seed}


def _static(run: Run, key: object, shape: str) -> Placed:
    """The field that a shape is, or one fitted to it, in a box with room for the motion."""
    from levelflow.fields import Field, Placed
    from levelflow.fitting import fit
    from levelflow.progress import Bar

    if isinstance(key, Placed) and not key.times:
        return key
    if isinstance(key, Field):
        raise ValueError(f"evolve {shape}: give a static field, such as one that levelflow fit or slice writes.")
    with Bar(f"fitting {shape}", quiet=run.quiet) as bar:
        return fit(run.network(box_of(key).space), key, budget=run.budget(), seed=run.seed, on_step=bar)  # type: ignore[arg-type]
