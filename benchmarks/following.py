"""Do fields go where a flow takes their mesh? `evolve` against the rivals of nie-2022, Sec. 5, on its figures.

    python benchmarks/following.py [FIGURE ...] [--mesh FILE] [-o following.md]

Each figure prints a table; all of them, with what the paper shows and a picture, are written as a document, which has
its picture beside it. Figures: `plane` (figure 3: a flat side that moves along its normal), `tangential` (figure 4: a
motion along a ball), `ball` (a ball under mean curvature, whose radius is known), `block` (figure 7: what has no holes
becomes round), `scan` (figure 6: a scan is smoothed), `orders` (what the flow of a mesh owes to the step of time and to
the extraction), `cells` (the same of the field that follows).

Rivals (meshsdf.py, raymarching.py) have the call of `evolve` and see the same flow of a mesh of the same resolution;
what each row is stands at the head of the document. The paper says that they take a single step of gradient descent for
a step of the flow, and gives no rate for them, no network, no steps of time and no numbers. All here start from the
same fitted network, our default one but half as wide for the built-in shapes. Seconds are of the processor.

Reference:
    Mehta et al., A Level Set Theory for Neural Implicit Evolution under Explicit Flows, ECCV 2022, Secs. 5 and 6.1.
"""

from __future__ import annotations

import argparse
import math
import os
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import meshsdf
import numpy as np
import raymarching
import torch
from jaxtyping import UInt8
from torch import Tensor

from levelflow import (
    SIREN,
    Box,
    Budget,
    Cuboid,
    Mesh,
    MeshWarning,
    Placed,
    Sampling,
    Sphere,
    Torus,
    contact_sheet,
    evolve,
    extract,
    fit,
    flows,
)
from levelflow.curvature import gradient_norm
from levelflow.equations import Rotation
from levelflow.flows import Flow
from levelflow.measures import surface_distance
from levelflow.rendering.images import stack
from levelflow.shapes import Solid

CUBE = Box((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))
ADAM = partial(torch.optim.Adam, lr=2e-6)
METHODS: Mapping[str, Callable[..., Placed]] = {
    "ours": evolve,
    "MeshSDF": meshsdf.evolve,
    "MeshSDF, 8 descents": partial(meshsdf.evolve, parts=8),
    "MeshSDF, Adam": partial(meshsdf.evolve, optimiser=ADAM),
    "MeshSDF, Adam 2e-6": partial(meshsdf.evolve, optimiser=ADAM, search=False),
    "ray marching": raymarching.evolve,
    "ray marching, 8": partial(raymarching.evolve, parts=8),
}
TORUS = (1.0, 0.5, 0.136644)
"""The radii of a torus, and when it collapses under mean curvature of rate 1 (`ring` of tests/axisymmetric.py)."""

RADIUS, RATE, UNTIL = 0.5, 0.1, 0.25
"""Of a ball under mean curvature, beside the torus: its radius, the rate and the time."""

SMOOTHING = ("ours", "MeshSDF", "MeshSDF, 8 descents", "MeshSDF, Adam", "ray marching")
"""Methods that are asked to smooth."""

SHOWN = ("ours", "MeshSDF", "MeshSDF, 8 descents", "ray marching")
"""Methods in the pictures of smoothing."""


HEAD = """# Fields that follow a flow: ours and the rivals of nie-2022

Made by `python benchmarks/following.py -o docs/following.md`; do not edit. nie-2022, Sec. 5, says of two other ways to
let a network follow a flow of its surface that they do not go where the flow does: differentiable iso-surface
extraction, MeshSDF, and differentiable ray marching, as in DVR and IDR. Both take a single step of descent in the
weights for a step of the flow. Here they have the call of `evolve`, start from the same network and see the same flow
of a mesh of the same resolution.

| row | what it is |
|---|---|
| ours | `evolve`, trained until the surface is within 0.0005 of half the box from where the flow takes it |
| MeshSDF | one descent along the gradient a step ([meshsdf.py](../benchmarks/meshsdf.py)) |
| MeshSDF, 8 descents | eight a step, each with an extraction and a flow of its own |
| MeshSDF, Adam | one descent a step along Adam's direction |
| MeshSDF, Adam 2e-6 | one step of Adam, as long as it is at the rate of the paper's published code |
| ray marching | one a step of what 6 x 32 x 32 parallel rays see ([raymarching.py](../benchmarks/raymarching.py)) |
| ray marching, 8 | eight a step, each with rays of its own |

The paper gives the rivals no rate, no network and no steps of time, and prints no numbers of these figures. So that no
choice of a rate speaks against them, a descent is as long as brings the surface, to first order, closest to what the
flow asks for; only the row with 2e-6 is not. Seconds are of the processor, without the fit, on a machine that others
used as well. Cells with three numbers have the mean, the least and the greatest; the slope is |grad f| on the
surface."""


