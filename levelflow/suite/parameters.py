"""Families of surfaces with several parameters, and smoothing by other laws than mean curvature."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import torch
from torch import Tensor

from levelflow import equations
from levelflow.boxes import Box
from levelflow.fields import Field
from levelflow.jets import Jet
from levelflow.networks.siren import SIREN
from levelflow.shapes import Sphere
from levelflow.solving import solve
from levelflow.suite.suite import Row, Suite, radii

LIMIT, ORIGIN = 5e-3, (0.0, 0.0, 0.0)


def families(suite: Suite) -> Iterator[Row]:
    """Spheres of two parameters: moved by one and shrinking with the other, f(x, b, t) = f0(x - b t), and a triangle.

    The relative error of the radius, the greatest over some values of the parameters.
    """
    if suite.solver is not solve:
        return
    motion = equations.Family(equations.Transport((0.3, 0.0, 0.0)), equations.MeanCurvature(0.1))
    field, seconds = suite.solve(motion, SIREN(time=2), at={(0.0, 0.0): Sphere(0.5)}, until=(1.0, 0.4))
    error = max(
        _error(field.at(s, t), (0.3 * s, 0.0, 0.0), math.sqrt(0.25 - 0.4 * t))
        for s in (0.0, 0.5, 1.0)
        for t in (0.0, 0.2, 0.4)
    )
    yield Row("sphere, moved and shrunk, radius", error, LIMIT, seconds)

    def velocity(x: Tensor, t: Tensor) -> Tensor:
        return torch.stack([t[:, 1], 0 * t[:, 1], 0 * t[:, 1]], dim=1)

    field, seconds = suite.solve(
        equations.Transport(velocity), SIREN(time=2), at={(0.0, None): Sphere(0.5)}, until=(1.0, (-0.5, 0.5)),
        box=Box((-1.2, -0.8, -0.8), (1.2, 0.8, 0.8)),
    )  # fmt: skip
    error = max(_error(field.at(t, b), (b * t, 0.0, 0.0), 0.5) for t in (0.0, 0.5, 1.0) for b in (-0.5, 0.2, 0.5))
    yield Row("sphere, all translations along x, radius", error, LIMIT, seconds)

    triangle = ((0.0, 0.0), (2.0, 0.0), (0.0, 1.0))
    morph = equations.SimplicialMorph(triangle, (Sphere(0.3), Sphere(0.5), Sphere(0.7)))
    field, seconds = suite.solve(morph, SIREN(time=2), at=morph.keys)
    inner = ((1.0, 0.0), (1.0, 0.5), (0.0, 0.5), (2 / 3, 1 / 3))
    error = max(_error(field.at(s, t), ORIGIN, 0.3 + 0.1 * s + 0.4 * t) for s, t in (*triangle, *inner))
    yield Row("spheres on a triangle, radius", error, LIMIT, seconds)


def heat(suite: Suite) -> Iterator[Row]:
    r"""The heat equation for $(|x|^2 - r_0^2) / 2 r_0$: the sphere shrinks as $r^2 = r_0^2 - 6 \alpha t$."""
    if suite.solver is not solve:
        return
    radius, rate, box = 0.7, 0.1, Box((-1.4,) * 3, (1.4,) * 3)
    field, seconds = suite.solve(equations.Heat(rate), at={0.0: _Quadric(radius, box)}, until=0.5, box=box)
    error = max(_error(field.at(t), ORIGIN, math.sqrt(radius**2 - 6 * rate * t)) for t in (0.0, 0.25, 0.5))
    yield Row("sphere, heat equation, radius", error, LIMIT, seconds)


def features(suite: Suite) -> Iterator[Row]:
    r"""Spheres that are no features, $r^2 = r_0^2 - 4 \alpha t$, and that are, $r = r_0 e^{-2 \alpha \lambda^2 t}$.

    The latter motion is ill-posed.
    """
    if suite.solver is not solve:
        return
    rate, threshold = 0.1, 1.5
    motion = equations.FeaturePreserving(rate, threshold)
    cases: dict[tuple[str, float], Callable[[float], float]] = {
        ("smooth sphere", 0.9): lambda t: math.sqrt(0.81 - 4 * rate * t),
        ("sphere that is a feature", 0.5): lambda t: 0.5 * math.exp(-2 * rate * threshold**2 * t),
    }
    for (name, start), exact in cases.items():
        field, seconds = suite.solve(motion, at={0.0: Sphere(start)}, until=0.75)
        error = max(_error(field.at(t), ORIGIN, exact(t)) for t in (0.0, 0.375, 0.75))
        yield Row(f"{name}, features kept, radius", error, 2 * LIMIT, seconds)


class _Quadric(Field):
    """$(|x|^2 - r^2) / 2 r$, whose slope is 1 at the radius r."""

    def __init__(self, radius: float, box: Box) -> None:
        super().__init__()
        self.radius, self.box, self.space, self.times = radius, box, box.space, 0

    def push(self, jet: Jet) -> Jet:
        x, r = jet.components(0, self.space), self.radius
        value, first, second = ((x.value**2).sum(1) / r - r) / 2, None, None
        if x.first is not None:
            first = torch.einsum("na,nia->ni", x.value / r, x.first)
        if x.first is not None and x.second is not None:
            second = torch.einsum("nia,nja->nij", x.first / r, x.first)
            second = second + torch.einsum("na,nija->nij", x.value / r, x.second)
        return Jet(value, first, second, jet.space)


def _error(field: Field, center: tuple[float, float, float], radius: float) -> float:
    """The greatest relative error of the radius of a sphere."""
    return float((radii(field, center) / radius - 1).abs().max())
