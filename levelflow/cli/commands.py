"""The commands."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from levelflow._version import __version__
from levelflow.cli.deforming import deform
from levelflow.cli.families import family, mix
from levelflow.cli.filtering import filter_shape
from levelflow.cli.following import edit
from levelflow.cli.following import evolve as follow
from levelflow.cli.lifting import lift, slice_field
from levelflow.cli.masking import Fix, MaskBy, MaskFile, Only, Soft, mask_of, masked
from levelflow.cli.names import (
    box_of,
    builtin,
    center_in,
    edge_radius,
    half_box,
    key_named,
    numbers_in,
    place_in,
    solid_named,
    surface_named,
    times_in,
    velocity_named,
    warn_of_distance,
)
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
    Times,
    Width,
)
from levelflow.cli.retiming import retime
from levelflow.cli.running import (
    CHECKPOINT,
    CHECKPOINT_SECONDS,
    Run,
    accuracy_in_words,
    evolve,
    folder_for,
    training,
)
from levelflow.cli.showing import film, render
from levelflow.cli.taking import export
from levelflow.cli.viewing import view

if TYPE_CHECKING:
    from levelflow.conditions import Key
    from levelflow.equations import Equation

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Evolve surfaces: smooth, move and morph meshes as the zero set of one neural field in space and time.",
    epilog="SHAPE is a mesh (.obj .ply .stl .off .glb), a point cloud (.ply .xyz .txt .csv .npy), a field written by "
    "this program (.safetensors), or one of: sphere, cuboid, rounded-cuboid, torus, cylinder, capsule, dumbbell. "
    "Add --debug to any command for a traceback.",
)


@app.command()
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="The folder for the results.")] = Path("demo-output"),
    steps: Annotated[int, typer.Option(help="Training steps of each of the three evolutions.")] = 300,
    quiet: Quiet = False,
) -> None:
    """Smooth a dumbbell until it pinches, twist a block, and morph a torus: about a minute on two cores."""
    from levelflow.equations import MeanCurvature, Morph, Transport, Twist
    from levelflow.rendering.film import film
    from levelflow.rendering.images import contact_sheet, stack
    from levelflow.saving import load
    from levelflow.shapes import Cuboid, Torus
    from levelflow.shapes.writing import replace_file
    from levelflow.viewer.page import standalone
    from levelflow.viewer.viewed import ViewedField

    block, ring = Cuboid((0.5, 1.4, 0.5), radius=0.1), Torus(0.55, 0.22)
    ball = Cuboid((1.0, 1.0, 1.0), radius=0.15)
    rows: tuple[tuple[str, str, dict[float, Key], Equation], ...] = (
        ("smooth", "a dumbbell under mean curvature", {0.0: builtin("dumbbell")}, MeanCurvature(0.012)),
        ("advect", "a block under a twist", {0.0: block}, Transport(Twist(2.0))),
        ("morph", "a torus into a rounded cube", {0.0: ring, 1.0: ball}, Morph(ball)),
    )
    sheets, viewed = [], []
    for name, title, at, equation in rows:
        run = Run(steps, None, 0, "cpu", quiet, False, 64, 3)
        times = [i / 4 for i in range(5)]
        folder = output / name
        (folder / CHECKPOINT).unlink(missing_ok=True)
        frames = evolve(
            run, name, [name], at, equation, times, folder, resolution=96, title=title, distil=name != "advect"
        )
        sheets.append(
            contact_sheet([f.mesh for f in frames], [f"t = {f.time:g}" for f in frames], title=title, size=300)
        )
        viewed.append(ViewedField(load(folder / "field.safetensors"), name=title))
    stack(sheets, output / "demo.png")
    page = standalone(viewed, [i / 12 for i in range(13)], resolution=64)
    replace_file(output / "demo.html", page.encode())
    last = viewed[-1].field
    film(last, output / "demo.gif", times=[i / 16 for i in range(17)], size=320, resolution=64, bounce=True)
    if not quiet:
        typer.echo(f"{output / 'demo.png'}: three evolutions; their meshes, fields and reports are in {output}")
        typer.echo(f"{output / 'demo.html'}: the same in motion, a page to open in a browser")
        typer.echo(f"{output / 'demo.gif'}: the last of them as a film")


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
    from levelflow.saving import Checkpoint, save

    run = Run(steps, seconds, seed, device, quiet, resume, width, depth)
    if output.suffix != ".safetensors":
        raise ValueError(
            f"fit -o {output}: a field is a .safetensors file; name it {output.with_suffix('.safetensors')}."
        )
    surface = surface_named(shape)
    output.parent.mkdir(parents=True, exist_ok=True)
    kept = Checkpoint(
        output.with_name(f"{output.stem}.checkpoint.safetensors"),
        settings=run.settings("fit", [shape]),
        seconds=CHECKPOINT_SECONDS,
    )
    with training(run, f"fitting {shape}", kept) as (on_step, state):
        field = fit_field(
            run.network(surface.box.space), surface, budget=run.budget(), seed=seed, on_step=on_step, state=state
        )
    field.provenance["inputs"] = [shape]
    save(field, output)
    kept.remove()
    run.say(f"{output}: {accuracy_in_words(field.provenance['accuracy'], field.box)}")


@app.command()
def smooth(
    shape: ShapeArgument,
    output: Folder = None,
    rate: Annotated[
        float | None, typer.Option(help="Rate of mean curvature motion, length^2 per time; by default by the size.")
    ] = None,
    keep_edges: Annotated[
        str | None,
        typer.Option(
            metavar="RADIUS",
            help="Let bends sharper than this radius, a length, hardly move; auto: by the size.",
        ),
    ] = None,
    times: Times = "0:1:5",
    relative: Relative = False,
    keep_volume: Annotated[
        bool, typer.Option("--keep-volume", help="Take the mean speed away, so that the volume stays what it is.")
    ] = False,
    mask: MaskFile = None,
    mask_by: MaskBy = None,
    fix: Fix = None,
    only: Only = None,
    soft: Soft = None,
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
    """Smooth a shape by motion along its mean curvature; negative times sharpen it.

    With a mask, at a rate of its own in every place: what stands still is a boundary for the rest.
    """
    from levelflow.equations import FeaturePreserving, LevelSetEquation, MeanCurvature, VolumePreserving

    run = Run(steps, seconds, seed, device, quiet, resume, width, depth)
    key = key_named(shape)
    unit = half_box(box_of(key))
    speed = 1e-3 * unit**2 if rate is None else rate * unit**2 if relative else rate
    sharpest = None if keep_edges is None else edge_radius(keep_edges, unit=unit, relative=relative)
    motion: LevelSetEquation = MeanCurvature(speed) if sharpest is None else FeaturePreserving(speed, 1 / sharpest)
    motion = masked(motion, mask_of(key, mask, mask_by, fix, only, soft, relative=relative))
    motion = VolumePreserving(motion) if keep_volume else motion
    folder, inputs = output or folder_for([shape], "smooth"), [shape, *([str(mask)] if mask else [])]
    evolve(run, "smooth", inputs, {0.0: key}, motion, times_in(times), folder, resolution=resolution)


@app.command()
def advect(
    shape: ShapeArgument,
    output: Folder = None,
    velocity: Annotated[
        str, typer.Option(help="translation, rotation, twist, source, sink; several with + between them.")
    ] = "rotation",
    by: Annotated[str | None, typer.Option(help="Velocity of a translation, x,y,z.")] = None,
    rate: Annotated[
        float | None,
        typer.Option(help="Radians per time (rotation), per time and length (twist), or strength (source, sink)."),
    ] = None,
    axis: Annotated[str, typer.Option(help="Direction of a rotation or twist, x,y,z.")] = "0,1,0",
    center: Annotated[str | None, typer.Option(help="A point x,y,z; by default the centre of the box.")] = None,
    reach: Annotated[float | None, typer.Option(help="Width of a source or sink, a length.")] = None,
    distil: Annotated[
        bool, typer.Option("--distil", help="Train one network in space and time: less exact, with nothing to carry.")
    ] = False,
    times: Times = "0:1:5",
    relative: Relative = False,
    mask: MaskFile = None,
    mask_by: MaskBy = None,
    fix: Fix = None,
    only: Only = None,
    soft: Soft = None,
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
    """Carry a shape along a velocity field: the field fitted to it, on characteristics.

    With a mask, along the velocity times the mask.
    """
    from levelflow.equations import SumOfVelocities, Transport

    run = Run(steps, seconds, seed, device, quiet, resume, width, depth)
    key = key_named(shape)
    box = box_of(key)
    unit = half_box(box)
    middle = center_in(center, box, unit if relative else None)
    length = unit if relative else 1.0
    velocities = [
        velocity_named(name.strip(), by=by, rate=rate, axis=numbers_in(axis, "--axis"), center=middle, reach=reach,
                  length=length, unit=unit)
        for name in velocity.split("+")
    ]  # fmt: skip
    motion = Transport(velocities[0] if len(velocities) == 1 else SumOfVelocities(tuple(velocities)))
    equation = masked(motion, mask_of(key, mask, mask_by, fix, only, soft, relative=relative))
    folder, inputs = output or folder_for([shape], "advect"), [shape, *([str(mask)] if mask else [])]
    evolve(run, "advect", inputs, {0.0: key}, equation, times_in(times), folder, resolution=resolution, distil=distil)


@app.command()
def morph(
    shapes: Annotated[list[str], typer.Argument(metavar="A B [C ...]", help="Two shapes or more.")],
    output: Folder = None,
    loop: Annotated[
        bool, typer.Option("--loop", help="Back to the first shape at the end, in a motion without a seam.")
    ] = False,
    simplex: Annotated[
        bool, typer.Option("--simplex", help="Mix all shapes: three over a triangle, four over a tetrahedron, ...")
    ] = False,
    times: Times = None,
    grid: Annotated[int, typer.Option(help="Steps along each side of the triangle that is shown, with --simplex.")] = 4,
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
    """Morph shapes into each other; they stand at equal steps of time from 0 to 1.

    With --simplex there is a surface for every mixture of them. Its parameters are the shares of B, C, ..., as in
    --time 0.3,0.5 of other commands; the rest is the share of A.
    """
    from levelflow.equations import Morph

    if len(shapes) < 2:
        raise ValueError(f"morph {shapes[0]}: one shape is given; name at least two.")
    run = Run(steps, seconds, seed, device, quiet, resume, width, depth)
    solids = [solid_named(shape) for shape in shapes]
    warn_of_distance(shapes, [box_of(solid) for solid in solids])
    folder = output or folder_for(shapes, "morph")
    if simplex:
        if times is not None or loop:
            raise ValueError("morph --simplex: a mixture has shares and no time; leave --times and --loop out.")
        mix(run, shapes, solids, folder, grid=grid, resolution=resolution)
        return
    gaps = len(shapes) if loop else len(shapes) - 1
    at: dict[float, Key] = {i / gaps: solid for i, solid in enumerate(solids)}
    targets = {t: solid for t, solid in zip(at, solids, strict=True) if t > 0}
    equation = Morph(targets | {1.0: solids[0]} if loop else targets)
    asked = times_in(times or f"0:1:{4 * gaps + 1}")
    if min(asked) < 0 or max(asked) > 1:
        raise ValueError(
            f"morph --times {times}: the shapes stand between the times 0 and 1; ask for times in between."
        )
    evolve(run, "morph", shapes, at, equation, asked, folder, resolution=resolution, loop=loop)


@app.command()
def mesh(
    field: Annotated[Path, typer.Argument(metavar="FIELD", help="A field (.safetensors).")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The mesh to write: .ply, .obj, .off or .stl.")],
    time: Annotated[
        str | None, typer.Option("--time", help="When, for a field that moves: 0.5, or 0.5,0.2 for two parameters.")
    ] = None,
    resolution: Resolution = 128,
    refine: Annotated[int, typer.Option(help="Steps that move each vertex onto the surface itself.")] = 0,
) -> None:
    """Extract the surface of a field as a mesh, in the units of the shape it came from."""
    from levelflow.extraction import extract
    from levelflow.saving import load

    loaded = load(field)
    place = place_in(time, loaded, f"mesh {field}")
    surface = extract(loaded.at(*place) if place else loaded, resolution=resolution, refine=refine)
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

    surfaces = [surface_named(text) for text in (a, b)]
    for text, surface in zip((a, b), surfaces, strict=True):
        if isinstance(surface, Mesh):
            typer.echo(f"{text}: area {surface.area:.6g}, volume {surface.volume:.6g}")
    distance = surface_distance(*surfaces, n=n, generator=torch.Generator().manual_seed(seed))
    typer.echo(f"chamfer {distance.chamfer:.6g}, Hausdorff {distance.hausdorff:.6g}")
    for title, spread in ((f"{a} to {b}", distance.there), (f"{b} to {a}", distance.back)):
        typer.echo(f"{title}: mean {spread.mean:.6g}, max {spread.max:.6g}")


@app.command()
def bench(
    cases: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[CASE ...]",
            help="Some of: sphere, sharpening, cylinder, tori, corrugated, dumbbell, catenoid, rings, scherk, "
            "periodic, willmore, volume, families, heat, features, followed, moved, standing, enright, morph, rates, "
            "fit; all by default.",
        ),
    ] = None,
    shape: Annotated[
        str, typer.Option("--mesh", metavar="SHAPE", help="What is carried around and fitted.")
    ] = "rounded-cuboid",
    steps: Steps = None,
) -> None:
    """Solve evolutions whose answer is known, and say how far off they are; exit code 1 if a limit is missed."""
    import torch

    from levelflow.minimising import DEFAULT_BUDGET, Budget
    from levelflow.shapes import Solid
    from levelflow.suite import CASES, HEADER, Suite, rows

    if unknown := set(cases or ()) - set(CASES):
        raise ValueError(f"bench: there is no case {', '.join(sorted(unknown))}; known are {', '.join(CASES)}.")
    solid = solid_named(shape)
    if not isinstance(solid, Solid):
        raise ValueError(f"bench --mesh {shape}: give a mesh or a built-in shape.")
    each = DEFAULT_BUDGET if steps is None else Budget(steps)
    typer.echo(f"{torch.get_num_threads()} threads, PyTorch {torch.__version__}, {each.steps} steps each\n{HEADER}")
    missed = False
    for row in rows(Suite(solid, Path(shape).stem, each), cases or list(CASES)):
        typer.echo(str(row))
        missed |= not row.error <= row.limit
    if missed:
        raise typer.Exit(1)


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
    surface = surface_named(str(file))
    if isinstance(surface, Mesh):
        body = "body" if surface.components == 1 else "bodies"
        typer.echo(
            f"{file}: {len(surface.vertices):,} vertices, {len(surface.faces):,} faces, {surface.components} {body}"
        )
        typer.echo(f"watertight: {'yes' if surface.is_watertight else 'no'}")
        typer.echo(f"area {surface.area:.6g}, volume {surface.volume:.6g}")
        uncertainty = surface.sign_uncertainty()
        typer.echo(f"inside is uncertain in {100 * uncertainty.share:.2g} % of the box")
    else:
        typer.echo(f"{file}: {surface!r}")
    typer.echo(f"box from {_point(surface.box.lower)} to {_point(surface.box.upper)}")


app.command()(edit)
app.command()(deform)
app.command("evolve")(follow)
app.command()(export)
app.command()(family)
app.command()(film)
app.command("filter")(filter_shape)
app.command()(lift)
app.command()(render)
app.command()(retime)
app.command("slice")(slice_field)
app.command()(view)


def _point(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{v:g}" for v in values) + ")"


def _version(asked: bool) -> bool:
    if asked:
        typer.echo(f"levelflow {__version__}")
        raise typer.Exit
    return asked


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Options of the program itself."""
