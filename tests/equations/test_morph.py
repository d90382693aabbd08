"""Morphing between concentric circles, whose radius is linear in time."""

from __future__ import annotations

import math
from typing import ClassVar

import pytest
import torch
from torch import Tensor

from levelflow.equations.curvature import MeanCurvature
from levelflow.equations.morph import Morph
from levelflow.shapes.analytic import Circle, Sphere
from levelflow.shapes.cloud import PointCloud
from levelflow.shapes.mesh import Mesh
from levelflow.shapes.tabulated import Tabulated
from tests.fields import Explicit, siren


class CostlyCircle(Circle):
    """A circle that counts the points at which its distance is asked for."""

    is_costly: ClassVar[bool] = True
    asked: ClassVar[int] = 0

    def distance(self, x: Tensor) -> Tensor:
        type(self).asked += len(x)
        return super().distance(x)


def interpolated(knots: dict[float, float], space: int = 2) -> Explicit:
    """The distance to a circle whose radius is linear between the given times."""
    times, radii = list(knots), list(knots.values())

    def distance(x: Tensor, t: Tensor) -> Tensor:
        radius = x.new_zeros(len(x))
        for i in range(len(times) - 1):
            inside = (t[:, 0] > times[i]) & (t[:, 0] <= times[i + 1])
            part = (t[:, 0] - times[i]) / (times[i + 1] - times[i])
            radius = torch.where(inside, radii[i] + part * (radii[i + 1] - radii[i]), radius)
        return x.norm(dim=1) - radius

    return Explicit(distance, space, 1)


def samples(first: float, last: float, generator: torch.Generator, space: int = 2) -> tuple[Tensor, Tensor]:
    x = 2 * torch.rand(200, space, generator=generator, dtype=torch.float64) - 1
    return x, first + (last - first) * torch.rand(200, 1, generator=generator, dtype=torch.float64)


def worst(morph: Morph, field: Explicit, x: Tensor, t: Tensor) -> float:
    jet = field.jet(x, t, order=1)
    return max(float(error.detach().abs().max()) for error in (morph.residual(x, t, jet), morph.error(x, t, jet)))


def test_the_radius_of_concentric_circles_is_linear_in_time(generator: torch.Generator) -> None:
    x, t = samples(0, 1, generator)
    assert worst(Morph(Circle(0.8)), interpolated({0: 0.3, 1: 0.8}), x, t) < 1e-11
    assert worst(Morph(Circle(0.8)), interpolated({0: 0.3, 1: 0.7}), x, t) > 0.05


def test_the_radius_of_concentric_spheres_is_linear_in_time(generator: torch.Generator) -> None:
    x, t = samples(0, 1, generator, space=3)
    assert worst(Morph(Sphere(0.8)), interpolated({0: 0.3, 1: 0.8}, space=3), x, t) < 1e-11


def test_departure_and_arrival_are_where_they_are_said_to_be(generator: torch.Generator) -> None:
    x, t = samples(2, 5, generator)
    assert worst(Morph(Circle(0.8), since=2, until=5), interpolated({2: 0.3, 5: 0.8}), x, t) < 1e-11


def test_several_targets_are_approached_one_after_another(generator: torch.Generator) -> None:
    x, t = samples(-1, 3, generator)
    morph = Morph({3.0: Circle(0.5), 0.5: Circle(0.8), 2.0: Circle(0.2)}, since=-1)
    assert worst(morph, interpolated({-1: 0.3, 0.5: 0.8, 2: 0.2, 3: 0.5}), x, t) < 1e-10


def test_a_field_can_be_the_target(generator: torch.Generator) -> None:
    x, t = samples(0, 1, generator)
    assert worst(Morph(Explicit(lambda x, t: x.norm(dim=1) - 0.8, 2)), interpolated({0: 0.3, 1: 0.8}), x, t) < 1e-11


