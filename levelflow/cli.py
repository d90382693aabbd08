"""The command line: the only place where strings choose things."""

from __future__ import annotations

import json
import math
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from levelflow._version import __version__

if TYPE_CHECKING:
    from levelflow.boxes import Box
    from levelflow.conditions import Key
    from levelflow.equations import Equation, VelocityField
    from levelflow.fields import Placed
    from levelflow.minimising import Progress
    from levelflow.shapes import Shape

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Evolve surfaces: smooth, move and morph meshes as the zero set of one neural field in space and time.",
    epilog="SHAPE is a mesh (.obj .ply .stl .off .glb), a point cloud (.ply .xyz .txt .csv .npy), a field written by "
    "this program (.safetensors), or one of: sphere, cuboid, rounded-cuboid, torus, cylinder, capsule, dumbbell. "
    "Add --debug to any command for a traceback.",
)

BUILTINS = ("sphere", "cuboid", "rounded-cuboid", "torus", "cylinder", "capsule", "dumbbell")
CHECKPOINT_SECONDS = 5.0

ShapeArgument = Annotated[str, typer.Argument(metavar="SHAPE", help="A mesh, a point cloud, a field, or a built-in.")]
Folder = Annotated[Path, typer.Option("--output", "-o", help="The folder for the results.")]
Steps = Annotated[int | None, typer.Option(help="Training steps. By default 1500, or as many as --seconds allows.")]
Seconds = Annotated[float | None, typer.Option(help="Training time; takes the place of the default number of steps.")]
Seed = Annotated[int, typer.Option(help="Of every random choice.")]
Device = Annotated[str, typer.Option(help="cpu, cuda, cuda:1, ...")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but warnings and errors.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on with the interrupted run in the output folder.")]
Width = Annotated[int, typer.Option(help="Neurons of a layer.")]
Depth = Annotated[int, typer.Option(help="Hidden layers.")]
Resolution = Annotated[int, typer.Option(help="Marching-cubes cells along the longest side.")]
Times = Annotated[str | None, typer.Option(help="0,0.5,1 or first:last:number.")]
Relative = Annotated[
    bool, typer.Option("--relative", help="Rates, lengths and positions in units of half the box of the shape.")
]


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

    def settings(self, verb: str, inputs: Sequence[str], **more: Any) -> dict[str, Any]:
        """What a resumed run must have in common with the one that was interrupted."""
        return {
            "verb": verb,
            "inputs": [_fingerprint(text) for text in inputs],
            "steps": self.steps,
            "seconds": self.seconds,
            "seed": self.seed,
            "width": self.width,
            "depth": self.depth,
            **more,
        }


@app.command()
def demo(
    output: Folder = Path("demo-output"),
    steps: Annotated[int, typer.Option(help="Training steps of each of the three evolutions.")] = 300,
    quiet: Quiet = False,
) -> None:
    """Smooth a dumbbell until it pinches, twist a block, and morph a torus: about a minute on two cores."""
    from levelflow.equations import MeanCurvature, Morph, Transport, Twist
    from levelflow.rendering.images import contact_sheet, stack
    from levelflow.shapes import Cuboid, Torus

    block, ring = Cuboid((0.5, 1.4, 0.5), radius=0.1), Torus(0.55, 0.22)
    ball = Cuboid((1.0, 1.0, 1.0), radius=0.15)
    rows = (
        ("smooth", "a dumbbell under mean curvature", {0.0: _builtin("dumbbell")}, MeanCurvature(0.1), 0.0, 0.12),
        ("advect", "a block under a twist", {0.0: block}, Transport(Twist(2.0)), 0.0, 1.0),
        ("morph", "a torus into a rounded cube", {0.0: ring, 1.0: ball}, Morph(ball), 0.0, 1.0),
    )
    sheets = []
    for name, title, at, equation, first, last in rows:
        run = Run(steps, None, 0, "cpu", quiet, False, 64, 3)
        times = [first + (last - first) * i / 4 for i in range(5)]
        folder = output / name
        frames = _evolve(run, name, [name], at, equation, times, folder, resolution=96, title=title)
        sheets.append(
            contact_sheet([f.mesh for f in frames], [f"t = {f.time:g}" for f in frames], title=title, size=300)
        )
    stack(sheets, output / "demo.png")
    if not quiet:
        typer.echo(f"{output / 'demo.png'}: the three evolutions; meshes, fields and reports in {output}/smooth, /advect, /morph")


@app.command()
def fit(
    shape: ShapeArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="The field to write (.safetensors).")],
    steps: Steps = None,
    seconds: Seconds = None,
    seed: Seed = 0,
    device: Device = "cpu",
    quiet: Quiet = False,
    resume: Resume = False,
    width: Width = 128,
    depth: Depth = 3,
) -> None:
    """Fit a field to a shape, and say how accurate it is."""
    from levelflow.fitting import fit as fit_field
    from levelflow.networks.siren import SIREN
    from levelflow.saving import save

    run = Run(steps, seconds, seed, device, quiet, resume, width, depth)
    if output.suffix != ".safetensors":
        raise ValueError(f"fit -o {output}: a field is a .safetensors file; name it {output.with_suffix('.safetensors')}.")
    surface = _surface(shape)
    output.parent.mkdir(parents=True, exist_ok=True)
    checkpoint = output.with_name(f"{output.stem}.checkpoint.safetensors")
    with _training(run, f"fitting {shape}", checkpoint, run.settings("fit", [shape])) as (on_step, state):
        field = fit_field(
            SIREN(surface.box.space, width=width, depth=depth).to(_device(device)), surface, budget=_budget(run),
            seed=seed, on_step=on_step, state=state,
        )  # fmt: skip
    field.provenance["inputs"] = [shape]
    save(field, output)
    checkpoint.unlink(missing_ok=True)
    run.say(f"{output}: {_accuracy(field.provenance['accuracy'], field.box)}")


