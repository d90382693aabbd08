"""The commands that let a field follow a flow of its mesh."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from levelflow._version import __version__
from levelflow.cli.names import box_of, fingerprint, half_box, key_named, place_in
from levelflow.cli.options import Depth, Device, Folder, Quiet, Resume, Seed, ShapeArgument, Width
from levelflow.cli.running import Run, folder_for, refuse_file

if TYPE_CHECKING:
    from levelflow.boxes import Box
    from levelflow.conditions import Key
    from levelflow.evolution import Step
    from levelflow.export.frames import Frame
    from levelflow.fields import Placed
    from levelflow.flows import Flow


Count = Annotated[int, typer.Option(help="How many steps of time.")]
Cells = Annotated[int, typer.Option(help="Cells of the mesh that moves, along the longest side.")]
FitSteps = Annotated[int | None, typer.Option(help="Training steps of the first fit.")]


def evolve(
    shape: ShapeArgument,
    output: Folder = None,
    flow: Annotated[
        str, typer.Option(help="curvature, taubin, offset or area; with +keep behind it the volume is kept.")
    ] = "curvature",
    rate: Annotated[
        float | None, typer.Option(help="Of the flow: length^2 per time, for offset length per time [by the size].")
    ] = None,
    dt: Annotated[float, typer.Option(help="The length of a step of time.")] = 0.1,
    count: Count = 10,
    room: Annotated[float, typer.Option(help="How much longer the box of the field is than the shape.")] = 1.25,
    resolution: Cells = 96,
    steps: FitSteps = None,
    seed: Seed = 0,
    device: Device = "cpu",
    quiet: Quiet = False,
    resume: Resume = False,
    width: Width = 128,
    depth: Depth = 3,
) -> None:
    """Move the mesh of a field by a flow, follow with the field, and repeat; saved after every step."""
    if not dt > 0 or count < 1 or not room >= 1:
        raise ValueError(f"evolve --dt {dt:g} --count {count} --room {room:g}: positive, and the room at least 1.")
    run = Run(steps, None, seed, device, quiet, resume, width, depth)
    key = key_named(shape)
    box = box_of(key)
    moving = flow_named(flow, rate, half_box(box))
    following = Following(run, "evolve", shape, output, {"flow": flow, "rate": rate, "dt": dt})
    field = following.begun(key, box.expanded((room - 1) * max(box.size) / 2))
    following.run_through(field, moving, dt=dt, count=count, resolution=resolution, title=f"{shape}: {flow}")


def edit(
    shape: ShapeArgument,
    handles: Annotated[Path, typer.Option(help="What is held, moved and turned: a JSON file (docs/handles.md).")],
    output: Folder = None,
    at: Annotated[
        str | None, typer.Option("--time", help="When, for a field that moves: 0.5, or 0.5,0.2 for two parameters.")
    ] = None,
    rigid: Annotated[
        str, typer.Option(help="blended, arap (as rigid as possible) or shell (the thin-shell system alone).")
    ] = "blended",
    count: Count = 8,
    resolution: Cells = 96,
    steps: FitSteps = None,
    seed: Seed = 0,
    device: Device = "cpu",
    quiet: Quiet = False,
    resume: Resume = False,
    width: Width = 128,
    depth: Depth = 3,
) -> None:
    """Bend a shape by handles: regions that are moved, turned or held; the edit runs from time 0 to 1."""
    from levelflow import flows
    from levelflow.boxes import Box
    from levelflow.extraction import extract
    from levelflow.handles import handles_from
    from levelflow.shapes import Mesh

    ways = {"blended": flows.BlendedMotions, "arap": flows.AsRigidAsPossible, "shell": flows.ThinShell}
    if rigid not in ways or count < 1:
        raise ValueError(f"edit --rigid {rigid} --count {count}: known are {', '.join(ways)}, in one step or more.")
    run = Run(steps, None, seed, device, quiet, resume, width, depth)
    key = _still(shape, at)
    box, asked = box_of(key), handles_from(handles)
    if isinstance(key, Mesh):
        # Says what is wrong with the handles before anything is trained.
        flows.Edit(extract(key.distance, box=box.expanded(0.05 * max(box.size)), resolution=resolution), asked)
    settings = {"handles": handles.read_text(), "rigid": rigid, "count": count, "time": at}
    following = Following(run, "edit", shape, output, settings)
    field = following.begun(key, box.expanded(0.125 * max(box.size)))
    surface = extract(field if not field.times else field.at(0.0), resolution=resolution, refine=2)
    moving = flows.Edit(surface, asked, densify=ways[rigid]())
    after = moving.deformed(steps=max(4, count))
    larger = box.union(Box.around(after.vertices)).expanded(0.125 * max(box.size))
    frames = following.run_through(
        field,
        moving,
        dt=1 / count,
        count=count,
        resolution=resolution,
        substeps=1,
        remesh=False,
        box=larger,
        title=f"{shape}: edited",
    )
    if frames[-1].mesh is not None:
        error = flows.handle_error(moving, frames[-1].mesh)
        change = flows.volume_change(surface, frames[-1].mesh)
        run.say(
            f"handles met within {error.mean:.3g} on average, at most {error.max:.3g}; volume {100 * change:+.2g} %"
        )


class Following:
    """A run of `evolve` in a folder, saved after every step of time.

    Args:
        run: The options that all training commands share.
        verb: What the command is called.
        shape: The name of the shape.
        output: The folder for the results, if it is named.
        settings: What a run that goes on must have in common with the one before.
    """

    def __init__(self, run: Run, verb: str, shape: str, output: Path | None, settings: dict[str, object]) -> None:
        self.run, self.verb, self.shape = run, verb, shape
        self.folder = output or folder_for([shape], verb)
        self.settings = {"verb": verb, "shape": fingerprint(shape), "seed": run.seed, **settings}
        self.file, self.started = self.folder / "field.safetensors", time.perf_counter()
        refuse_file(self.folder)
        if run.resume and not self.file.exists():
            raise ValueError(f"--resume: there is no evolution in {self.folder}; leave --resume out.")

    def begun(self, key: Key, box: Box) -> Placed:
        """The evolution that there is, the field that a shape is, or one fitted to it in a box."""
        from levelflow.fields import Placed
        from levelflow.fitting import fit
        from levelflow.networks import SIREN
        from levelflow.progress import Bar
        from levelflow.saving import load

        if self.run.resume:
            field = load(self.file)
            made = field.provenance.get("settings")
            if not isinstance(field, Placed) or made != json.loads(json.dumps(self.settings)):
                raise ValueError(f"--resume: {self.file} was made with {made}, and now it is {self.settings}.")
            return field
        if isinstance(key, Placed) and isinstance(key.field, SIREN):
            return key
        with Bar(f"fitting {self.shape}", quiet=self.run.quiet) as bar:
            return fit(
                self.run.network(box.space), key, box=box, budget=self.run.budget(), seed=self.run.seed, on_step=bar
            )

    def run_through(
        self, field: Placed, flow: Flow, *, dt: float, count: int, resolution: int, title: str, substeps: int = 4,
        remesh: bool = True, box: Box | None = None,
    ) -> list[Frame]:  # fmt: skip
        """Steps up to a count, and what the commands leave: the field, meshes, a contact sheet and a report."""
        from levelflow.evolution import evolve as follow
        from levelflow.export.frames import write_frames
        from levelflow.saving import save
        from levelflow.shapes.writing import replace_file

        self.folder.mkdir(parents=True, exist_ok=True)
        done = int(field.provenance["steps"]) if field.times else 0
        records = list(field.provenance.get("followed", []))
        if done:
            self.run.say(f"going on from step {done} of {count}")

        def on_step(step: Step) -> None:
            parts = f" in {step.parts} parts" if step.parts > 1 else ""
            self.run.say(f"  step {step.number} of {count}: t = {step.time:.6g}, followed within {step.gap:.3g}{parts}")
            records.append({"time": step.time, "gap": step.gap, "rounds": step.rounds, "parts": step.parts})
            known = {"inputs": [self.shape], "settings": self.settings, "followed": records}
            step.evolution.provenance |= known
            save(step.evolution, self.file)

        if done < count:
            field = follow(
                field, flow, dt=dt, steps=count - done, box=box, resolution=resolution, substeps=substeps,
                remesh=remesh, seed=self.run.seed, on_step=on_step,
            )  # fmt: skip
        every = max(1, math.ceil(count / 8))
        times = [field.box.times[0][1] * i / count for i in [*range(0, count, every), count]]
        frames = write_frames(
            field, times, self.folder, resolution=resolution, title=title,
            on_frame=lambda frame: self.run.say(f"  {frame.file or f't = {frame.time:g}: the surface has vanished'}"),
        )  # fmt: skip
        report = {
            "levelflow": __version__,
            "verb": self.verb,
            "settings": {**self.settings, "resolution": resolution},
            "followed": records,
            "seconds": time.perf_counter() - self.started,
            "frames": [frame.report() for frame in frames],
        }
        replace_file(self.folder / "report.json", json.dumps(report, indent=2).encode())
        meshes = sum(frame.mesh is not None for frame in frames)
        self.run.say(f"{self.folder}: field.safetensors, {meshes} meshes, frames.png, report.json")
        return frames


def _still(shape: str, time: str | None) -> Key:
    """What an edit starts from: a shape, or a field at a time."""
    from levelflow.saving import load

    if Path(shape).suffix.lower() == ".safetensors":
        field = load(shape)
        place = place_in(time, field, f"edit {shape}")
        return field.at(*place) if place else field
    if time is not None:
        raise ValueError(f"edit {shape} --time {time}: a shape stands still; leave --time out.")
    return key_named(shape)


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