@dataclass
class Section:
    """A figure: what it is, what the paper shows, tables of what was found, and a picture.

    Attributes:
        title: Of the figure.
        setting: What was done, in words.
        paper: What the paper shows or says, in words.
        found: What the numbers say to that.
        tables: Each with its header.
        picture: Five surfaces side by side, if there is one.
    """

    title: str
    setting: str
    paper: str = ""
    found: str = ""
    tables: list[tuple[list[str], list[list[str]]]] = field(default_factory=list)
    picture: UInt8[np.ndarray, "h w 3"] | None = None

    def table(self, *header: str) -> Callable[[Sequence[str]], None]:
        """Begins a table; what is returned prints a row and adds it."""
        rows: list[list[str]] = []
        self.tables.append((list(header), rows))
        widths = [max(len(header[0]), 20), *(len(name) + 2 for name in header[1:])]

        def add(row: Sequence[str]) -> None:
            rows.append(list(row))
            widths[1:] = [max(w, len(cell) + 2) for w, cell in zip(widths[1:], row[1:], strict=True)]
            if len(rows) == 1:
                print(f"\n{self.title}\n{_aligned(header, widths)}")
            print(_aligned(row, widths), flush=True)

        return add

    def __str__(self) -> str:
        parts = [f"## {self.title}", self.setting]
        parts += [f"**Paper:** {self.paper}"] * bool(self.paper) + [f"**Found:** {self.found}"] * bool(self.found)
        for header, rows in self.tables:
            parts.append("\n".join([_line(header), "|" + "---|" * len(header), *map(_line, rows)]))
        return "\n\n".join(parts)


def fitted(shape: Solid, *, width: int = 64, steps: int = 500, box: Box | None = CUBE) -> Placed:
    """The network that all methods start from."""
    return fit(SIREN(shape.box.space, width=width), shape, box=box, budget=Budget(steps), sampling=Sampling(4096))


def followed(name: str, start: Placed, flow: Flow, *, dt: float, steps: int, **more: object) -> tuple[Placed, float]:
    """The evolution of a method, and the seconds it took."""
    started = time.process_time()
    moved = METHODS[name](start, flow, dt=dt, steps=steps, **more)
    return moved, time.process_time() - started


def surface(moved: Placed, t: float, resolution: int = 64) -> tuple[Mesh, Tensor]:
    """The mesh of a field at a time, its vertices on the surface itself."""
    mesh = extract(moved.at(t), resolution=resolution, refine=3)
    return mesh, torch.tensor(mesh.vertices)


def slopes(moved: Placed, t: float, x: Tensor) -> str:
    """|grad f| on a surface: the mean, the least and the greatest."""
    with torch.no_grad():
        found = gradient_norm(moved.at(t).jet(x, order=1))
    return spread(found, 2)


def spread(values: Tensor, digits: int) -> str:
    """The mean of values, the least and the greatest."""
    return f"{values.mean():.{digits}f} ({values.min():.{digits}f} to {values.max():.{digits}f})"


