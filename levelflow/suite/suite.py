"""What the cases of the suite share: how fields are trained, how surfaces are measured, and the rows of the table."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from levelflow import equations
from levelflow.conditions import Sampling
from levelflow.fields import Field, Placed
from levelflow.fitting import fit
from levelflow.minimising import DEFAULT_BUDGET, Budget
from levelflow.networks.periodic import Periodic
from levelflow.networks.siren import SIREN
from levelflow.shapes import Solid
from levelflow.shapes.implicit import Implicit
from levelflow.solving import solve

POINTS = 20_000


@dataclass(frozen=True)
class Row:
    """One comparison with the truth.

    Attributes:
        title: What is compared.
        error: By how much it is off.
        limit: What it is held to.
        seconds: How long the field took to train.
    """

    title: str
    error: float
    limit: float
    seconds: float

    def __str__(self) -> str:
        missed = "" if self.error <= self.limit else "  missed"
        return f"{self.title:<48}{self.error:>10.5f}{self.limit:>10.4f}{self.seconds:>9.0f}{missed}"


HEADER = f"{'case':<48}{'error':>10}{'limit':>10}{'seconds':>9}"


@dataclass(frozen=True)
class Suite:
    """What all cases share.

    Attributes:
        shape: The mesh that is fitted and carried around.
        name: What rows call it.
        budget: Of each case.
        sampling: Of each case.
        seed: Of every training; rows of different seeds show how much is chance.
        solver: What solves the equations, behind the call of `solve`; a rival of it for comparison. Rows that only
            this library has, fits and motions along characteristics, are left out then.
    """

    shape: Solid
    name: str = "mesh"
    budget: Budget = DEFAULT_BUDGET
    sampling: Sampling = Sampling()  # noqa: RUF009
    seed: int = 0
    solver: Callable[..., Field] = solve

    def solve(
        self, equation: equations.Equation, network: SIREN | Periodic | None = None, **more: object
    ) -> tuple[Field, float]:
        """A field, with the default network unless another is given, and the seconds it took."""
        network, started = network or SIREN(time=1), time.perf_counter()
        field = self.solver(equation, network, budget=self.budget, sampling=self.sampling, seed=self.seed, **more)
        return field, time.perf_counter() - started

    def fit(self, shape: Solid) -> tuple[Placed, float]:
        """A static field with the default network, and the seconds it took."""
        started = time.perf_counter()
        field = fit(SIREN(), shape, budget=self.budget, sampling=self.sampling, seed=self.seed)
        return field, time.perf_counter() - started


def unit(field: Field) -> float:
    """The length that normalised distances count in: half the longest side of the box."""
    assert field.box is not None
    return field.box.frame.scale


def mean_distance(field: Field, t: float, shape: Solid, motion: equations.Equation) -> float:
    """The mean distance between the surface at time t and the shape, carried along exact characteristics.

    Both ways, and the greater mean counts: points of the shape carried forward, to the surface to first order; points
    of the surface carried back, to the shape exactly.
    """

    def carried(x: Tensor, start: float, end: float) -> Tensor:
        y = motion.carry(x, x.new_full((len(x),), start), x.new_full((len(x),), end), steps=64)
        assert y is not None
        return y

    generator, surface = seeded(), Implicit(field.at(t))
    there = shape.distance(carried(surface.sample(POINTS, generator=generator).points, t, 0.0)).abs().mean()
    here = surface.gap(carried(shape.sample(POINTS, generator=generator).points, 0.0, t)).mean()
    return max(float(there), float(here)) / unit(field)


def radii(field: Field, center: tuple[float, float, float] = (0.0, 0.0, 0.0), *, height: float | None = None) -> Tensor:
    """The distances of points of the surface from the centre, found along rays by bisection.

    With a height, from that above the centre along horizontal rays.
    """
    directions = torch.randn(2000, 3, generator=seeded(), dtype=torch.float64)
    start = torch.tensor(center, dtype=torch.float64)
    if height is not None:
        directions[:, 2], start[2] = 0.0, start[2] + height
    return along(field, start, directions / torch.linalg.vector_norm(directions, dim=1, keepdim=True))


def along(field: Field, start: Tensor, directions: Tensor) -> Tensor:
    """How far the surface is from a point inside it, at most 1, along unit vectors; by bisection."""
    low, high = torch.zeros(len(directions), dtype=torch.float64), torch.ones(len(directions), dtype=torch.float64)
    with torch.no_grad():
        for _ in range(40):
            middle = (low + high) / 2
            inside = field(start + middle[:, None] * directions) < 0
            low, high = torch.where(inside, middle, low), torch.where(inside, high, middle)
    return low


def at_origin(field: Field, t: float) -> float:
    """The value at the origin at a time."""
    return float(field.at(t)(torch.zeros(1, 3, dtype=torch.float64)))


def section(first: float, last: float, height: float) -> list[Tensor]:
    """Points of half planes through the z axis, at twelve angles."""
    rho, z = torch.meshgrid(
        torch.linspace(first, last, 181, dtype=torch.float64),
        torch.linspace(-height, height, 121, dtype=torch.float64),
        indexing="ij",
    )
    rho, z = rho.reshape(-1), z.reshape(-1)
    angles = [2 * math.pi * i / 12 for i in range(12)]
    return [torch.stack([rho * math.cos(a), rho * math.sin(a), z], dim=1) for a in angles]


def last_time(field: Field, sections: Sequence[Tensor], first: float, last: float) -> float:
    """When the surface vanishes from half planes, on average over them."""
    times = []
    for points in sections:
        times.append(change(lambda t, x=points: float(field.at(t)(x).min()) < 0, first, last))  # type: ignore[misc]
    return sum(times) / len(times)


@torch.no_grad()
def change(holds: Callable[[float], bool], first: float, last: float) -> float:
    """The time at which what holds at first ends, by bisection."""
    for _ in range(40):
        middle = (first + last) / 2
        first, last = (middle, last) if holds(middle) else (first, middle)
    return first


def seeded() -> torch.Generator:
    """The source of the randomness of measurements, the same for each."""
    return torch.Generator().manual_seed(1)