@app.command()
def smooth(
    shape: ShapeArgument,
    output: Folder,
    rate: Annotated[
        float | None, typer.Option(help="Rate of mean curvature motion, length^2 per time [default: by the size].")
    ] = None,
    times: Times = "0:1:5",
    relative: Relative = False,
    resolution: Resolution = 128,
    steps: Steps = None,
    seconds: Seconds = None,
    seed: Seed = 0,
    device: Device = "cpu",
    quiet: Quiet = False,
    resume: Resume = False,
    width: Width = 128,
    depth: Depth = 3,
) -> None:
    """Smooth a shape by motion along its mean curvature; negative times sharpen it."""
    from levelflow.equations import MeanCurvature

    run = Run(steps, seconds, seed, device, quiet, resume, width, depth)
    key = _key(shape)
    unit = _half_box(key)
    if rate is None:
        rate, relative = 1e-3, True
    equation = MeanCurvature(rate * unit**2 if relative else rate)
    _evolve(run, "smooth", [shape], {0.0: key}, equation, _times(times), output, resolution=resolution)


@app.command()
def advect(
    shape: ShapeArgument,
    output: Folder,
    velocity: Annotated[
        str, typer.Option(help="translation, rotation, twist, source, sink; several with + between them.")
    ] = "twist",
    by: Annotated[str | None, typer.Option(help="Velocity of a translation, x,y,z.")] = None,
    rate: Annotated[
        float | None,
        typer.Option(help="Radians per time (rotation), per time and length (twist), or strength (source, sink)."),
    ] = None,
    axis: Annotated[str, typer.Option(help="Direction of a rotation or twist, x,y,z.")] = "0,1,0",
    center: Annotated[str | None, typer.Option(help="A point x,y,z [default: the centre of the box].")] = None,
    reach: Annotated[float | None, typer.Option(help="Width of a source or sink, a length.")] = None,
    times: Times = "0:1:5",
    relative: Relative = False,
    resolution: Resolution = 128,
    steps: Steps = None,
    seconds: Seconds = None,
    seed: Seed = 0,
    device: Device = "cpu",
    quiet: Quiet = False,
    resume: Resume = False,
    width: Width = 128,
    depth: Depth = 3,
) -> None:
    """Carry a shape along a velocity field."""
    from levelflow.equations import Transport

    run = Run(steps, seconds, seed, device, quiet, resume, width, depth)
    key = _key(shape)
    unit, box = _half_box(key), _box(key)
    middle = box.center if center is None else _numbers(center, "--center")
    if center is not None and relative:
        middle = tuple(c + unit * v for c, v in zip(box.center, middle, strict=True))
    length = unit if relative else 1.0
    velocities = [
        _velocity(name.strip(), by=by, rate=rate, axis=_numbers(axis, "--axis"), center=middle, reach=reach,
                  length=length, unit=unit)
        for name in velocity.split("+")
    ]  # fmt: skip
    equation = Transport(velocities[0])
    for other in velocities[1:]:
        equation = equation + Transport(other)
    _evolve(run, "advect", [shape], {0.0: key}, equation, _times(times), output, resolution=resolution)