def plane(options: argparse.Namespace) -> Section:
    """Figure 3."""
    body, dt, steps = Cuboid((1.4, 1.4, 0.5), radius=0.12), 0.02, 5
    section = Section(
        "Figure 3: a plane that moves along its normal",
        "A slab of 1.4 x 1.4 x 0.5 with round edges, as `evolve` follows closed surfaces, moves along its normals at "
        f"the speed 1, in {steps} steps of {dt:g}. How far its upper side, a plane, has come forward, at points "
        "farther than 0.2 from the edges, beside what is stated.",
        '"The motion attained using differentiable iso-surface extraction is inconsistent with the field. Our method '
        'propagates the front as expected." No numbers.',
    )
    start = fitted(body)
    times = [dt * i for i in range(1, steps + 1)]
    add = section.table("stated", *(f"{t:.2f}" for t in times), "slope", "s")
    meshes = {"start": extract(start, resolution=64)}
    worst = {}
    for name in METHODS:
        moved, seconds = followed(name, start, flows.NormalOffset(1.0), dt=dt, steps=steps, resolution=64)
        cells = []
        for t in times:
            meshes[name], x = surface(moved, t)
            flat = body.distance(x[(x[:, 2] > 0) & (x[:, :2].abs().amax(1) < 0.5)])
            cells.append(spread(flat, 3))
        worst[name] = float((flat / times[-1] - 1).abs().max())
        add([name, *cells, slopes(moved, times[-1], x), f"{seconds:.0f}"])
    section.found = (
        f"after {times[-1]:g} the plane is nowhere farther than {worst['ours']:.0%} of the way from where it belongs "
        f"under ours, and up to {worst['MeshSDF']:.0%} under MeshSDF with the best length of a step, which only brings "
        f"the mean right; {worst['MeshSDF, 8 descents']:.0%} with eight descents a step. With 2e-6 as the rate of Adam "
        f"it stays behind by up to {worst['MeshSDF, Adam 2e-6']:.0%}: a rate is no distance."
    )
    section.picture = pictures(meshes, "a slab whose sides move out by 0.1")
    return section


def tangential(options: argparse.Namespace) -> Section:
    """Figure 4."""
    body, dt, steps = Sphere(0.6), 0.02, 10
    section = Section(
        "Figure 4: a motion along the surface",
        f"A ball of radius {body.radius:g} turns about an axis by {dt:g} radians a step, {steps} times: its surface "
        "stays where it is. One camera looks at it across the axis; the last row has views from all around. By how "
        "much the surface is displaced: the mean size, and the least and the greatest displacement.",
        "under ray marching the surface is deformed, in proportion to the tangent of the angle between the ray and the "
        "normal (eq. 12); under the paper's method it stays. No numbers.",
    )
    start = fitted(body, steps=300)
    times = [0.0, dt, dt * steps / 2, dt * steps]
    add = section.table("radians", *(f"{t:g}" for t in times), "s")
    meshes = {"start": extract(start, resolution=64)}
    views = {"one camera": {"directions": [(-1.0, 0.0, 0.0)]}, "from all around": {}}
    turn = flows.Prescribed(Rotation(1.0, axis=(0.0, 0.0, 1.0)))
    displaced = {}
    for label, name, more in [
        ("ours", "ours", {}),
        ("MeshSDF", "MeshSDF", {}),
        *((f"ray marching, {view}", "ray marching", more) for view, more in views.items()),
    ]:
        moved, seconds = followed(name, start, turn, dt=dt, steps=steps, resolution=48, **more)
        cells = []
        for t in times:
            meshes[label], x = surface(moved, t)
            away = body.distance(x)
            cells.append(f"{away.abs().mean():.4f} ({away.min():.4f} to {away.max():.4f})")
        displaced[label] = float(away.abs().mean())
        add([label, *cells, f"{seconds:.0f}"])
    section.found = (
        f"in the end the surface is displaced by {displaced['ours']:.4f} under ours, and by "
        f"{displaced['ray marching, one camera']:.4f}, {displaced['ray marching, one camera'] / displaced['ours']:.0f} "
        "times as much, under ray marching. Iso-surface extraction has no such fault: its points move along normals."
    )
    section.picture = pictures(meshes, "a ball that turns by 0.2 radians")
    return section


