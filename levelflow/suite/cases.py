"""The correctness suite: evolutions whose answer is known, and how far a surface is from it.

Every case is solved with the default settings. A row holds the error of a surface or of a time, never of a residual,
and the limit that it is held to. Lengths are in normalised units: half the longest side of the field's box is 1.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence

import torch
from torch import Tensor

from levelflow import equations
from levelflow.boxes import Box
from levelflow.fields import Field
from levelflow.shapes import Dumbbell, Solid, Sphere, Torus
from levelflow.shapes.implicit import Implicit
from levelflow.solving import solve
from levelflow.suite.energies import followed, volume, willmore
from levelflow.suite.films import catenoid, periodic, rings, scherk
from levelflow.suite.parameters import families, features, heat
from levelflow.suite.solids import Tube
from levelflow.suite.suite import (
    POINTS,
    Row,
    Suite,
    along,
    at_origin,
    change,
    last_time,
    mean_distance,
    radii,
    section,
    seeded,
    unit,
)
from levelflow.transported import Transported

HALF_WAY = torch.tensor([0.43750, 0.40369, 0.37070, 0.36867, 0.39397, 0.43114, 0.45000], dtype=torch.float64)
"""Where the morph of the shifted spheres is at t = 0.5: radii from (0.05, 0, 0), every 30 degrees from the x axis."""


def rows(suite: Suite, cases: Sequence[str]) -> Iterator[Row]:
    """The rows of the named cases, as they come."""
    for case in cases:
        yield from CASES[case](suite)


def sphere(suite: Suite) -> Iterator[Row]:
    """A sphere under mean curvature, r^2 = r0^2 - 4 rate t, until r = 0.45 r0: the relative error of its radius."""
    radius, rate = 0.5, 0.1
    field, seconds = suite.solve(equations.MeanCurvature(rate), at={0.0: Sphere(radius)}, until=0.5)
    for i in range(6):
        exact = math.sqrt(radius**2 - 4 * rate * i / 10)
        error = (radii(field.at(i / 10)) / exact - 1).abs().max()
        yield Row(f"sphere, mean curvature, t = {i / 10:.1f}, radius", float(error), 1.5e-3, seconds)


def sharpening(suite: Suite) -> Iterator[Row]:
    """A sphere backwards in time: the relative error of its radius."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that this is ill-posed is the point of the row
        field, seconds = suite.solve(equations.MeanCurvature(0.1), at={0.0: Sphere(0.5)}, until=-0.2)
    for t in (-0.1, -0.2):
        error = (radii(field.at(t)) / math.sqrt(0.25 - 0.4 * t) - 1).abs().max()
        yield Row(f"sphere, sharpened to t = {t:g}, radius", float(error), 1.5e-3, seconds)


def cylinder(suite: Suite) -> Iterator[Row]:
    """A long cylinder, r^2 = r0^2 - 2 rate t, until r = 0.45 r0: the relative error in the middle."""
    radius, rate = 0.4, 0.1
    last = radius**2 * (1 - 0.45**2) / (2 * rate)
    tube = Tube(radius, 0.0, 1.0)
    field, seconds = suite.solve(equations.MeanCurvature(rate), at={0.0: tube}, until=last)
    for part in (0.0, 0.5, 1.0):
        exact = math.sqrt(radius**2 - 2 * rate * last * part)
        points = Implicit(field.at(last * part)).sample(POINTS, generator=seeded()).points
        middle = points[points[:, 2].abs() < 0.3]
        error = (torch.linalg.vector_norm(middle[:, :2], dim=1) / exact - 1).abs().max()
        yield Row(f"cylinder, mean curvature, {part:.1f} of the time, radius", float(error), 1.5e-3, seconds)


def tori(suite: Suite) -> Iterator[Row]:
    """Tori of radius 1 under mean curvature of rate 1: the relative error of the time of collapse."""
    for minor, truth in ((0.3, 0.046136), (0.5, 0.136644)):
        field, seconds = suite.solve(equations.MeanCurvature(1.0), at={0.0: Torus(1.0, minor)}, until=1.1 * truth)
        found = last_time(field, section(0.4, 1.3, 0.3), 0.3 * truth, 1.1 * truth)
        yield Row(f"torus r = {minor:g}, collapse, time", abs(found / truth - 1), 0.01, seconds)
    for minor, truth in ((0.7, 0.08162), (0.8, 0.026542)):
        field, seconds = suite.solve(equations.MeanCurvature(1.0), at={0.0: Torus(1.0, minor)}, until=1.15 * truth)
        found = change(lambda t, f=field: at_origin(f, t) > 0, 0.0, 1.15 * truth)  # type: ignore[misc]
        yield Row(f"torus r = {minor:g}, hole closes, time", abs(found / truth - 1), 0.01, seconds)


