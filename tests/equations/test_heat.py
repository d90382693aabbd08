"""The heat equation against quadrics, whose zero sets shrink faster than by curvature, and waves, whose do not move."""

import math

import pytest
import torch

from levelflow import SIREN, Box, Budget, Circle, Sampling, equations, solve
from levelflow.curvature import gradient_norm
from levelflow.equations import Eikonal, Heat, MeanCurvature
from levelflow.shapes.implicit import Implicit
from tests.fields import Explicit, points


def quadric(x, t, rate=0.1, radius=0.7):
    return (x * x).sum(1) - radius**2 + 2 * x.shape[1] * rate * t.sum(1)


@pytest.mark.parametrize("space", [2, 3])
def test_a_quadric_sinks_by_twice_its_dimensions_and_a_wave_decays(space):
    k = torch.tensor([2.0, -1.0, 0.5], dtype=torch.float64)[:space]

    def wave(x, t):
        return torch.sin(x @ k) * torch.exp(-0.1 * (k @ k) * t[:, 0])

    for solution in (quadric, wave):
        field = Explicit(solution, space, 1)
        x, t = points(field, 200)
        jet = field.jet(x, t, order=2)
        assert Heat(0.1).residual(x, t, jet).detach().abs().max() < 1e-13
        assert Heat(0.2).residual(x, t, jet).detach().abs().max() > 0.1


def test_it_is_motion_by_mean_curvature_where_f_is_a_distance_and_only_there():
    heat, curvature = Heat(0.1), MeanCurvature(0.1)
    distance = Explicit(lambda x, t: x.norm(dim=1) - 0.5 - 0.3 * t[:, 0], 3, 1)
    x, t = points(distance, 200)
    jet = distance.jet(x, t, order=2)
    assert (gradient_norm(jet) - 1).abs().max() < 1e-12
    assert torch.allclose(heat.residual(x, t, jet), curvature.residual(x, t, jet))
    jet = Explicit(quadric, 3, 1).jet(x, t, order=2)
    assert (heat.residual(x, t, jet) - curvature.residual(x, t, jet)).abs().min() > 0.1


def test_its_error_is_a_rate_of_f_that_counts_like_a_displacement_and_drives_the_surface():
    box = Box((-1.0, -1.0), (3.0, 1.0), ((0.0, 5.0),))
    assert Heat(0.1).unit(box) == MeanCurvature(0.1).unit(box) == 5 / 2 / 2
    assert Heat(0.1).drives(2) == {0} and (Heat(0.1) + Eikonal()).drives(2) == {0}
    with pytest.raises(ValueError, match="two motions for one parameter"):
        Heat(0.1) + MeanCurvature(0.1)


def test_a_field_given_at_the_start_is_solved_with_all_of_its_values(generator):
    """A quadric by heat: its circle shrinks as r0^2 - 4 rate t, where by curvature r0^2 - 2 rate t is left of it."""
    box = Box((-1.4, -1.4), (1.4, 1.4))
    given = Explicit(lambda x, t: quadric(x, x.new_zeros(len(x), 1)), 2, box=box)
    field = solve(
        Heat(0.1), SIREN(2, 1, width=32, depth=2), at={0.0: given}, until=0.5, box=box,
        budget=Budget(steps=300), sampling=Sampling(n=1024, given=20_000),
    )  # fmt: skip
    x = 0.7 * box.uniform(500, generator=generator) / 1.4
    for t in (0.0, 0.25, 0.5):
        with torch.no_grad():
            assert (field.at(t)(x) - quadric(x, x.new_full((500, 1), t))).abs().max() < 0.03
        radii = Implicit(field.at(t)).sample(500, generator=generator).points.norm(dim=1)
        assert (radii - math.sqrt(0.49 - 0.4 * t)).abs().max() < 0.02


def test_backwards_in_time_it_is_ill_posed():
    with pytest.warns(UserWarning, match=r"Heat\(rate=0.1\) sharpens before t = 0"):
        solve(
            Heat(0.1), SIREN(2, 1, width=8, depth=2), at={0.0: Circle(0.5)}, until=-0.1,
            budget=Budget(steps=2), sampling=Sampling(n=64, given=500),
        )  # fmt: skip


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan])
def test_a_rate_that_is_not_positive_is_refused(rate):
    with pytest.raises(ValueError, match=rf"Heat\(rate={rate:g}\): .* run time backwards: solve\(..., until=-0.1\)"):
        equations.Heat(rate)


def test_a_field_that_stands_still_cannot_be_judged():
    field = Explicit(lambda x, t: x.norm(dim=1) - 0.5, 2)
    x, t = points(field)
    with pytest.raises(ValueError, match=r"Heat\(rate=1\): the field does not depend on time"):
        Heat(1).residual(x, t, field.jet(x, t, order=2))
