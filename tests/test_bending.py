"""Equations of fourth order, with a second network for the curvature."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from levelflow.bending import Agreement, Bending
from levelflow.boxes import Box
from levelflow.conditions import Sampling
from levelflow.equations import Willmore
from levelflow.fields import Placed
from levelflow.minimising import Budget
from levelflow.networks.siren import SIREN
from levelflow.shapes import Circle
from levelflow.shapes.implicit import Implicit
from levelflow.solving import solve
from tests.fields import Explicit

SCALE, RATE = 2.0, 0.5


def radius(tau: Tensor) -> Tensor:
    """Of a circle under the flow, in normalised units, from normalised times in an interval from 0 to 1."""
    return (0.5**4 + RATE * (tau[:, 0] + 1) / 2 / SCALE**4) ** 0.25


def grown() -> Placed:
    def value(u: Tensor, tau: Tensor) -> Tensor:
        return (u.norm(dim=1) ** 4 - RATE * (tau[:, 0] + 1) / 2 / SCALE**4).clamp_min(1e-9).sqrt().sqrt() - 0.5

    return Placed(Explicit(value, 2, 1), Box((-SCALE,) * 2, (SCALE,) * 2).during((0.0, 1.0)))


def curvature(factor: float = 1.0) -> Explicit:
    """What the network of the curvature is to become: a tenth of it in normalised units."""
    return Explicit(lambda u, tau: factor / u.norm(dim=1) / Agreement.size, 2, 1)


def batch(generator: torch.Generator) -> Tensor:
    tau = 2 * torch.rand(50, 1, generator=generator, dtype=torch.float64) - 1
    angle = 6.3 * torch.rand(50, generator=generator, dtype=torch.float64)
    return torch.cat([radius(tau)[:, None] * torch.stack([angle.cos(), angle.sin()], dim=1), tau], dim=1)


def test_the_true_motion_has_no_loss_and_another_has(generator: torch.Generator) -> None:
    z = batch(generator)
    term = Bending(grown(), Willmore(RATE), curvature(), n=10)
    term.spent = 1.0
    assert term.loss(z).max() < 1e-20
    assert Bending(grown(), Willmore(RATE), curvature(1.1), n=10).loss(z).min() > 1e-6
    faster = Bending(grown(), Willmore(2 * RATE), curvature(), n=10)
    faster.spent = 1.0
    assert faster.loss(z).min() > 1e-6


def test_a_curvature_that_agrees_has_no_loss_and_another_has(generator: torch.Generator) -> None:
    z = batch(generator)
    assert Agreement(grown(), Willmore(RATE), curvature(), n=10, until=0.2).loss(z).max() < 1e-20
    assert Agreement(grown(), Willmore(RATE), curvature(1.1), n=10).loss(z).min() > 1e-6


def test_the_motion_comes_up_to_its_rate(generator: torch.Generator) -> None:
    still = Bending(grown(), Willmore(RATE), curvature(), n=10, since=0.2)
    paces = []
    for still.spent in (0.2, 0.4, 0.6, 1.0):
        paces.append(still.pace)
    assert paces == pytest.approx([0.02, 0.5, 1.0, 1.0])
    # Half as fast, the motion of half the rate is the true one.
    half = Bending(grown(), Willmore(2 * RATE), curvature(), n=10)
    half.spent = half.ramp / 2
    assert half.loss(batch(generator)).max() < 1e-20


def test_a_circle_grows_as_the_root_of_the_root(generator: torch.Generator) -> None:
    field = solve(
        Willmore(1.0), SIREN(2, 1, width=32, depth=2), at={0.0: Circle(0.3)}, until=0.03, budget=Budget(300),
        box=Box((-0.6, -0.6), (0.6, 0.6)), sampling=Sampling(n=1024, given=5000),
    )  # fmt: skip
    for t in (0.0, 0.03):
        found = Implicit(field.at(t)).sample(500, generator=generator).points.norm(dim=1)
        assert (found - (0.3**4 + t) ** 0.25).abs().max() < 0.008
