"""What comes between given shapes: every constraint on the same keyframes, beside a Lipschitz network.

    python benchmarks/keyframes.py [PROBLEM ...] [--constraints NAME ...] [--steps 400] [-o keyframes.png]
    python benchmarks/keyframes.py --space 3
    python benchmarks/keyframes.py --mesh A B [C ...]

A table for each problem with a row for each constraint, and one picture: a row for each constraint, time from left to
right. Without `--space 3` or `--mesh` the shapes are curves in the plane. All rows draw as many samples in a step, and
all but one take the same number of steps.

Problems: `same` (one shape at both ends), `equal` (two shapes of equal topology), `split` (of different topology),
`three` (three keyframes).

Rows:
    velocity           the speed -g of eqs. 8 and 9, without an end in time; for two shapes only
    eikonal            |grad f| = 1, eq. 11
    curvature          motion by mean curvature, eq. 12, at the rate 0.1 in length^2 per unit time
    weak-curvature     the same at the rate 0.01
    interpolation      `Morph`, which is nise-2023, eqs. 9 and 10, with an end in time
    constant           f_t = 0, Sec. 6.3.5
    nothing            the keyframes only
    lipschitz          the keyframes only, of a `LipschitzMLP` with two layers more and its regulariser
    lipschitz-lighter  the same with a tenth of the regulariser
    lipschitz-longer   the same as `lipschitz` with four times the steps

Columns, in the units of the shapes, whose longest side is about 1, and of the whole time, 1:
    ends     how far the surface is from the given shapes at their times: the mean, and the farthest point
    length   of the path: the integral over time of the mean size of the normal speed over the surface
    jump     the greatest mean distance between neighbouring frames, by the mean of them; 1 is a steady pace
    bend     the mean size of the second difference in time of the surface's place, along its normal
    area     how far the area strays from the line between those of the given shapes: the mean, as a part of the line
    volume   the same for the volume
    parts    the least and greatest number of bodies in a frame, holes counted
    s        seconds of training, of the processor

Reference:
    Novello et al., Neural homotopies (2022), Secs. 4.3 and 6.3; Neural Implicit Surface Evolution, ICCV 2023, Sec. 6.3
    and figures 9 and 10; Liu et al., Learning Smooth Neural Functions via Lipschitz Regularization, SIGGRAPH 2022.
"""

from __future__ import annotations

import argparse
import math
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import numpy as np
import torch

from levelflow import SIREN, Box, Budget, Field, LipschitzMLP, Mesh, Placed, Sampling, contact_sheet, extract, solve
from levelflow.curvature import gradient_norm
from levelflow.equations import Approach, Eikonal, Equation, MeanCurvature, Morph, Stationary, Unconstrained
from levelflow.extraction import EmptyLevelSet
from levelflow.measures import surface_distance
from levelflow.rendering.images import stack
from levelflow.shapes import Circle, Cuboid, Polygon, Rectangle, SmoothUnion, Solid, Sphere, Torus
from levelflow.shapes.implicit import NoSurface
from levelflow.steepness import Steepness

Keys = Mapping[float, Solid]
LAST = 5.0
"""How many times the difference falls by a factor e where the motion has no end."""


class Constraint(NamedTuple):
    """What is asked between the shapes, of which network, how many times longer it trains, and its regulariser."""

    equation: Callable[[Keys], Equation]
    network: type[SIREN] | type[LipschitzMLP] = SIREN
    longer: int = 1
    weight: float = Steepness.weight


def towards(keys: Keys) -> Approach:
    """From the first shape to the second, as fast as brings it there but for 1 %."""
    _, last = keys.values()
    return Approach(last, rate=LAST)


CONSTRAINTS: Mapping[str, Constraint] = {
    "velocity": Constraint(towards),
    "eikonal": Constraint(lambda keys: Eikonal()),
    "curvature": Constraint(lambda keys: MeanCurvature(0.1)),
    "weak-curvature": Constraint(lambda keys: MeanCurvature(0.01)),
    "interpolation": Constraint(lambda keys: Morph({t: shape for t, shape in keys.items() if t > 0})),
    "constant": Constraint(lambda keys: Stationary()),
    "nothing": Constraint(lambda keys: Unconstrained()),
    "lipschitz": Constraint(lambda keys: Unconstrained(), LipschitzMLP),
    "lipschitz-lighter": Constraint(lambda keys: Unconstrained(), LipschitzMLP, weight=Steepness.weight / 10),
    "lipschitz-longer": Constraint(lambda keys: Unconstrained(), LipschitzMLP, longer=4),
}