@app.command()
def morph(
    shapes: Annotated[list[str], typer.Argument(metavar="A B [C ...]", help="Two shapes or more.")],
    output: Folder,
    times: Times = None,
    resolution: Resolution = 128,
    steps: Steps = None,
    seconds: Seconds = None,
    seed: Seed = 0,
    device: Device = "cpu",
    quiet: Quiet = False,
    resume: Resume = False,
    width: Width = 128,
    depth: Depth = 3,
) -> None:
    """Morph shapes into each other; they stand at equal steps of time from 0 to 1."""
    from levelflow.equations import Morph

    if len(shapes) < 2:
        raise ValueError(f"morph {shapes[0]}: one shape is given; name at least two.")
    run = Run(steps, seconds, seed, device, quiet, resume, width, depth)
    at = {i / (len(shapes) - 1): _key(shape, solid=True) for i, shape in enumerate(shapes)}
    _warn_of_distance(shapes, [_box(key) for key in at.values()])
    equation = Morph({t: key for t, key in at.items() if t > 0})
    asked = _times(times or f"0:1:{4 * (len(shapes) - 1) + 1}")
    if min(asked) < 0 or max(asked) > 1:
        raise ValueError(f"morph --times {times}: the shapes stand between the times 0 and 1; ask for times in between.")
    _evolve(run, "morph", shapes, at, equation, asked, output, resolution=resolution)


