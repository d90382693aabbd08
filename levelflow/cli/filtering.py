"""The command that scales curvature: noise goes, or details are sharpened."""

from __future__ import annotations

import json
import time
from typing import Annotated

import typer

from levelflow._version import __version__
from levelflow.cli.names import box_of, half_box, key_named
from levelflow.cli.options import (
    Depth,
    Device,
    Folder,
    Quiet,
    Relative,
    Resolution,
    Resume,
    Seconds,
    Seed,
    ShapeArgument,
    Steps,
    Width,
)
from levelflow.cli.running import (
    CHECKPOINT,
    CHECKPOINT_SECONDS,
    Run,
    at_rest,
    folder_for,
    interrupted,
    refuse_file,
    training,
)


def filter_shape(
    shape: ShapeArgument,
    output: Folder = None,
    factor: Annotated[
        float, typer.Option(help="What finer curvature is multiplied by: 0 or 0.5 to smooth, 2 to sharpen.")
    ] = 0.0,
    wavelength: Annotated[
        float | None,
        typer.Option(help="How long ripples are that count as fine, a length; by default a twentieth of the box."),
    ] = None,
    threshold: Annotated[
        float | None,
        typer.Option(help="Curvature, in 1 / length, beyond which it is nothing to go by [2 pi / wavelength]."),
    ] = None,
    relative: Relative = False,
    resolution: Resolution = 128,
    fit_steps: Annotated[
        int | None, typer.Option(help="Training steps of the fit, if the shape is no field yet [1200].")
    ] = None,
    steps: Steps = None,
    seconds: Seconds = None,
    seed: Seed = 0,
    device: Device = "cpu",
    quiet: Quiet = False,
    resume: Resume = False,
    width: Width = 128,
    depth: Depth = 3,
) -> None:
    """Smooth or sharpen a shape at once, by the curvature that its surface is to have; 400 steps by default."""
    from levelflow.extraction import extract
    from levelflow.filtering import FILTER_BUDGET, scale_curvature
    from levelflow.rendering.images import contact_sheet
    from levelflow.saving import Checkpoint, save
    from levelflow.shapes.writing import replace_file

    if not factor >= 0 or not all(value is None or value > 0 for value in (wavelength, threshold)):
        raise ValueError(
            f"filter --factor {factor:g} --wavelength {wavelength} --threshold {threshold}: the factor must be at "
            "least 0, and the others positive."
        )
    run = Run(steps, seconds, seed, device, quiet, resume, width, depth)
    key = key_named(shape)
    unit = half_box(box_of(key)) if relative else 1.0
    length = None if wavelength is None else wavelength * unit
    sharpest = None if threshold is None else threshold / unit
    folder = output or folder_for([shape], "filter")
    refuse_file(folder)
    folder.mkdir(parents=True, exist_ok=True)
    started = time.perf_counter()
    settings = run.settings("filter", [shape], factor=factor, wavelength=length, threshold=sharpest, fit=fit_steps)
    kept = Checkpoint(folder / CHECKPOINT, settings=settings, seconds=CHECKPOINT_SECONDS)
    interrupted(run, kept)  # says what is wrong with the folder before anything is trained
    before = at_rest(run, shape, key, fit_steps, folder / "before.safetensors")
    ready = time.perf_counter()
    with training(run, f"filtering {shape}", kept) as (on_step, state):
        after = scale_curvature(
            before, factor, wavelength=length, threshold=sharpest,
            budget=FILTER_BUDGET if steps is None and seconds is None else run.budget(),
            seed=seed, on_step=on_step, state=state,
        )  # fmt: skip
    done = time.perf_counter()
    after.provenance["inputs"] = [shape]
    save(after, folder / "field.safetensors")
    meshes = {name: extract(field, resolution=resolution) for name, field in (("before", before), ("after", after))}
    for name, mesh in meshes.items():
        mesh.write(folder / f"{name}.ply")
    contact_sheet(
        list(meshes.values()), [shape, f"curvature times {factor:g}"], folder / "filter.png",
        title=f"{shape}, finer than {after.provenance['wavelength']:.3g}",
    )  # fmt: skip
    report = {
        "levelflow": __version__,
        "verb": "filter",
        "settings": {**settings, "device": device, "resolution": resolution},
        **{name: after.provenance[name] for name in ("wavelength", "threshold", "moved", "steps")},
        "surfaces": {name: {"area": mesh.area, "volume": mesh.volume} for name, mesh in meshes.items()},
        "seconds": {"fit": ready - started, "filter": done - ready, "all": time.perf_counter() - started},
    }
    replace_file(folder / "report.json", json.dumps(report, indent=2).encode())
    kept.remove()
    moved = after.provenance["moved"]
    if moved is not None:
        run.say(f"the surface has moved by {moved['mean']:.3g} on average, at most {moved['max']:.3g}")
    run.say(f"{folder}: field.safetensors, before.ply, after.ply, filter.png, report.json")
