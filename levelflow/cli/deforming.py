"""The command that deforms a field by handles, as a thin elastic shell."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from levelflow._version import __version__
from levelflow.cli.names import key_named
from levelflow.cli.options import Depth, Device, Folder, Quiet, Resume, Seconds, Seed, ShapeArgument, Width
from levelflow.cli.running import CHECKPOINT, CHECKPOINT_SECONDS, Run, at_rest, folder_for, refuse_file, training

if TYPE_CHECKING:
    from levelflow.export.frames import Frame
    from levelflow.fields import Placed
    from levelflow.shapes import Mesh


def deform(
    shape: ShapeArgument,
    handles: Annotated[Path, typer.Option(help="What is held, moved and turned: a JSON file (docs/handles.md).")],
    output: Folder = None,
    stretch: Annotated[float, typer.Option(help="How much the surface resists stretching.")] = 0.1,
    bend: Annotated[float, typer.Option(help="How much it resists bending, with half the box as the unit.")] = 1e-3,
    path: Annotated[bool, typer.Option("--path", help="The way there too, as a field in time from 0 to 1.")] = False,
    count: Annotated[int, typer.Option(help="Pictures of the way, with --path, after the first.")] = 4,
    blocks: Annotated[
        int | None, typer.Option(help="Of the invertible network; more, the farther handles turn, by default.")
    ] = None,
    resolution: Annotated[int, typer.Option(help="Cells of the meshes, along the longest side.")] = 96,
    steps: Annotated[int | None, typer.Option(help="Training steps of the deformation [600].")] = None,
    seconds: Seconds = None,
    fit_steps: Annotated[
        int | None, typer.Option(help="Training steps of the first fit, if SHAPE is no field.")
    ] = None,
    seed: Seed = 0,
    device: Device = "cpu",
    quiet: Quiet = False,
    resume: Resume = False,
    width: Width = 128,
    depth: Depth = 3,
) -> None:
    """Deform a shape by handles as a thin elastic shell, which stretches and bends as little as it can."""
    from levelflow.deformation import BUDGET, invertible
    from levelflow.deformation import deform as deform_field
    from levelflow.elasticity import Shell
    from levelflow.extraction import extract
    from levelflow.flows import Edit
    from levelflow.handles import handles_from
    from levelflow.saving import Checkpoint, save
    from levelflow.shapes import Mesh

    if count < 1 or resolution < 2 or (blocks is not None and blocks < 1):
        raise ValueError(f"deform --count {count} --resolution {resolution} --blocks {blocks}: too few.")
    run = Run(steps, seconds, seed, device, quiet, resume, width, depth)
    shell, key, asked = Shell(stretch, bend), key_named(shape), handles_from(handles)
    if isinstance(key, Mesh):
        Edit(key, asked, call="deform")  # says what is wrong with the handles before anything is trained
    folder, started = output or folder_for([shape], "deform"), time.perf_counter()
    refuse_file(folder)
    folder.mkdir(parents=True, exist_ok=True)
    field = at_rest(run, shape, key, fit_steps, folder / "rest.safetensors")
    settings = run.settings(
        "deform", [shape], handles=handles.read_text(), shell=repr(shell), path=path, blocks=blocks,
        resolution=resolution, fit_steps=fit_steps,
    )  # fmt: skip
    kept = Checkpoint(folder / CHECKPOINT, settings=settings, seconds=CHECKPOINT_SECONDS)
    network = None if blocks is None else invertible(field.space, int(path), blocks=blocks)
    with training(run, f"deforming {shape}", kept) as (on_step, state):
        deformed = deform_field(
            field, asked, shell=shell, network=network, path=path, resolution=resolution, seed=seed,
            budget=BUDGET if steps is None and seconds is None else run.budget(), on_step=on_step, state=state,
        )  # fmt: skip
    trained = time.perf_counter()
    deformed.provenance |= {"inputs": [shape], "settings": settings}
    save(deformed, folder / "field.safetensors")
    before = extract(field, resolution=resolution)
    after, frames = _shown(run, deformed, before, folder, f"{shape}: deformed", count, resolution)
    _report(folder, settings, deformed, before, after, frames, (trained - started, time.perf_counter() - started))
    kept.remove()
    said, change = deformed.provenance, after.volume / before.volume - 1 if before.volume else 0.0
    run.say(
        f"handles met within {said['handles']['mean']:.3g} on average, at most {said['handles']['max']:.3g}; "
        f"stretching {said['energy']['stretching']:.3g}, bending {said['energy']['bending']:.3g}; volume "
        f"{100 * change:+.2g} %"
    )
    meshes = len(frames) if frames else 1
    run.say(f"{folder}: field.safetensors, {meshes} mesh{'es' * (meshes > 1)}, frames.png, report.json")


def _shown(
    run: Run, field: Placed, before: Mesh, folder: Path, title: str, count: int, resolution: int
) -> tuple[Mesh, list[Frame]]:
    """The deformed surface, and the frames on the way if the field knows of it; written, with a picture."""
    from levelflow.export.frames import write_frames
    from levelflow.extraction import extract
    from levelflow.rendering.images import contact_sheet

    if field.times:
        times = [i / count for i in range(count + 1)]
        frames = write_frames(
            field, times, folder, resolution=resolution, title=title,
            on_frame=lambda frame: run.say(f"  {frame.file or f't = {frame.time:g}: the surface has vanished'}"),
        )  # fmt: skip
        return extract(field.at(1.0), resolution=resolution), frames
    after = extract(field, resolution=resolution)
    after.write(folder / "deformed.ply")
    contact_sheet([before, after], ["at rest", "deformed"], folder / "frames.png", title=title)
    return after, []


def _report(
    folder: Path,
    settings: dict[str, object],
    field: Placed,
    before: Mesh,
    after: Mesh,
    frames: list[Frame],
    seconds: tuple[float, float],
) -> None:
    from levelflow.shapes.writing import replace_file

    report = {
        "levelflow": __version__,
        "verb": "deform",
        "settings": settings,
        "handles": field.provenance["handles"],
        "energy": field.provenance["energy"],
        "volume": {"before": before.volume, "after": after.volume},
        "steps": field.provenance["steps"],
        "seconds": {"training": seconds[0], "all": seconds[1]},
        "frames": [frame.report() for frame in frames],
    }
    replace_file(folder / "report.json", json.dumps(report, indent=2).encode())