def ball(options: argparse.Namespace) -> Section:
    """A ball under mean curvature."""
    body, rate, dt, steps = Sphere(0.6), 0.1, 0.03, 10
    times = [dt * steps / 2, dt * steps]
    exact = [math.sqrt(body.radius**2 - 4 * rate * t) for t in times]
    section = Section(
        "A ball under mean curvature",
        f"The radius is sqrt({body.radius:g}^2 - 4 rate t), with the rate {rate:g}; {steps} steps of {dt:g}.",
    )
    start = fitted(body, steps=300)
    add = section.table("radius", *(f"t = {t:g}: {r:.4f}" for t, r in zip(times, exact, strict=True)), "slope", "s")
    wrong = {}
    for name in SMOOTHING:
        moved, seconds = followed(name, start, flows.MeanCurvature(rate), dt=dt, steps=steps, resolution=64)
        radii = [surface(moved, t)[1].norm(dim=1) for t in times]
        wrong[name] = float((radii[-1] / exact[-1] - 1).abs().mean())
        cells = [spread(values, 4) for values in radii]
        add([name, *cells, slopes(moved, times[-1], surface(moved, times[-1])[1]), f"{seconds:.0f}"])
    section.found = (
        f"in the end the radius is wrong by {wrong['ours']:.1%} on average under ours, by {wrong['MeshSDF']:.1%} under "
        f"MeshSDF, by {wrong['MeshSDF, 8 descents']:.1%} with eight descents a step and by "
        f"{wrong['ray marching']:.1%} under ray marching. What the steps of the flow itself take is in the last tables."
    )
    return section


def block(options: argparse.Namespace) -> Section:
    """Figure 7."""
    section = Section(
        "Figure 7: what has no holes becomes round",
        "A block of 1.2 x 0.8 x 0.8 with round edges under mean curvature of rate 0.1.",
        '"A genus-0 surface morphs into a sphere using our method while MeshSDF retains high-curvature regions." No '
        "numbers.",
    )
    return smoothed(section, fitted(Cuboid((1.2, 0.8, 0.8), radius=0.06)), rate=0.1, dt=0.04, steps=10)


def scan(options: argparse.Namespace) -> Section | None:
    """Figure 6."""
    if not options.mesh.exists():
        print(f"\nscan: there is no {options.mesh}; name one with --mesh")
        return None
    shape = Mesh.read(options.mesh).normalized(0.1)
    start = fitted(shape, width=128, steps=800, box=None)
    error = start.provenance["accuracy"]["mean"]
    section = Section(
        "Figure 6: a scan is smoothed",
        f"{options.mesh.stem}, {max(shape.box.size):.2g} long, under mean curvature of rate 1, from a fit that is "
        f"{error:.1g} away from it on average. Eight descents a step are left out: among the meshes that they come to "
        "is one in whose flow the memory runs out.",
        '"MeshSDF fails to smoothen the surface": "the deformation is not curvature based and high-frequency features '
        'are retained". No numbers.',
    )
    methods = [name for name in SMOOTHING if name != "MeshSDF, 8 descents"]
    return smoothed(section, start, rate=1.0, dt=2.5e-4, steps=4, methods=methods)


def smoothed(
    section: Section,
    start: Placed,
    *,
    rate: float,
    dt: float,
    steps: int,
    methods: Sequence[str] = SMOOTHING,
) -> Section:
    """Mean curvature of a field by all methods, against the flow of its mesh alone."""
    flow, first = flows.MeanCurvature(rate), extract(start, resolution=96, refine=3)
    truth = alone(first, flow, dt / 3, 3 * steps)
    section.setting += (
        f" {steps} steps of {dt:g}, meshes of 64 cells along the box. The reference is the flow of the mesh alone, of "
        f"96 cells along the box, in {3 * steps} steps. In the end: the distance from the reference, on average and at "
        "most; by how much the area is too large; the greatest distance from the middle by the least."
    )
    add = section.table("at the end", "mean", "greatest", "area", "radii", "slope", "s")
    meshes, far = {"flow of the mesh": truth}, {}
    add(["reference", "", "", "", roundness(truth), "", ""])

    def judge(name: str, last: Placed, seconds: float) -> None:
        meshes[name] = found = extract(last, resolution=96, refine=3)
        gap = surface_distance(truth, found, n=10_000, generator=torch.Generator().manual_seed(0))
        with torch.no_grad():
            steep = gradient_norm(last.jet(torch.tensor(found.vertices), order=1))
        far[name] = gap.chamfer
        add([
            name, f"{gap.chamfer:.5f}", f"{gap.hausdorff:.4f}", f"{found.area / truth.area - 1:+.1%}", roundness(found),
            spread(steep, 2), f"{seconds:.0f}",
        ])  # fmt: skip

    judge("no motion", start, 0.0)
    for name in methods:
        moved, seconds = followed(name, start, flow, dt=dt, steps=steps, resolution=64)
        judge(name, moved.at(dt * steps), seconds)
    left = ", ".join(f"{far[name] / far['no motion']:.0%} under {name}" for name in methods)
    section.found = f"of the distance to the reference, {far['no motion']:.4f} on average, what is left is {left}."
    section.picture = pictures(meshes, section.title.partition(": ")[2])
    return section


