"""The constraints of the papers in our training: the distance everywhere, and the raw residual everywhere.

`levelflow.fit` and `levelflow.solve` ask for distances in a band around the surface, for the side beyond it, and for
the equation near the moving surface: that is what a surface needs. Tables 1 and 2 of the paper judge the distance and
the residual in the whole box. These are fields that are trained for that, by our jets and optimiser: a static field
with distances everywhere, lifted to space and time, and then the sum of squares of distances, normals and residuals.
Curvature that sets in at kinks moves them by the root of the time, and so the network is given that for its time.

Reference:
    Novello et al., Neural Implicit Surface Evolution, ICCV 2023, Sec. 4 and eq. 6.
"""

from __future__ import annotations

import copy
import math

import torch
from torch import Tensor

from levelflow import SIREN, Box, Budget, Field, Jet, Placed, Sampling
from levelflow.conditions import Given, OffSurface, OnSurface, pick
from levelflow.curvature import gradient_norm
from levelflow.equations import Equation
from levelflow.minimising import Batch, Term, minimise
from levelflow.motion import Motion
from levelflow.networks.lifting import lift
from levelflow.shapes import Solid

RATE = 1e-3
"""The learning rate from a lifted field of 128 neurons: with ours, 3e-3, the first steps undo much of the fit."""

POLISH = 2e-4
"""The learning rate of a last fifth of the steps of `fit`: what ours decays to leaves errors in a wide network."""

AT_REST, MOVING, NORMAL = 10.0, 30.0, 1e-4
"""The weight of f = 0 on the surface, without and with a residual beside it, and that of the normals in it."""

EARLY = 0.8
"""The share of the samples that are uniform by the root of the time, where that is the network's."""


class RootClock(Field):
    r"""A field of space and the root of the time, $f(x, t) = g(x, 2\sqrt{u + \epsilon} - 1)$ with $u = (t + 1) / 2$.

    Near a kink at t = -1 motion by curvature is a function of $x / \sqrt{u}$ times $\sqrt{u}$: its rate has no bound,
    and that in the root of the time has one. Before u = $\epsilon$ no network needs to be steeper.
    """

    epsilon = 0.01

    def __init__(self, field: SIREN) -> None:
        super().__init__()
        self.field, self.space, self.times = field, field.space, 1

    def push(self, jet: Jet) -> Jet:
        d = self.space
        return self.field.push(jet.components(0, d).beside(jet.components(d).pointwise(self._clock)))

    def jet(self, x: Tensor, t: Tensor | None = None, *, order: int = 1) -> Jet:
        x, t = self._inputs(x, t)
        moment, rate = self._clock(t, 1)
        jet = self.field.jet(x, moment, order=order)
        if jet.first is None:
            return jet
        return Jet(jet.value, torch.cat([jet.gradient, jet.dt * rate], dim=1), jet.second, jet.space)

    def at(self, *t: float | None) -> Field:
        (time,) = t
        if time is None:
            return self
        (moment,) = self._clock(torch.tensor(time, dtype=torch.float64), 0)
        return self.field.at(float(moment))

    def _clock(self, t: Tensor, order: int) -> tuple[Tensor, ...]:
        root = (((t + 1) / 2).clamp_min(0) + self.epsilon).sqrt()
        return (2 * root - 1, 0.5 / root, -0.125 / root**3)[: order + 1]


