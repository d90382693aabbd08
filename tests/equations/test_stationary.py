"""No motion."""

from __future__ import annotations

import torch

from levelflow.equations.stationary import Stationary
from tests.fields import Explicit, points, round_field, siren


def test_a_field_that_does_not_depend_on_time_stands_still() -> None:
    field = Explicit(lambda x, t: round_field(x, 0 * t), 2, 1)
    x, t = points(field)
    assert (Stationary().residual(x, t, field.jet(x, t, order=1)) == 0).all()


def test_the_residual_is_the_derivative_in_time() -> None:
    field = siren(2, 1)
    x, t = points(field)
    jet = field.jet(x, t, order=1)
    assert torch.equal(Stationary().residual(x, t, jet), jet.dt[:, 0])
    assert (Stationary().speed(x, t, jet) == 0).all()


def test_points_are_carried_nowhere() -> None:
    x, t = points(siren(2, 1))
    assert torch.equal(Stationary().carry(x, t[:, 0], t[:, 0] + 5), x)