def alone(mesh: Mesh, flow: Flow, dt: float, steps: int) -> Mesh:
    """A mesh after steps of a flow, without any field."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshWarning)
        for i in range(steps):
            mesh = Mesh(mesh.vertices + flow.displacement(mesh, dt, time=i * dt), mesh.faces)
    return mesh


def orders(options: argparse.Namespace) -> Section:
    """Orders of accuracy of the flow of a mesh by itself."""
    exact, torus, last = math.sqrt(RADIUS**2 - 4 * RATE * UNTIL), Torus(*TORUS[:2]), 0.8 * TORUS[2]
    section = Section(
        "Mean curvature flow of meshes alone: steps of time and cells",
        f"A ball of radius {RADIUS:g}, until its radius is {exact:.4f}: by how many per cent the mean radius is wrong. "
        f"A torus of the radii {TORUS[0]:g} and {TORUS[1]:g}: by how many per cent the time of its collapse is wrong, "
        "foretold at 0.8 of it from the area of the section. Meshes extracted with so many cells along the box; the "
        "numbers of steps double, and from the last two come the limit and, with the one before, the order.",
    )
    counts, cells, limits = (20, 40, 80), (16, 32, 64), []
    add = section.table("ball", *(f"{n} steps" for n in counts), "limit", "order")
    for resolution in cells:
        start = extract(Sphere(RADIUS).distance, box=CUBE, resolution=resolution, refine=3)
        found = [radial(alone(start, flows.MeanCurvature(RATE), UNTIL / n, n), exact) for n in counts]
        limits.append(abs(2 * found[-1] - found[-2]))
        add(extrapolated(f"{resolution} cells", found))
    add = section.table("torus", *(f"{n} steps" for n in counts), "limit", "order")
    for resolution in cells:
        start = extract(torus.distance, box=torus.box.expanded(0.2), resolution=resolution, refine=3)
        found = [collapse(alone(start, flows.MeanCurvature(1.0), last / n, n), last) for n in counts]
        add(extrapolated(f"{resolution} cells", found))
    section.found = (
        "the flow is of about the first order in the step of time. Extrapolated to no step, the ball is wrong by "
        f"{', '.join(f'{limit:.3%}' for limit in limits)} for {', '.join(map(str, cells))} cells, which is the order "
        f"{math.log2(limits[0] / limits[2]) / 2:.1f} in the cells."
    )
    return section


def resolutions(options: argparse.Namespace) -> Section:
    """The same with fields that follow."""
    exact, torus, last, steps = math.sqrt(RADIUS**2 - 4 * RATE * UNTIL), Torus(*TORUS[:2]), 0.8 * TORUS[2], 10
    section = Section(
        "Fields that follow mean curvature flow: cells",
        f"The same ball and torus under `evolve`, in {steps} steps, each of some substeps of the mesh: by how many "
        "per cent the mean radius and the time of the collapse are wrong, beside the mesh alone in as many steps.",
    )
    add = section.table("ball", "field", "mesh alone", "slope", "s")
    start, flow = fitted(Sphere(RADIUS), steps=300), flows.MeanCurvature(RATE)
    for resolution, substeps in ((64, 1), (32, 4), (64, 4)):
        moved, seconds = followed(
            "ours", start, flow, dt=UNTIL / steps, steps=steps, resolution=resolution, substeps=substeps
        )
        first = extract(start, resolution=resolution, refine=3)
        other = alone(first, flow, UNTIL / (steps * substeps), steps * substeps)
        found, x = surface(moved, UNTIL)
        add([
            f"{resolution} cells, {substeps} substeps", percent(radial(found, exact)), percent(radial(other, exact)),
            slopes(moved, UNTIL, x), f"{seconds:.0f}",
        ])  # fmt: skip
    add = section.table("torus", "field", "mesh alone", "slope", "s")
    start, flow = fitted(torus, box=torus.box.expanded(0.2)), flows.MeanCurvature(1.0)
    for resolution, substeps in ((32, 4), (64, 4), (64, 32)):
        moved, seconds = followed(
            "ours", start, flow, dt=last / steps, steps=steps, resolution=resolution, substeps=substeps
        )
        first = extract(start, resolution=resolution, refine=3)
        other = alone(first, flow, last / (steps * substeps), steps * substeps)
        found, x = surface(moved, last, 96)
        add([
            f"{resolution} cells, {substeps} substeps", percent(collapse(found, last)), percent(collapse(other, last)),
            slopes(moved, last, x), f"{seconds:.0f}",
        ])  # fmt: skip
    return section


def radial(mesh: Mesh, exact: float) -> float:
    """The relative error of the mean radius of a mesh."""
    return float(np.linalg.norm(mesh.vertices, axis=1).mean()) / exact - 1


def collapse(mesh: Mesh, t: float) -> float:
    r"""The relative error of the time at which a torus collapses, foretold from its mesh at the time t.

    A thin section of area A at the distance rho from the axis shrinks at the rate $2 \pi - A / \rho^2$.
    """
    distances = np.hypot(*mesh.vertices.T[:2])
    rho = (distances.min() + distances.max()) / 2
    area = mesh.volume / (2 * math.pi * rho)
    return (t - rho**2 * math.log1p(-area / (2 * math.pi * rho**2))) / TORUS[2] - 1


def extrapolated(label: str, errors: Sequence[float]) -> list[str]:
    """A row of errors for numbers of steps that double, with their limit and the order at which they come to it."""
    *_, a, b, c = errors
    return [label, *map(percent, errors), percent(2 * c - b), f"{math.log2((a - b) / (b - c)):.2f}"]


def percent(value: float) -> str:
    return f"{100 * value:+.3f}"


def roundness(mesh: Mesh) -> str:
    """The greatest distance of the surface from its middle by the least."""
    middle = np.average(mesh.vertices[mesh.faces].mean(1), axis=0, weights=mesh.face_areas)
    distances = np.linalg.norm(mesh.vertices - middle, axis=1)
    return f"{distances.max() / distances.min():.3f}"


def pictures(meshes: Mapping[str, Mesh], title: str) -> UInt8[np.ndarray, "h w 3"]:
    """The first surface and those of some methods side by side."""
    first, *names = meshes
    shown = [first, *([name for name in names if name in SHOWN] if "MeshSDF, Adam" in names else names)]
    return contact_sheet([meshes[name] for name in shown], shown, columns=5, size=180, title=title)


def document(sections: Sequence[Section], picture: str | None) -> str:
    """What was found as Markdown."""
    parts = [HEAD, f"PyTorch {torch.__version__}, threads: {torch.get_num_threads()}."]
    parts += [f"![Surfaces under ours and the rivals]({picture})"] if picture else []
    return "\n\n".join([*parts, *map(str, sections)]) + "\n"


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _aligned(cells: Sequence[str], widths: Sequence[int]) -> str:
    return f"{cells[0]:<{widths[0]}}" + "".join(f"{cell:>{w}}" for cell, w in zip(cells[1:], widths[1:], strict=True))


FIGURES: Mapping[str, Callable[[argparse.Namespace], Section | None]] = {
    "plane": plane,
    "tangential": tangential,
    "ball": ball,
    "block": block,
    "scan": scan,
    "orders": orders,
    "cells": resolutions,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("figures", nargs="*", default=[], metavar="FIGURE", help="all by default")
    parser.add_argument("--mesh", type=Path, default=_folder() / "bunny.obj")
    parser.add_argument("-o", "--output", type=Path, default=Path("following.md"))
    options = parser.parse_args()
    if unknown := set(options.figures) - set(FIGURES):
        parser.error(f"there is no figure {', '.join(sorted(unknown))}; known are {', '.join(FIGURES)}")
    print(f"{torch.get_num_threads()} threads, PyTorch {torch.__version__}")
    sections: list[Section] = []
    picture = options.output.with_suffix(".png")
    for name in options.figures or FIGURES:
        section = FIGURES[name](options)
        sections += [] if section is None else [section]
        if shown := [section.picture for section in sections if section.picture is not None]:
            stack(shown, picture)
        options.output.write_text(document(sections, picture.name if shown else None))
    print(f"\n{options.output}")


def _folder() -> Path:
    return Path(os.environ.get("LEVELFLOW_MESHES", Path(__file__).parents[2] / "shared" / "meshes"))


if __name__ == "__main__":
    main()
