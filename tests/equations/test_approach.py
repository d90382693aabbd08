"""Motion towards a shape by its distance: concentric circles and spheres come closer like e^(-t)."""

from __future__ import annotations

import math

import pytest
import torch

from levelflow.equations.approach import Approach
from levelflow.equations.eikonal import Eikonal
from levelflow.equations.family import Family
from levelflow.equations.morph import Morph
from levelflow.equations.regional import Regional
from levelflow.equations.stationary import Stationary
from levelflow.fields import Placed
from levelflow.shapes.analytic import Circle, Sphere
from levelflow.shapes.cloud import PointCloud
from tests.fields import Explicit, points, siren

TARGET = 0.8


def approaching(rate: float, space: int = 2) -> Explicit:
    """A circle of radius 0.3 on the way to one of radius 0.8, and all level sets around it."""
    return Explicit(lambda x, t: (x.norm(dim=1) - TARGET) * torch.exp(rate * t[:, 0]) + TARGET - 0.3, space, 1)


@pytest.mark.parametrize("rate", [1.0, 2.5])
def test_the_difference_of_the_radii_falls_exponentially(rate: float) -> None:
    for field, target in ((approaching(rate), Circle(TARGET)), (approaching(rate, 3), Sphere(TARGET))):
        x, t = points(field, 200)
        jet = field.jet(x, t, order=1)
        motion = Approach(target, rate=rate)
        assert motion.residual(x, t, jet).detach().abs().max() < 1e-12
        assert motion.error(x, t, jet).detach().abs().max() < 1e-12
        assert Approach(target, rate=rate + 0.1).error(x, t, jet).detach().abs().max() > 0.01
        ray, t = x / x.norm(dim=1, keepdim=True), t.abs()
        radius = TARGET + (0.3 - TARGET) * torch.exp(-rate * t)
        assert field(radius * ray, t).detach().abs().max() < 1e-12


def test_the_surface_moves_out_inside_the_target_and_in_outside() -> None:
    field = siren(2, 1)
    x, t = points(field)
    speed = Approach(Circle(TARGET)).speed(x, t, field.jet(x, t, order=1))
    assert torch.equal(speed > 0, x.norm(dim=1) < TARGET)


def test_a_field_can_be_the_target() -> None:
    field, goal = approaching(1.0), Explicit(lambda x, t: x.norm(dim=1) - TARGET, 2)
    x, t = points(field)
    assert Approach(goal).residual(x, t, field.jet(x, t, order=1)).detach().abs().max() < 1e-12


def test_it_says_where_it_leads_however_it_is_wrapped() -> None:
    here, there = Circle(0.5), Circle(0.5, center=(3.0, 0.0))
    motion = Approach(there, rate=2)
    assert repr(motion) == "Approach(towards a Circle, rate=2)"
    half = Regional(motion, lambda x: x[:, 0])
    assert motion.leads_to == half.leads_to == (there.box,)
    assert (motion + Stationary()).leads_to == (there.box,)
    assert Morph({1.0: here, 2.0: there}).leads_to == (here.box, there.box)
    (along,) = Family(motion).columns
    assert along.leads_to == (there.box,)
    assert Eikonal().leads_to == ()
    assert Approach(Explicit(lambda x, t: x.norm(dim=1) - TARGET, 2)).leads_to == ()
    known = Placed(Explicit(lambda x, t: x.norm(dim=1) - 0.25, 2), here.box.expanded(0.5))
    (box,) = Approach(known).leads_to
    assert box.size == pytest.approx((0.51, 0.51), rel=0.01)


@pytest.mark.usefixtures("unchecked")
def test_a_target_without_a_distance_is_refused() -> None:
    angle = torch.linspace(0, 2 * math.pi, 20)[:-1]
    cloud = PointCloud(torch.stack([angle.cos(), angle.sin()], dim=1).numpy())
    with pytest.raises(TypeError, match="Approach: a target of type PointCloud has no distance"):
        Approach(cloud)  # type: ignore[arg-type]


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan])
def test_the_rate_is_positive(rate: float) -> None:
    with pytest.raises(ValueError, match=rf"Approach\(rate={rate:g}\): the rate must be positive"):
        Approach(Circle(TARGET), rate=rate)
