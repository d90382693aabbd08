"""Training runs from the command line: checkpoints, progress, and what they leave in a folder."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from levelflow._version import __version__
from levelflow.cli.names import box_of, device_named, fingerprint

if TYPE_CHECKING:
    from torch import Tensor

    from levelflow.boxes import Box, Until
    from levelflow.conditions import Key
    from levelflow.equations import Equation
    from levelflow.export.frames import Frame, Place
    from levelflow.fields import Placed
    from levelflow.minimising import Budget, Progress
    from levelflow.networks.periodic import Periodic
    from levelflow.networks.siren import SIREN
    from levelflow.saving import Checkpoint
    from levelflow.transported import Transported

CHECKPOINT_SECONDS = float(os.environ.get("LEVELFLOW_CHECKPOINT_SECONDS", "5"))
"""How often a run is saved while it goes on; the environment variable is for tests and for slow disks."""
CHECKPOINT = "checkpoint.safetensors"


@dataclass(frozen=True)
class Run:
    """The options that all training commands share."""

    steps: int | None
    seconds: float | None
    seed: int
    device: str
    quiet: bool
    resume: bool
    width: int
    depth: int

    def say(self, text: str) -> None:
        if not self.quiet:
            typer.echo(text)

    def network(self, space: int, time: int = 0) -> SIREN:
        """A new network on the device, its initial weights from the seed."""
        import torch

        from levelflow.networks.siren import SIREN

        generator = torch.Generator().manual_seed(self.seed)
        network = SIREN(space, time, width=self.width, depth=self.depth, generator=generator)
        return network.to(device_named(self.device))

    def loop(self, space: int) -> Periodic:
        """The same, of space and a time that comes round."""
        from levelflow.networks.periodic import Periodic

        return Periodic(self.network(space, 2), time=True)

    def budget(self) -> Budget:
        """The steps or seconds that the run may take."""
        from levelflow.minimising import DEFAULT_BUDGET, Budget

        if self.steps is None and self.seconds is None:
            return DEFAULT_BUDGET
        return Budget(self.steps, self.seconds)

    def settings(self, verb: str, inputs: Sequence[str], **more: Any) -> dict[str, Any]:
        """What a resumed run must have in common with the one that was interrupted."""
        return {
            "verb": verb,
            "inputs": [fingerprint(text) for text in inputs],
            "steps": self.steps,
            "seconds": self.seconds,
            "seed": self.seed,
            "width": self.width,
            "depth": self.depth,
            **more,
        }


def evolve(
    run: Run,
    verb: str,
    inputs: Sequence[str],
    at: Mapping[Any, Key],
    equation: Equation,
    times: Sequence[Place],
    folder: Path,
    *,
    resolution: int,
    until: Until = None,
    title: str | None = None,
    columns: int | Sequence[int] | None = None,
    distil: bool = True,
    loop: bool = False,
    notes: Mapping[str, Any] | None = None,
) -> list[Frame]:
    """Solves, and writes the field, the meshes, the contact sheet and the report.

    Without `distil` the first shape is fitted and carried along the characteristics of the equation.

    Args:
        run: The options of training.
        verb: The command.
        inputs: The arguments that name the shapes.
        at: The shapes by their times, or by tuples of parameters.
        equation: The motion.
        times: When to show the surface, or at which parameters.
        folder: Where everything is written.
        resolution: Marching-cubes cells.
        until: Where the intervals of several parameters end; that of a single time spans the times.
        title: A line above the contact sheet.
        columns: Pictures in a row of it, or in each of its rows.
        distil: Whether to train one network of space and all parameters.
        loop: Whether the times 0 and 1 are the same instant.
        notes: What the file of the field says besides.
    """
    import torch

    from levelflow.averaging import with_means
    from levelflow.conditions import surface_of
    from levelflow.equations import VolumePreserving
    from levelflow.export.frames import write_frames
    from levelflow.fields import Placed
    from levelflow.measures import residual_table
    from levelflow.saving import Checkpoint, save
    from levelflow.shapes.writing import replace_file
    from levelflow.solving import solve

    if resolution < 2:
        raise ValueError(f"--resolution {resolution}: give at least 2 cells.")
    moments = [t for t in (*times, *at) if isinstance(t, int | float)]
    if moments:
        if len({*moments}) < 2:
            raise ValueError(f"--times: the shape is given at t = {moments[0]:g}; ask for other times as well.")
        until = (min(moments), max(moments))
    refuse_file(folder)
    folder.mkdir(parents=True, exist_ok=True)
    started = time.perf_counter()
    space, k = box_of(next(iter(at.values()))).space, 1 if moments else len(next(iter(at)))
    settings = run.settings(verb, inputs, equation=repr(equation), times=until, distil=distil, loop=loop)
    kept = Checkpoint(folder / CHECKPOINT, settings=settings, seconds=CHECKPOINT_SECONDS)
    with training(run, f"{verb} {' '.join(inputs)}", kept) as (on_step, state):
        field: Placed | Transported
        if distil:
            field = solve(
                equation, run.loop(space) if loop else run.network(space, k), at=at,
                until=(0.0, 1.0) if loop else until, budget=run.budget(), seed=run.seed, on_step=on_step, state=state,
            )  # fmt: skip
        else:
            field = _carried(run, at, equation, until, on_step, state)
    trained = time.perf_counter()
    field.provenance |= {"inputs": list(inputs), **(notes or {})}
    save(field, folder / "field.safetensors")
    frames = write_frames(
        field, times, folder, resolution=resolution, title=title, columns=columns,
        on_frame=lambda frame: run.say(f"  {frame.file or f'{when(frame.time)}: the surface has vanished'}"),
    )  # fmt: skip
    t0, key = next(iter(at.items()))
    if isinstance(equation, VolumePreserving):
        assert isinstance(field, Placed)
        generator = torch.Generator().manual_seed(run.seed)
        equation = with_means(
            equation, field, origin=t0 if isinstance(t0, float) else float(t0[0] or 0.0), generator=generator
        )
    table = residual_table(field, equation, surface_of(key), time=t0, generator=torch.Generator().manual_seed(run.seed))
    report = {
        "levelflow": __version__,
        "verb": verb,
        "settings": {**settings, "device": run.device, "threads": torch.get_num_threads(), "resolution": resolution},
        "accuracy": field.provenance["accuracy"],
        "half_box": field.box.frame.scale,
        "residuals": {
            "on_surface": table.surface._asdict(),
            "off_surface": None if table.distance is None else table.distance._asdict(),
            "equation": table.equation._asdict(),
        },
        "steps": field.provenance["steps"],
        "seconds": {"training": trained - started, "all": time.perf_counter() - started},
        "frames": [frame.report() for frame in frames],
    }
    replace_file(folder / "report.json", json.dumps(report, indent=2).encode())
    kept.remove()
    for t, accuracy in field.provenance["accuracy"].items():
        run.say(f"at t = {t}: {accuracy_in_words(accuracy, field.box)}")
    run.say(f"{folder}: field.safetensors, {sum(f.mesh is not None for f in frames)} meshes, frames.png, report.json")
    return frames


def when(place: Place) -> str:
    """`t = 0.5`, or `t = 0.5, 0.2` for several parameters."""
    return f"t = {', '.join(f'{value:g}' for value in (place if isinstance(place, tuple) else (place,)))}"


def _carried(
    run: Run,
    at: Mapping[Any, Key],
    equation: Equation,
    until: Until,
    on_step: Callable[[Progress], None],
    state: dict[str, Tensor] | None,
) -> Transported:
    """The one given shape, fitted by a network unless it is a field already, carried along characteristics."""
    from levelflow.conditions import surface_of
    from levelflow.fields import Field, Placed
    from levelflow.fitting import fit
    from levelflow.measures import accuracy
    from levelflow.transported import Transported

    ((place, key),) = at.items()
    static = key if isinstance(key, Field) else None
    if static is None:
        surface = surface_of(key)
        static = fit(
            run.network(surface.box.space), surface, budget=run.budget(), seed=run.seed, on_step=on_step, state=state
        )
    field = Transported(equation, static, until=until, time=place)
    made = static.provenance if isinstance(static, Placed) else {}
    field.provenance = {**made, "verb": "transport", "equation": repr(equation), "steps": made.get("steps", 0)}
    name = ",".join(f"{t:.15g}" for t in (place if isinstance(place, tuple) else (place,)))
    field.provenance["accuracy"] = {name: accuracy(static, surface_of(key), seed=run.seed)}
    return field


def interrupted(run: Run, kept: Checkpoint) -> dict[str, Tensor] | None:
    """The state to go on from, if that is asked for.

    Raises:
        ValueError: If there is none, or there is one that nobody asked for and that would be lost.
    """
    state = kept.state if run.resume else None
    if run.resume and state is None:
        raise ValueError(f"--resume: there is no interrupted run in {kept.path.parent}; leave --resume out.")
    if not run.resume and kept.path.exists():
        raise ValueError(
            f"{kept.path.parent} holds an interrupted run. Go on with it by --resume, "
            f"choose another output, or remove {kept.path}."
        )
    return state


@contextmanager
def training(
    run: Run, title: str, kept: Checkpoint
) -> Iterator[tuple[Callable[[Progress], None], dict[str, Tensor] | None]]:
    """What a training run needs around it: a bar, checkpoints, the state to go on from, and a word when it fails."""
    from levelflow.minimising import Divergence
    from levelflow.progress import Bar
    from levelflow.saving import save

    state = interrupted(run, kept)
    if state is not None:
        run.say(f"going on from step {int(state['progress'][0])}")
    with Bar(title, quiet=run.quiet) as bar:

        def on_step(progress: Progress) -> None:
            bar(progress)
            kept(progress)

        try:
            yield on_step, state
        except KeyboardInterrupt:
            more = "--resume goes on from the last save" if kept.path.exists() else "nothing was saved yet"
            typer.echo(f"interrupted; {more}.", err=True)
            raise
        except Divergence as error:
            kept.remove()
            last = kept.path.with_name("last-good.safetensors")
            save(error.field, last)
            raise Divergence(f"{error} It is saved as {last}.") from None


def folder_for(shapes: Sequence[str], verb: str) -> Path:
    """`armadillo-smooth`, or `spot-bob-morph`."""
    return Path("-".join([*(Path(shape).stem for shape in shapes), verb]))


def refuse_file(folder: Path) -> None:
    """Says that a file cannot be a folder for results."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"-o {folder}: this is a file; name a folder for the results.")