def test_at_the_arrival_the_error_is_that_of_the_value_and_stays_bounded(generator: torch.Generator) -> None:
    x, _ = samples(0, 1, generator)
    t = torch.ones(200, 1, dtype=torch.float64)
    jet = siren(2, 1).jet(x, t, order=1)
    exact = jet.value - (x.norm(dim=1) - 0.8)
    assert torch.allclose(Morph(Circle(0.8)).error(x, t, jet), exact, atol=1e-4)
    late = Morph({0.25: Circle(0.3), 1.0: Circle(0.8)})
    assert torch.allclose(late.error(x, t, jet), exact / 0.75, atol=1e-4)


def test_the_error_is_the_residual_times_the_part_that_remains(generator: torch.Generator) -> None:
    x, t = samples(1, 4, generator)
    jet = interpolated({1: 0.3, 4: 0.6}).jet(x, t, order=1)
    morph = Morph(Circle(0.8), since=1.0, until=4.0)
    assert torch.allclose(morph.error(x, t, jet), morph.residual(x, t, jet) * (4 - t[:, 0]) / 3)


def test_a_costly_distance_is_tabulated_once(generator: torch.Generator) -> None:
    morph = Morph(CostlyCircle(0.8))
    asked = CostlyCircle.asked
    assert asked > 0
    x, t = samples(0, 0.9, generator)
    jet = interpolated({0: 0.3, 1: 0.8}).jet(x, t, order=1)
    assert torch.allclose(morph.error(x, t, jet), Morph(Circle(0.8)).error(x, t, jet), rtol=0, atol=2e-3)
    assert CostlyCircle.asked == asked


def test_a_morph_says_where_it_goes() -> None:
    assert repr(Morph({0.5: Circle(1.0), 2.0: Circle(2.0)})) == "Morph(towards 2 target(s) at t = 0.5, 2)"


@pytest.mark.usefixtures("unchecked")
def test_a_target_without_a_distance_is_refused() -> None:
    angle = torch.linspace(0, 2 * math.pi, 20)[:-1]
    cloud = PointCloud(torch.stack([angle.cos(), angle.sin()], dim=1).numpy())
    with pytest.raises(TypeError, match="a target of type PointCloud has no distance; fit a field to it and give that"):
        Morph(cloud)  # type: ignore[arg-type]


@pytest.mark.parametrize("until", [0.0, -1.0])
def test_a_target_comes_after_the_departure(until: float) -> None:
    with pytest.raises(ValueError, match=rf"a target at t = {until:g} is not after the departure at t = 0"):
        Morph(Circle(0.8), until=until)


def test_a_mesh_is_tabulated() -> None:
    angle = torch.arange(40) / 40 * 2 * math.pi
    curve = Mesh(
        torch.stack([angle.cos(), angle.sin()], dim=1).double().numpy(), [[i, (i + 1) % 40] for i in range(40)]
    )
    assert isinstance(Morph(curve)._values[0].__self__, Tabulated)  # type: ignore[attr-defined]


def test_after_the_last_target_nothing_moves(generator: torch.Generator) -> None:
    x, t = samples(1.2, 2, generator)
    jet = siren(2, 1).jet(x, t, order=1)
    assert torch.equal(Morph(Circle(0.8)).speed(x, t, jet), torch.zeros_like(jet.value))


def test_with_another_motion_the_error_stays_bounded_at_the_arrival(generator: torch.Generator) -> None:
    x, _ = samples(0, 1, generator)
    jet = siren(2, 1).jet(x, torch.ones(200, 1).double(), order=2)
    both = Morph(Circle(0.8)) + MeanCurvature(0.1)
    for t in (0.999, 1 - 1e-9, 1.0):
        alone = Morph(Circle(0.8)).error(x, torch.full((200, 1), t).double(), jet)
        assert (both.error(x, torch.full((200, 1), t).double(), jet) - alone).abs().max() < 0.1