class Distances(OffSurface):
    r"""The distance itself, $(f - d)^2 + w\,(|\nabla f| - 1)^2$, half of it near the surface and half anywhere."""

    def __init__(self, field: SIREN, given: Given, times: tuple[float, ...], *, n: int, eikonal: float = 1e-3) -> None:
        super().__init__(field, given, times, n=n, band=math.inf)
        self.eikonal = eikonal

    def sample(self, generator: torch.Generator) -> Batch:
        near = pick(self.n // 2, self.given.near, self.given.near_values, generator=generator)
        far = pick(self.n - self.n // 2, self.given.far, self.given.far_values, generator=generator)
        x, values = (torch.cat(parts) for parts in zip(near, far, strict=True))
        return x, values, x.new_tensor(self.times).expand(len(x), -1)

    def loss(self, *batch: Tensor) -> Tensor:
        x, values, t = batch
        jet = self.field.jet(x, t, order=1)
        return (jet.value - values) ** 2 + self.eikonal * (gradient_norm(jet) - 1) ** 2


class Everywhere(Motion):
    r"""The square of the raw residual F, uniformly in the box and the interval, in the units of the shape.

    Beyond the knee k it grows like |F|, $2 k^2 (\sqrt{1 + F^2 / k^2} - 1)$: where the medial axis bends, the square
    alone would outweigh all distances, and a logarithm no longer pulls at a wide network, which bends everywhere at
    first. A part of the samples is early, if the clock is.
    """

    near = 0.0

    def __init__(self, placed: Placed, equation: Equation, *, n: int, weight: float, knee: float = 0.01) -> None:
        super().__init__(placed, equation, n=n)
        self.weight, self.knee = weight, knee

    def sample(self, generator: torch.Generator) -> Batch:
        z, d = self._anywhere(self.n, generator), self.placed.space
        if isinstance(self.placed.field, RootClock):
            early = z[: round(EARLY * self.n), d:]
            early.copy_((early + 1) ** 2 / 2 - 1)
        return (z,)

    def loss(self, *batch: Tensor) -> Tensor:
        (z,) = batch
        placed, d = self.placed, self.placed.space
        jet = placed.in_units(placed.field.jet(z[:, :d], z[:, d:], order=self.equation.order))
        x, t = placed.box.frame.from_unit(z[:, :d].double()), placed.times_in_units(z[:, d:].double())
        residual = self.equation.residual(x, t, jet).to(z.dtype)
        return 2 * self.knee**2 * ((1 + (residual / self.knee) ** 2).sqrt() - 1)


def fit(
    network: SIREN,
    shape: Solid,
    box: Box,
    *,
    budget: Budget,
    sampling: Sampling,
    seed: int = 0,
    eikonal: float = 1e-3,
) -> Placed:
    """A static field with the distance of a shape in the whole box, and slopes of 1 with the weight `eikonal`."""
    field = Placed(copy.deepcopy(network), box.during())
    generator = torch.Generator().manual_seed(seed)
    given = Given.of(shape, box, n=sampling.given, generator=generator, like=next(field.parameters()))
    n = sampling.n // 2
    terms: list[Term] = [
        _on_surface(field, given, (), n=n, weight=AT_REST),
        Distances(field.field, given, (), n=n, eikonal=eikonal),
    ]
    assert budget.steps is not None
    last = max(1, budget.steps // 5)
    for steps, rate in ((budget.steps - last, 3e-3 * _slower(network)), (last, POLISH)):
        minimise(field.parameters(), terms, budget=Budget(steps), generator=generator, rate=rate)
    return field


def solve(
    equation: Equation,
    start: Placed,
    shape: Solid,
    *,
    time: float = 0.0,
    interval: tuple[float, float],
    budget: Budget,
    sampling: Sampling,
    seed: int = 0,
    eikonal: float = 1e-3,
    distance: float = 1.0,
    residual: float = 3.0,
    knee: float = 0.01,
    rate: float = RATE,
) -> Placed:
    """A field of space and time from a static one: the shape's distance at one time, the residual at all times.

    Args:
        equation: The motion.
        start: A field from `fit`, the start and the box.
        shape: The shape given at `time`.
        time: When.
        interval: The times in which the equation is asked for.
        budget: Steps or seconds.
        sampling: The samples of a step and their shares.
        seed: Of every random choice.
        eikonal: The weight of |grad f| = 1 at the given time.
        distance: The weight of the distance off the surface.
        residual: The weight of the residual.
        knee: Where the square of the residual begins to count like its size.
        rate: The learning rate at 128 neurons; it falls as the width grows.
    """
    generator = torch.Generator().manual_seed(seed)
    lifted = lift(start.field, generator=generator)
    kinks = equation.order == 2 and time == interval[0]
    field = Placed(RootClock(lifted) if kinks else lifted, start.box.during(interval))
    given = Given.of(shape, start.box, n=sampling.given, generator=generator, like=next(field.parameters()))
    now = tuple(field.unit_times(torch.tensor([[time]], dtype=torch.float64))[0].tolist())
    n, on, off = sampling.counts()
    distances = Distances(field.field, given, now, n=off, eikonal=eikonal)
    distances.weight = distance
    terms: list[Term] = [
        _on_surface(field, given, now, n=on, weight=MOVING),
        distances,
        Everywhere(field, equation, n=n, weight=residual, knee=knee),
    ]
    minimise(field.parameters(), terms, budget=budget, generator=generator, rate=rate * _slower(lifted))
    return field


def _on_surface(field: Placed, given: Given, times: tuple[float, ...], *, n: int, weight: float) -> OnSurface:
    term = OnSurface(field.field, given, times, n=n, normal=NORMAL)
    term.weight = weight
    return term


def _slower(network: SIREN) -> float:
    """By how much lower the rate of learning is for a wide network."""
    return min(1.0, 128 / network.width)