def in_the_plane() -> dict[str, Keys]:
    """Keyframes made of built-in curves."""
    corners = [((0.6, 0.3)[i % 2], math.pi * (0.5 + i / 5)) for i in range(10)]
    star = Polygon(tuple((r * math.cos(a), r * math.sin(a)) for r, a in corners))
    bar, disk = Rectangle((1.0, 0.5), radius=0.05), Circle(0.45)
    two = SmoothUnion(Circle(0.28, (-0.4, 0.0)), Circle(0.28, (0.4, 0.0)), 0.05)
    return {
        "same": {0.0: star, 1.0: star},
        "equal": {0.0: star, 1.0: bar},
        "split": {0.0: disk, 1.0: two},
        "three": {0.0: bar, 0.5: star, 1.0: two},
    }


def in_space() -> dict[str, Keys]:
    """Keyframes made of built-in solids."""
    ring, block, ball = Torus(0.42, 0.17), Cuboid((0.8, 0.8, 0.8), radius=0.05), Sphere(0.45)
    two = SmoothUnion(Sphere(0.28, (-0.4, 0.0, 0.0)), Sphere(0.28, (0.4, 0.0, 0.0)), 0.05)
    return {
        "same": {0.0: ring, 1.0: ring},
        "equal": {0.0: block, 1.0: ball},
        "split": {0.0: ring, 1.0: block},
        "three": {0.0: block, 0.5: ring, 1.0: two},
    }


@dataclass(frozen=True)
class Judgement:
    """A path between shapes in numbers; see the columns above."""

    ends: float
    worst: float
    length: float
    jump: float
    bend: float
    area: float
    volume: float
    parts: tuple[int, int]

    def __str__(self) -> str:
        parts = "-".join(map(str, dict.fromkeys(self.parts)))
        return (
            f"{self.ends:>9.4f}{self.worst:>8.3f}{self.length:>8.3f}{self.jump:>7.2f}{self.bend:>7.2f}"
            f"{self.area:>8.1%}{self.volume:>8.1%}{parts:>7}"
        )


HEAD = f"{'ends':>9}{'worst':>8}{'length':>8}{'jump':>7}{'bend':>7}{'area':>8}{'volume':>8}{'parts':>7}"


def judge(field: Field, keys: Keys, *, frames: int = 21, resolution: int = 160, n: int = 2000) -> Judgement:
    """The path of a field between shapes, at equal steps of time.

    Its surfaces are cut off at the sides of the box, so that all of them are closed.
    """
    generator = torch.Generator().manual_seed(0)
    assert field.box is not None
    box, times = field.box.during(), np.linspace(*field.box.times[0], frames)
    dt = float(times[1] - times[0])
    meshes = [mesh_of(field.at(t), box, resolution) for t in times.tolist()]
    points = [None if mesh is None else mesh.sample(n, generator=generator).points for mesh in meshes]
    speeds, moved, bends = np.full(frames, np.nan), np.full(frames - 1, np.nan), np.full(frames, np.nan)
    for i, (t, x) in enumerate(zip(times.tolist(), points, strict=True)):
        if x is None:
            continue
        speeds[i] = float(normal_speed(field, x, t).abs().mean())
        steps = [outwards(field, x, times[j], meshes[j]) if 0 <= j < frames else None for j in (i - 1, i + 1)]
        before, after = steps
        if after is not None:
            moved[i] = np.abs(after).mean()
        if before is not None and after is not None:
            bends[i] = np.abs(before + after).mean() / dt**2
    gaps = [surface_distance(shape, field.at(t), n=5000, generator=generator) for t, shape in keys.items()]
    given = [mesh_of(shape.distance, box, resolution) for shape in keys.values()]
    strays = {}
    for name in ("area", "volume"):
        line = np.interp(times, list(keys), [getattr(mesh, name) for mesh in given])
        found = np.array([0.0 if mesh is None else getattr(mesh, name) for mesh in meshes])
        strays[name] = float(np.abs(found / line - 1).mean())
    counts = [0 if mesh is None else mesh.components for mesh in meshes]
    known = ~np.isnan(speeds)
    return Judgement(
        ends=float(np.mean([gap.chamfer for gap in gaps])),
        worst=max(gap.hausdorff for gap in gaps),
        length=float(np.trapezoid(speeds[known], times[known])),
        jump=float(np.nanmax(moved) / np.nanmean(moved)),
        bend=float(np.nanmean(bends)),
        parts=(min(counts), max(counts)),
        **strays,
    )


def mesh_of(field: Callable[[torch.Tensor], torch.Tensor], box: Box, resolution: int) -> Mesh | None:
    """The surface in a box, closed at its sides; None if there is none."""

    def closed(x: torch.Tensor) -> torch.Tensor:
        beyond = torch.maximum(x.new_tensor(box.lower) - x, x - x.new_tensor(box.upper)).amax(1)
        return torch.maximum(field(x).to(x), beyond)

    try:
        return extract(closed, box=box.expanded(0.02 * max(box.size)), resolution=resolution, refine=3)
    except EmptyLevelSet:
        return None


