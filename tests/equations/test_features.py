"""Smoothing that keeps features, against circles and spheres on both sides of its threshold."""

import math

import pytest
import torch

from levelflow import SIREN, Budget, Circle, Rectangle, Sampling, solve
from levelflow.curvature import principal_curvatures
from levelflow.equations import Family, FeaturePreserving, MeanCurvature, Regional, Stationary, Transport
from levelflow.jets import Jet
from levelflow.shapes.implicit import Implicit
from tests.fields import Explicit, points, siren

RATE, THRESHOLD = 0.1, 1.5


def radius(t, start, space):
    """That of a circle or sphere that starts above the threshold's radius or below it, and stays there."""
    rate = (space - 1) * RATE
    if start > 1 / THRESHOLD:
        return (start**2 - 2 * rate * t).sqrt()
    return start * torch.exp(-rate * THRESHOLD**2 * t)


@pytest.mark.parametrize("space", [2, 3])
def test_what_is_round_shrinks_by_curvature_above_the_least_radius_and_exponentially_below(space):
    motion = FeaturePreserving(RATE, THRESHOLD)
    for start in (0.9, 0.5):
        # Level sets that all have the radius of the moving one; the speed is asked for on it.
        field = Explicit(lambda x, t, r=start: x.norm(dim=1) - radius(t[:, 0], r, x.shape[1]), space, 1)
        x, t = points(field, 200)
        t = 0.2 * (t + 1)
        on = x / x.norm(dim=1, keepdim=True) * radius(t, start, space)
        jet = field.jet(on, t, order=2)
        assert motion.residual(on, t, jet).detach().abs().max() < 1e-12
        assert motion.error(on, t, jet).detach().abs().max() < 1e-12


def test_an_edge_stays_and_is_smoothed_along_itself():
    """A torus whose tube bends beyond the threshold: of two curvatures the one around the hole counts."""
    motion, tube = FeaturePreserving(RATE, THRESHOLD), 0.02
    field = Explicit(lambda x, t: ((x[:, :2].norm(dim=1) - 1) ** 2 + x[:, 2] ** 2).sqrt() - tube, 3, 1)
    x = torch.tensor([[1 + tube, 0.0, 0.0], [0.0, 1 - tube, 0.0]], dtype=torch.float64)
    speed = motion.speed(x, x.new_zeros(2, 1), field.jet(x, x.new_zeros(2, 1), order=2))
    around = torch.tensor([1 / (1 + tube), -1 / (1 - tube)], dtype=torch.float64)
    assert torch.allclose(speed, -RATE * (THRESHOLD**2 * tube + around))


def test_below_the_threshold_it_is_motion_by_mean_curvature():
    field = siren(3, 1)
    x, t = points(field)
    jet = field.jet(x, t, order=2)
    wide = FeaturePreserving(RATE, 1e6)
    assert torch.allclose(wide.speed(x, t, jet), MeanCurvature(RATE).speed(x, t, jet))
    bent = principal_curvatures(jet).abs().amax(1) > THRESHOLD
    less = FeaturePreserving(RATE, THRESHOLD).speed(x, t, jet) - MeanCurvature(RATE).speed(x, t, jet)
    assert less[~bent].abs().max() < 1e-12 < less[bent].abs().min()


def test_its_speed_is_bounded_and_sums_tell_whether_theirs_is():
    motion = FeaturePreserving(RATE, THRESHOLD)
    field = Explicit(lambda x, t: x.norm(dim=1) - 1e-3, 3, 1)
    x, t = points(field)
    x = 1e-3 * x / x.norm(dim=1, keepdim=True)
    assert motion.speed(x, t, field.jet(x, t, order=2)).abs().max() < 2 * RATE * THRESHOLD
    kept = (
        motion + Stationary(),
        motion + Transport((1.0, 0.0, 0.0)),
        Regional(motion, lambda x: x[:, 0]),
        *Family(motion).columns,
    )
    assert motion.bounded and all(kind.bounded for kind in kept)
    assert not MeanCurvature(1).bounded and not (motion + MeanCurvature(1)).bounded


def test_its_derivative_is_finite_where_the_curvatures_are_equal():
    hessian = torch.eye(3, dtype=torch.float64)[None].requires_grad_()
    slope = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    FeaturePreserving(RATE, 2.0).speed(slope, slope[:, :1], Jet(slope[:, 0], slope, hessian, 3)).sum().backward()
    assert hessian.grad is not None
    across = torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64)
    assert torch.allclose(hessian.grad[0], -RATE * across.diag())


@pytest.mark.parametrize(("start", "limit"), [(0.9, 0.004), (0.5, 0.02)])
def test_circles_are_solved_on_both_sides_of_the_threshold(start, limit, generator):
    field = solve(
        FeaturePreserving(RATE, THRESHOLD), SIREN(2, 1, width=32, depth=2), at={0.0: Circle(start)}, until=1.5,
        budget=Budget(steps=300), sampling=Sampling(n=1024, given=20_000),
    )  # fmt: skip
    for t in (0.0, 0.75, 1.5):
        found = Implicit(field.at(t)).sample(500, generator=generator).points.norm(dim=1)
        assert (found / float(radius(torch.tensor(t), start, 2)) - 1).abs().max() < limit


def test_corners_stay_where_curvature_rounds_them(generator):
    square, sunk = Rectangle((1.2, 1.2)), []
    for motion in (FeaturePreserving(1.0, 8.0), MeanCurvature(1.0)):
        field = solve(
            motion, SIREN(2, 1, width=64, omega=15.0), at={0.0: square}, until=1.2e-3,
            budget=Budget(steps=400), sampling=Sampling(n=1024, given=20_000),
        )  # fmt: skip
        points = Implicit(field.at(1.2e-3)).sample(4000, generator=generator).points
        sunk.append(float((points.abs() - 0.6).norm(dim=1).min()))
    assert sunk[0] < 0.65 * sunk[1]


@pytest.mark.parametrize(("rate", "threshold"), [(0.0, 1.0), (1.0, 0.0), (1.0, math.nan), (-1.0, 1.0)])
def test_rates_and_thresholds_that_are_not_positive_are_refused(rate, threshold):
    with pytest.raises(ValueError, match=r"FeaturePreserving\(rate=.*the rate and the threshold must be positive"):
        FeaturePreserving(rate, threshold)