def corrugated(suite: Suite) -> Iterator[Row]:
    """Corrugated cylinders r = 0.3 - a cos(pi z) of rate 1: the relative error of the time at which they pinch off."""
    for depth, truth in ((0.1, 0.0241538), (0.2, 0.0061309)):
        tube = Tube(0.3, depth, 1.2)
        field, seconds = suite.solve(equations.MeanCurvature(1.0), at={0.0: tube}, until=1.15 * truth)
        found = change(lambda t, f=field: at_origin(f, t) < 0, 0.0, 1.15 * truth)  # type: ignore[misc]
        yield Row(f"corrugated cylinder a = {depth:g}, pinch, time", abs(found / truth - 1), 0.01, seconds)


def dumbbell(suite: Suite) -> Iterator[Row]:
    """The demo's dumbbell of rate 1: the radius of its neck, relative, and the time at which it pinches off.

    The truth is that of a front of the profile r(z, t), computed to five digits in tests/axisymmetric.py.
    """
    pinch, t = 0.0075904, 0.006
    heights, truths = (0.0, 0.1, 0.2, 0.3), (0.053158, 0.064160, 0.105489, 0.178464)
    shape = Dumbbell(0.3, 1.0, 0.12)
    field, seconds = suite.solve(equations.MeanCurvature(1.0), at={0.0: shape}, until=1.15 * pinch)
    error = max(
        float((radii(field.at(t), height=sign * z) / r - 1).abs().max())
        for z, r in zip(heights, truths, strict=True)
        for sign in (1, -1)
    )
    yield Row(f"dumbbell, t = {t:g}, radius of the neck", error, 0.01, seconds)
    found = change(lambda t: at_origin(field, t) < 0, 0.0, 1.15 * pinch)
    yield Row("dumbbell, pinch, time", abs(found / pinch - 1), 0.01, seconds)


def moved(suite: Suite) -> Iterator[Row]:
    """The mesh moved by velocity fields: the mean distance from where characteristics bring it.

    Once with the fitted field carried along characteristics, and once with one network of space and time.
    """
    box = suite.shape.box
    size, center = max(box.size), box.center
    head, body = (tuple(c + s * 0.2 * size for c in center) for s in (1, -1))
    width = 0.2 * size
    motions: dict[str, equations.VelocityField] = {
        "translation": equations.Constant((0.5 * size, 0.2 * size, 0.0)),
        "rotation by 90 degrees": equations.Rotation(math.pi / 2, center=center),
        "twist": equations.Twist(2 / size, center=center),
        "source and sink": equations.Source(body, 1.0, width) + equations.Source(head, -1.0, width),
    }
    if suite.solver is solve:
        static, seconds = suite.fit(suite.shape)
        for title, velocity in motions.items():
            motion = equations.Transport(velocity)
            carried = Transported(motion, static, until=1.0)
            error = max(mean_distance(carried, t, suite.shape, motion) for t in (0.0, 0.5, 1.0))
            yield Row(f"{title} of {suite.name}, carried", error, 1e-3, seconds)
    for title, velocity in motions.items():
        motion = equations.Transport(velocity)
        field, seconds = suite.solve(motion, at={0.0: suite.shape}, until=1.0)
        error = max(mean_distance(field, t, suite.shape, motion) for t in (0.0, 0.5, 1.0))
        yield Row(f"{title} of {suite.name}, mean distance", error, 1e-3, seconds)


def standing(suite: Suite) -> Iterator[Row]:
    """A torus that stands still: its mean distance from itself."""
    ring = Torus(0.5, 0.2)
    field, seconds = suite.solve(equations.Stationary(), at={0.0: ring}, until=1.0)
    error = max(mean_distance(field, t, ring, equations.Stationary()) for t in (0.0, 0.5, 1.0))
    yield Row("torus, standing still, mean distance", error, 5e-4, seconds)


def enright(suite: Suite) -> Iterator[Row]:
    """Enright's deformation of a small sphere, which comes back after its period: volume and mean distance."""
    ball, box = Sphere(0.15, center=(0.35, 0.35, 0.35)), Box((0.0,) * 3, (1.0,) * 3)
    motion = equations.Transport(_enright)
    ways: list[tuple[str, Field, float]] = []
    if suite.solver is solve:
        static, seconds = suite.fit(ball)
        ways.append((", carried", Transported(motion, static, box=box.during((0.0, 3.0))), seconds))
    ways.append(("", *suite.solve(motion, at={0.0: ball}, until=3.0, box=box)))
    x = torch.rand(200_000, 3, generator=seeded(), dtype=torch.float64) * 0.4 + 0.15
    held = torch.linalg.vector_norm(x - 0.35, dim=1) < 0.15
    points = ball.sample(POINTS, generator=seeded()).points
    carried = motion.carry(points, torch.zeros(POINTS).double(), torch.full((POINTS,), 1.5).double(), steps=128)
    for way, field, seconds in ways:
        inside = torch.cat([field.at(3.0)(part) < 0 for part in x.split(1 << 16)])
        error = abs(float(inside.double().mean() / held.double().mean()) - 1)
        yield Row(f"Enright's deformation{way}, volume at the end", error, 0.01, seconds)
        error = mean_distance(field, 3.0, ball, equations.Stationary())
        yield Row(f"Enright's deformation{way}, distance at the end", error, 1e-3, seconds)
        gap = float(Implicit(field.at(1.5)).gap(carried).mean()) / unit(field)
        yield Row(f"Enright's deformation{way}, distance half way", gap, 1e-3, seconds)


