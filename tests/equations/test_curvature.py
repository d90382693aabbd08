"""Motion by mean curvature against spheres, circles and cylinders that shrink."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from levelflow.equations.curvature import MeanCurvature
from tests.fields import Explicit, points


@pytest.mark.parametrize(("space", "across"), [(2, 2), (3, 3), (3, 2)], ids=["circle", "sphere", "cylinder"])
def test_what_is_round_shrinks_as_its_exact_solution(space: int, across: int) -> None:
    rate = 0.3

    def shrinking(x: Tensor, t: Tensor) -> Tensor:
        y = x[:, :across]
        return ((y * y).sum(1) + 2 * (across - 1) * rate * (t[:, 0] + 1)).sqrt() - 0.5

    field = Explicit(shrinking, space, 1)
    x, t = points(field, 200)
    jet = field.jet(x, t, order=2)
    assert MeanCurvature(rate=rate).residual(x, t, jet).abs().max() < 1e-13
    assert MeanCurvature(rate=2 * rate).residual(x, t, jet).abs().min() > 1e-3


def test_a_sphere_of_radius_r_sinks_at_twice_the_rate_over_r(generator: torch.Generator) -> None:
    x = torch.nn.functional.normalize(torch.randn(20, 3, generator=generator, dtype=torch.float64), dim=1)
    jet = Explicit(lambda x, t: x.norm(dim=1) - 0.5, 3).jet(0.5 * x, order=2)
    speed = MeanCurvature(rate=0.3).speed(0.5 * x, x.new_zeros(20, 1), jet)
    assert torch.allclose(speed, torch.full_like(speed, -0.3 * 2 / 0.5))


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan])
def test_a_rate_that_is_not_positive_is_refused(rate: float) -> None:
    with pytest.raises(ValueError, match=rf"MeanCurvature\(rate={rate:g}\): .* run time backwards") as caught:
        MeanCurvature(rate=rate)
    assert "until=-0.1" in str(caught.value)