def at_rest(run: Run, shape: str, key: Key, steps: int | None, file: Path) -> Placed:
    """The field that a shape is, the one that an interrupted run has fitted to it, or a new one, left in a file."""
    from levelflow.fields import Placed
    from levelflow.fitting import fit
    from levelflow.minimising import DEFAULT_BUDGET, Budget
    from levelflow.progress import Bar
    from levelflow.saving import load, save

    if isinstance(key, Placed):
        return key
    if run.resume and file.exists():
        field = load(file)
        assert isinstance(field, Placed)
        return field
    with Bar(f"fitting {shape}", quiet=run.quiet) as bar:
        field = fit(
            run.network(box_of(key).space), key, budget=DEFAULT_BUDGET if steps is None else Budget(steps),
            seed=run.seed, on_step=bar,
        )  # fmt: skip
    field.provenance["inputs"] = [shape]
    save(field, file)
    return field


def accuracy_in_words(accuracy: dict[str, float] | None, box: Box) -> str:
    """`mean distance to the given surface 0.0012, at most 0.008 (0.06 % of the box)`."""
    if accuracy is None:
        return "the field has no surface; train it for longer"
    share = 100 * accuracy["mean"] / max(box.size)
    return (
        f"mean distance to the given surface {accuracy['mean']:.3g}, at most {accuracy['max']:.3g} "
        f"({share:.2g} % of the box)"
    )