def morph(suite: Suite) -> Iterator[Row]:
    """Concentric spheres morphed, r(t) linear; shifted ones at both ends, and half way against a grid.

    Surfaces of revolution are morphed like their sections, so the truth half way is that of circles in the plane, on a
    grid of 512 cells (`HALF_WAY`, `tests/test_benchmarks.py`).
    """
    small, large = Sphere(0.4), Sphere(0.8)
    field, seconds = suite.solve(equations.Morph(large), at={0.0: small, 1.0: large})
    for t in (0.0, 0.5, 1.0):
        error = float((radii(field.at(t)) - 0.4 - 0.4 * t).abs().max()) / unit(field)
        yield Row(f"concentric spheres, t = {t:.1f}, radius", error, 1e-3, seconds)
    ends = {0.0: Sphere(0.4, center=(-0.2, 0.0, 0.0)), 1.0: Sphere(0.5, center=(0.3, 0.0, 0.0))}
    field, seconds = suite.solve(equations.Morph(ends[1.0]), at=ends)
    for t, end in ends.items():
        error = mean_distance(field, t, end, equations.Stationary())
        yield Row(f"shifted spheres, t = {t:.1f}, mean distance", error, 5e-4, seconds)
    angle = torch.arange(7, dtype=torch.float64) * math.pi / 6
    across = torch.stack([angle.cos(), angle.sin(), 0 * angle], dim=1)
    found = along(field.at(0.5), torch.tensor([0.05, 0.0, 0.0], dtype=torch.float64), across)
    yield Row("shifted spheres, t = 0.5, radius", float((found - HALF_WAY).abs().max()) / unit(field), 1e-3, seconds)


def rates(suite: Suite) -> Iterator[Row]:
    """A torus under mean curvature: dA/dt = -rate int kappa^2 and dV/dt = -rate int kappa, by differences in time."""
    from levelflow.curvature import total_curvature
    from levelflow.extraction import extract

    rate = 0.1
    field, seconds = suite.solve(equations.MeanCurvature(rate), at={0.0: Torus(0.6, 0.25)}, until=0.1)
    t, dt = 0.05, 0.02
    before, now, after = (extract(field.at(t + s * dt), resolution=96, refine=3) for s in (-1, 0, 1))
    points = now.sample(POINTS, generator=seeded()).points
    with torch.no_grad():
        kappa = total_curvature(field.at(t).jet(points, order=2)).double()
    truth = -rate * now.area * float((kappa**2).mean()), -rate * now.area * float(kappa.mean())
    found = (after.area - before.area) / (2 * dt), (after.volume - before.volume) / (2 * dt)
    yield Row("torus, rate of the area", abs(found[0] / truth[0] - 1), 0.02, seconds)
    yield Row("torus, rate of the volume", abs(found[1] / truth[1] - 1), 0.02, seconds)


def given(suite: Suite) -> Iterator[Row]:
    """Shapes fitted: the mean distance of the surface."""
    cases: tuple[tuple[str, Solid, float], ...] = (
        ("sphere", Sphere(0.5), 5e-4),
        ("torus", Torus(0.5, 0.2), 5e-4),
        (suite.name, suite.shape, 1.5e-3),
    )
    for title, shape, limit in cases:
        field, seconds = suite.fit(shape)
        error = field.provenance["accuracy"]["mean"] / field.box.frame.scale
        yield Row(f"fit of {title}, mean distance", error, limit, seconds)


CASES: dict[str, Callable[[Suite], Iterator[Row]]] = {
    "sphere": sphere,
    "sharpening": sharpening,
    "cylinder": cylinder,
    "tori": tori,
    "corrugated": corrugated,
    "dumbbell": dumbbell,
    "catenoid": catenoid,
    "rings": rings,
    "scherk": scherk,
    "periodic": periodic,
    "willmore": willmore,
    "volume": volume,
    "families": families,
    "heat": heat,
    "features": features,
    "followed": followed,
    "moved": moved,
    "standing": standing,
    "enright": enright,
    "morph": morph,
    "rates": rates,
    "fit": given,
}


def _enright(x: Tensor, t: Tensor) -> Tensor:
    """Enright's divergence-free field on the unit cube, which runs backwards after half of its period of 3."""
    s, d = torch.sin(math.pi * x) ** 2, torch.sin(2 * math.pi * x)
    v = torch.stack(
        [2 * s[:, 0] * d[:, 1] * d[:, 2], -d[:, 0] * s[:, 1] * d[:, 2], -d[:, 0] * d[:, 1] * s[:, 2]], dim=1
    )
    return v * torch.cos(math.pi * t / 3)
