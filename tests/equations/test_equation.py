"""Equations and their sums, and motions of one's own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from levelflow.curvature import gradient_norm
from levelflow.equations.curvature import MeanCurvature
from levelflow.equations.eikonal import Eikonal
from levelflow.equations.equation import Equation, LevelSetEquation, Motions, Together
from levelflow.equations.stationary import Stationary
from levelflow.equations.transport import Transport
from levelflow.jets import Jet
from tests.fields import Explicit, points, siren


@dataclass(frozen=True)
class Inflate(LevelSetEquation):
    """Motion along the normal at constant speed."""

    rate: float

    def speed(self, x: Tensor, t: Tensor, jet: Jet) -> Tensor:
        return torch.full_like(jet.value, self.rate)


@dataclass(frozen=True)
class Flat(Equation):
    """The Laplacian vanishes."""

    order: ClassVar[int] = 2

    def residual(self, x: Tensor, t: Tensor, jet: Jet) -> Tensor:
        return jet.hessian.diagonal(dim1=1, dim2=2).sum(1)


X, T = points(siren(2, 1))
JET = siren(2, 1).jet(X, T, order=2)


def test_a_motion_of_ones_own_is_solved_by_its_exact_solution() -> None:
    growing = Explicit(lambda x, t: x.norm(dim=1) - 0.5 - 0.3 * t[:, 0], 2, 1).jet(X, T, order=1)
    assert Inflate(0.3).residual(X, T, growing).abs().max() < 1e-14
    assert Inflate(0.3).error(X, T, growing).abs().max() < 1e-14


def test_the_error_is_that_of_the_speed_so_that_a_flatter_field_does_not_lower_it() -> None:
    flatter = Jet(0.01 * JET.value, 0.01 * JET.first, 0.01 * JET.second, JET.space)
    for equation in (Inflate(0.3), MeanCurvature(rate=0.1), Transport((1, 2))):
        assert torch.allclose(equation.error(X, T, JET) * gradient_norm(JET), equation.residual(X, T, JET))
        assert torch.allclose(equation.error(X, T, flatter), equation.error(X, T, JET))
        assert torch.allclose(equation.residual(X, T, flatter), 0.01 * equation.residual(X, T, JET))


def test_motions_add_their_speeds() -> None:
    parts = (MeanCurvature(rate=0.1), Inflate(0.3), Transport((1, 2)), Stationary())
    total = parts[0] + parts[1] + parts[2] + parts[3]
    assert isinstance(total, Motions) and total.order == 2
    assert torch.allclose(total.speed(X, T, JET), sum(part.speed(X, T, JET) for part in parts))
    assert repr(parts[0] + parts[1]) == "MeanCurvature(rate=0.1) + Inflate(rate=0.3)"


def test_a_sphere_that_shrinks_while_it_is_carried_away_solves_the_sum_of_both() -> None:
    def moving(x: Tensor, t: Tensor) -> Tensor:
        y = x - t * x.new_tensor([0.5, -0.2])
        return ((y * y).sum(1) + 2 * 0.1 * (2 + t[:, 0])).sqrt() - 0.5

    jet = Explicit(moving, 2, 1).jet(X, T, order=2)
    assert (MeanCurvature(rate=0.1) + Transport((0.5, -0.2))).residual(X, T, jet).abs().max() < 1e-13


def test_several_equations_at_once_have_a_column_each() -> None:
    both = Transport((1, 2)) + Eikonal()
    assert isinstance(both, Together)
    assert repr(both) == "Transport(Constant(velocity=(1.0, 2.0))) + Eikonal()"
    columns = [Transport((1, 2)), Eikonal()]
    for name in ("residual", "error"):
        exact = torch.stack([getattr(equation, name)(X, T, JET) for equation in columns], dim=1)
        assert torch.equal(getattr(both, name)(X, T, JET), exact)
    assert both.order == 1 and (Flat() + Eikonal()).order == 2 and (Eikonal() + MeanCurvature(rate=1)).order == 2


def test_sums_of_equations_do_not_depend_on_how_they_are_bracketed() -> None:
    a, b, c, d = Eikonal(), Inflate(0.3), Flat(), MeanCurvature(rate=0.1)
    exact = torch.stack([e.residual(X, T, JET) for e in (a, b + d, c)], dim=1)
    for total in (((a + b) + c) + d, (a + b) + (c + d), a + (b + (c + d)), a + ((b + c) + d)):
        assert isinstance(total, Together) and len(total.equations) == 3
        assert torch.allclose(total.residual(X, T, JET), exact)
    twice = (b + a) + b
    assert torch.allclose(twice.residual(X, T, JET)[:, 0], Inflate(0.6).residual(X, T, JET))
    assert (a + c + a).residual(X, T, JET).shape == (len(X), 3)


def test_only_motions_that_do_not_depend_on_the_surface_can_carry_points() -> None:
    now = T[:, 0]
    for equation in (Inflate(0.3), MeanCurvature(rate=1), Eikonal(), Eikonal() + Stationary()):
        assert equation.carry(X, now, now) is None