@app.command()
def mesh(
    field: Annotated[Path, typer.Argument(metavar="FIELD", help="A field (.safetensors).")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The mesh to write: .ply, .obj, .off or .stl.")],
    at: Annotated[float | None, typer.Option("--time", help="When; needed for a field that moves.")] = None,
    resolution: Resolution = 128,
    refine: Annotated[int, typer.Option(help="Steps that move each vertex onto the surface itself.")] = 0,
) -> None:
    """Extract the surface of a field as a mesh, in the units of the shape it came from."""
    from levelflow.extraction import extract
    from levelflow.saving import load

    loaded = load(field)
    if loaded.times and at is None:
        (first, last) = loaded.box.times[0]
        raise ValueError(f"mesh {field}: the field moves from t = {first:g} to {last:g}; say when with --time.")
    if at is not None and not loaded.times:
        raise ValueError(f"mesh {field} --time {at:g}: the field does not depend on time; leave --time out.")
    surface = extract(loaded if at is None else loaded.at(at), resolution=resolution, refine=refine)
    surface.write(output)
    typer.echo(f"{output}: {len(surface.vertices):,} vertices, {len(surface.faces):,} faces")


@app.command()
def measure(
    a: Annotated[str, typer.Argument(metavar="A", help="A shape.")],
    b: Annotated[str, typer.Argument(metavar="B", help="Another.")],
    n: Annotated[int, typer.Option("-n", help="Points drawn from each surface.")] = 30_000,
    seed: Seed = 0,
) -> None:
    """Distances between two surfaces, and the area and volume of each, in their own units."""
    import torch

    from levelflow.measures import surface_distance
    from levelflow.shapes import Mesh

    surfaces = [_surface(text) for text in (a, b)]
    for text, surface in zip((a, b), surfaces, strict=True):
        if isinstance(surface, Mesh):
            typer.echo(f"{text}: area {surface.area:.6g}, volume {surface.volume:.6g}")
    distance = surface_distance(*surfaces, n=n, generator=torch.Generator().manual_seed(seed))
    typer.echo(f"chamfer {distance.chamfer:.6g}, Hausdorff {distance.hausdorff:.6g}")
    for title, spread in ((f"{a} to {b}", distance.there), (f"{b} to {a}", distance.back)):
        typer.echo(f"{title}: mean {spread.mean:.6g}, max {spread.max:.6g}")


@app.command()
def info(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A field, a checkpoint, a mesh or a point cloud.")],
) -> None:
    """What a file holds."""
    from levelflow.shapes import Mesh

    if file.suffix == ".safetensors":
        from levelflow.saving import describe

        typer.echo(json.dumps(describe(file), indent=2))
        return
    surface = _surface(str(file))
    if isinstance(surface, Mesh):
        body = "body" if surface.components == 1 else "bodies"
        typer.echo(f"{file}: {len(surface.vertices):,} vertices, {len(surface.faces):,} faces, {surface.components} {body}")
        typer.echo(f"watertight: {'yes' if surface.is_watertight else 'no'}")
        typer.echo(f"area {surface.area:.6g}, volume {surface.volume:.6g}")
        uncertainty = surface.sign_uncertainty()
        typer.echo(f"inside is uncertain in {100 * uncertainty.share:.2g} % of the box")
    else:
        typer.echo(f"{file}: {surface!r}")
    typer.echo(f"box from {_point(surface.box.lower)} to {_point(surface.box.upper)}")


def _evolve(
    run: Run,
    verb: str,
    inputs: Sequence[str],
    at: dict[float, Key],
    equation: Equation,
    times: Sequence[float],
    folder: Path,
    *,
    resolution: int,
    title: str | None = None,
) -> list[Any]:
    """Solves, and writes the field, the meshes, the contact sheet and the report."""
    import torch

    from levelflow.export.frames import write_frames
    from levelflow.measures import residual_table
    from levelflow.networks.siren import SIREN
    from levelflow.saving import save
    from levelflow.conditions import surface_of
    from levelflow.shapes.writing import replace_file
    from levelflow.solving import solve

    if resolution < 2:
        raise ValueError(f"--resolution {resolution}: give at least 2 cells.")
    folder.mkdir(parents=True, exist_ok=True)
    checkpoint = folder / "checkpoint.safetensors"
    started = time.perf_counter()
    space = _box(next(iter(at.values()))).space
    settings = run.settings(verb, inputs, equation=repr(equation), times=[min(times), max(times)])
    with _training(run, f"{verb} {' '.join(inputs)}", checkpoint, settings) as (on_step, state):
        field = solve(
            equation, SIREN(space, 1, width=run.width, depth=run.depth).to(_device(run.device)), at=at,
            until=(min(times), max(times)), budget=_budget(run), seed=run.seed, on_step=on_step, state=state,
        )  # fmt: skip
    trained = time.perf_counter()
    field.provenance["inputs"] = list(inputs)
    save(field, folder / "field.safetensors")
    frames = write_frames(
        field, times, folder, resolution=resolution, title=title,
        on_frame=lambda frame: run.say(f"  {frame.file or f't = {frame.time:g}: the surface has vanished'}"),
    )  # fmt: skip
    t0, key = next(iter(at.items()))
    table = residual_table(
        field, equation, surface_of(key), time=t0, generator=torch.Generator().manual_seed(run.seed)
    )
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
    checkpoint.unlink(missing_ok=True)
    for t, accuracy in field.provenance["accuracy"].items():
        run.say(f"at t = {t}: {_accuracy(accuracy, field.box)}")
    run.say(f"{folder}: field.safetensors, {sum(f.mesh is not None for f in frames)} meshes, frames.png, report.json")
    return frames


@contextmanager
def _training(
    run: Run, title: str, checkpoint: Path, settings: dict[str, Any]
) -> Iterator[tuple[Callable[[Progress], None], dict[str, Any] | None]]:
    """What a training run needs around it: a bar, checkpoints, the state to go on from, and a word when it ends."""
    from levelflow.minimising import Divergence
    from levelflow.progress import Bar
    from levelflow.saving import load_checkpoint, save, save_checkpoint

    state = None
    if run.resume:
        if not checkpoint.exists():
            raise ValueError(f"--resume: there is no interrupted run in {checkpoint.parent}; leave --resume out.")
        state = load_checkpoint(checkpoint, settings)
        run.say(f"going on from step {int(state['progress'][0])}")
    elif checkpoint.exists():
        raise ValueError(
            f"{checkpoint.parent} holds an interrupted run. Go on with it by --resume, "
            f"choose another output, or remove {checkpoint}."
        )
    saved = time.perf_counter()
    with Bar(title, quiet=run.quiet) as bar:

        def on_step(progress: Progress) -> None:
            nonlocal saved
            bar(progress)
            if time.perf_counter() - saved > CHECKPOINT_SECONDS:
                save_checkpoint(checkpoint, progress.state(), settings)
                saved = time.perf_counter()

        try:
            yield on_step, state
        except Divergence as error:
            last = checkpoint.with_name("last-good.safetensors")
            save(error.field, last)
            raise Divergence(f"{error} It is saved as {last}.") from None


def _key(text: str, *, solid: bool = False) -> Key:
    """The shape or static field that an argument names."""
    from levelflow.boxes import Box
    from levelflow.shapes import Mesh, PointCloud
    from levelflow.shapes.reading import read_contents

    if text in BUILTINS:
        return _builtin(text)
    path = Path(text)
    suffix = path.suffix.lower()
    if not path.exists() and not suffix:
        raise FileNotFoundError(f"{text!r} is neither a file nor a built-in shape ({', '.join(BUILTINS)}).")
    if suffix == ".safetensors":
        from levelflow.saving import load

        field = load(path)
        if field.times:
            raise ValueError(f"{text}: the field moves; write its surface at one time first: levelflow mesh {text} --time T")
        return field
    if suffix in (".xyz", ".txt", ".csv", ".npy") or (
        suffix == ".ply" and not len(read_contents(path, call="levelflow", formats=(".ply",)).sizes)
    ):
        cloud = PointCloud.read(path)
        if solid:
            raise ValueError(f"{text} is a point cloud, which has no inside; fit a field first: levelflow fit {text} -o ...")
        return cloud
    return Mesh.read(path)


def _surface(text: str) -> Shape:
    from levelflow.conditions import surface_of

    return surface_of(_key(text))


def _builtin(name: str) -> Shape:
    from levelflow import shapes

    made: dict[str, Callable[[], Shape]] = {
        "sphere": lambda: shapes.Sphere(0.5),
        "cuboid": lambda: shapes.Cuboid((1.0, 1.0, 1.0)),
        "rounded-cuboid": lambda: shapes.Cuboid((1.0, 1.0, 1.0), radius=0.15),
        "torus": lambda: shapes.Torus(0.5, 0.2),
        "cylinder": lambda: shapes.Cylinder(0.3, 1.0),
        "capsule": lambda: shapes.Capsule(0.3, 0.8),
        "dumbbell": lambda: shapes.Rotated(shapes.Dumbbell(0.3, 1.0, 0.12), math.pi / 2, (0.0, 1.0, 0.0)),
    }
    return made[name]()


def _velocity(
    name: str,
    *,
    by: str | None,
    rate: float | None,
    axis: tuple[float, ...],
    center: tuple[float, ...],
    reach: float | None,
    length: float,
    unit: float,
) -> VelocityField:
    """A velocity field by its name; `length` is the unit of lengths that were given, `unit` that of defaults."""
    from levelflow.equations import Constant, Rotation, Source, Twist

    if name == "translation":
        moved = (0.5 * unit, 0.0, 0.0) if by is None else tuple(length * v for v in _numbers(by, "--by"))
        return Constant(moved)
    if name == "rotation":
        return Rotation(math.pi / 2 if rate is None else rate, axis, center)
    if name == "twist":
        return Twist(1 / unit if rate is None else rate / length, axis, center)
    if name in ("source", "sink"):
        strength = (1.0 if rate is None else rate) * (1 if name == "source" else -1)
        return Source(center, strength, 0.18**0.5 * unit if reach is None else reach * length)
    raise ValueError(f"--velocity {name}: known are translation, rotation, twist, source and sink.")


def _budget(run: Run) -> Any:
    from levelflow.minimising import Budget

    return Budget(run.steps if run.steps or run.seconds else 1500, run.seconds)


def _device(name: str) -> Any:
    import torch

    try:
        device = torch.device(name)
    except RuntimeError:
        raise ValueError(f"--device {name}: there is no such kind of device; give cpu or cuda.") from None
    if device.type == "cuda" and not torch.cuda.is_available():
        raise ValueError(f"--device {name}: PyTorch sees no CUDA device here; leave the option out, or see the README.")
    return device


def _times(text: str | None) -> list[float]:
    """`0,0.5,1` or `first:last:number`."""
    try:
        if text and ":" in text:
            first, last, number = text.split(":")
            count = int(number)
            values = [float(first) + (float(last) - float(first)) * i / max(1, count - 1) for i in range(count)]
        else:
            values = [float(part) for part in (text or "").split(",")]
    except ValueError:
        values = []
    if not values or not all(math.isfinite(v) for v in values):
        raise ValueError(f"--times {text}: give numbers, 0,0.5,1, or first:last:number, 0:1:5.")
    return sorted({round(v, 12) + 0.0 for v in values})


def _numbers(text: str, option: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{option} {text}: give numbers with commas between them, 0,1,0.") from None


def _box(key: Key) -> Box:
    from levelflow.conditions import surface_of

    return surface_of(key).box


def _half_box(key: Key) -> float:
    """The length that `--relative` counts in: half the longest side of the box that a field for the shape has."""
    from levelflow.conditions import box_around

    return box_around([_box(key)]).frame.scale


def _warn_of_distance(names: Sequence[str], boxes: Sequence[Box]) -> None:
    """Shapes of very different size or place are morphed as they are; that is seldom meant."""
    first = boxes[0]
    for name, box in zip(names[1:], boxes[1:], strict=True):
        ratio = max(box.size) / max(first.size)
        gap = max(abs(a - b) for a, b in zip(first.center, box.center, strict=True))
        if not 1 / 3 < ratio < 3 or gap > max(*first.size, *box.size):
            warnings.warn(
                f"{name} is {ratio:.3g} times as large as {names[0]} and {gap:.3g} away from it; "
                "shapes are morphed at the size and place that their files say.",
                stacklevel=2,
            )


def _fingerprint(text: str) -> str:
    """The name of an input, with the size of its file and a checksum of its bytes."""
    import zlib

    path = Path(text)
    if text in BUILTINS or not path.is_file():
        return text
    return f"{path.name}:{path.stat().st_size}:{zlib.crc32(path.read_bytes()):08x}"


def _accuracy(accuracy: dict[str, float], box: Box) -> str:
    share = 100 * accuracy["mean"] / max(box.size)
    return f"mean distance to the given surface {accuracy['mean']:.3g}, at most {accuracy['max']:.3g} ({share:.2g} % of the box)"


def _point(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{v:g}" for v in values) + ")"


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"levelflow {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    pass


def main() -> None:
    """Runs the command line. Exit codes: 0 done, 1 failed, 2 used wrongly, 130 interrupted."""
    arguments = [a for a in sys.argv[1:] if a != "--debug"]
    debug = len(arguments) < len(sys.argv) - 1
    warnings.showwarning = lambda message, *_, **__: typer.echo(f"warning: {message}", err=True)  # type: ignore[assignment]
    try:
        app(args=arguments)
    except KeyboardInterrupt:
        typer.echo("interrupted; --resume goes on from the last checkpoint.", err=True)
        sys.exit(130)
    except Exception as error:
        if debug:
            raise
        wrong_use = isinstance(error, (ValueError, TypeError, FileNotFoundError, NotADirectoryError, IsADirectoryError))
        typer.echo(f"error: {error}", err=True)
        sys.exit(2 if wrong_use and not _is_failure(error) else 1)


def _is_failure(error: Exception) -> bool:
    """Whether a wrong value is the outcome of the work and not of the command."""
    return type(error).__name__ == "EmptyLevelSet"