def normal_speed(field: Field, x: torch.Tensor, t: float) -> torch.Tensor:
    """The speed of the surface along its outward normal, -f_t / |grad f|."""
    jet = field.jet(x, x.new_full((len(x), 1), t), order=1)
    return (-jet.dt[:, 0] / gradient_norm(jet)).detach().double()


def outwards(field: Field, x: torch.Tensor, t: float, surface: Mesh | None) -> np.ndarray | None:
    """How far the surface at another time lies outside points, negative where it lies inside."""
    if surface is None:
        return None
    with torch.no_grad():
        inside = field(x, x.new_full((len(x), 1), t)).cpu().numpy() < 0
    return np.where(inside, 1.0, -1.0) * surface.closest(x.numpy()).distance


def solved(constraint: Constraint, keys: Keys, options: argparse.Namespace) -> Placed:
    """The field of a row."""
    space = next(iter(keys.values())).box.space
    width, depth = options.width, options.depth + (2 if constraint.network is LipschitzMLP else 0)
    generator = torch.Generator().manual_seed(options.seed)
    network = constraint.network(space, 1, width=width, depth=depth, generator=generator)
    equation = constraint.equation(keys)
    at = {0.0: keys[0.0]} if isinstance(equation, Approach) else keys
    with mock.patch.object(Steepness, "weight", constraint.weight):
        return solve(
            equation, network, at=at, until=max(keys), budget=Budget(options.steps * constraint.longer),
            sampling=Sampling(n=options.samples), seed=options.seed,
        )  # fmt: skip


def table(title: str, keys: Keys, options: argparse.Namespace) -> np.ndarray:
    """Prints the rows of a problem, and returns their picture."""
    space = next(iter(keys.values())).box.space
    resolution = options.resolution or (160 if space == 2 else 64)
    print(f"\n{title:<20}{HEAD}{'s':>6}", flush=True)
    shown = np.linspace(0, max(keys), 7).tolist()
    meshes: list[Mesh | None] = []
    labels: list[str] = []
    for name in options.constraints:
        constraint = CONSTRAINTS[name]
        if constraint.equation is towards and len(keys) > 2:
            continue
        started = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a surface that is lost is seen in the table
            field = solved(constraint, keys, options)
        seconds = time.process_time() - started
        try:
            text = str(judge(field, keys, frames=options.frames, resolution=resolution))
        except NoSurface:
            text = f"{'no surface at one of the given times':>{len(HEAD)}}"
        print(f"{name:<20}{text}{seconds:>6.0f}", flush=True)
        meshes += [mesh_of(field.at(t), field.box.during(), resolution) for t in shown]
        labels += [name if t == 0 else f"t = {t:.2g}" for t in shown]
    return contact_sheet(meshes, labels, columns=len(shown), size=options.size, title=title)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problems", nargs="*", default=[], metavar="PROBLEM", help="all by default")
    parser.add_argument("--constraints", nargs="*", choices=CONSTRAINTS, default=list(CONSTRAINTS), metavar="NAME")
    parser.add_argument("--space", type=int, choices=(2, 3), default=2)
    parser.add_argument("--mesh", type=Path, nargs="+", help="two files or more, given at equal steps of time")
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--samples", type=int, default=2048)
    parser.add_argument("--width", type=int, default=64)
    parser.add_argument("--depth", type=int, default=3, help="hidden layers; a Lipschitz network has two more")
    parser.add_argument("--frames", type=int, default=21, help="that are judged")
    parser.add_argument("--resolution", type=int, help="of their meshes: 160 in the plane and 64 in space by default")
    parser.add_argument("--size", type=int, default=128, help="pixels of a picture of a frame")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, default=Path("keyframes.png"))
    options = parser.parse_args()
    known = in_the_plane() if options.space == 2 else in_space()
    if options.mesh:
        if len(options.mesh) < 2:
            parser.error("--mesh: give two files or more")
        times = np.linspace(0, 1, len(options.mesh)).tolist()
        title = " to ".join(path.stem for path in options.mesh)
        known = {title: dict(zip(times, map(Mesh.read, options.mesh), strict=True))}
    if unknown := set(options.problems) - set(known):
        parser.error(f"there is no problem {', '.join(sorted(unknown))}; known are {', '.join(known)}")
    print(f"{options.steps} steps, {torch.get_num_threads()} threads, PyTorch {torch.__version__}")
    stack([table(title, known[title], options) for title in options.problems or known], options.output)
    print(options.output)


if __name__ == "__main__":
    main()
