"""A distance read from a table."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from levelflow.boxes import Box
from levelflow.shapes.analytic import Circle, Cuboid, Sphere
from levelflow.shapes.combined import Translated
from levelflow.shapes.shape import Solid
from levelflow.shapes.tabulated import Tabulated


def worst(solid: Solid, resolution: int) -> float:
    """The greatest error near the surface."""
    x = solid.box.expanded(0.2).uniform(20_000, generator=torch.Generator().manual_seed(0))
    exact = solid.distance(x)
    return float((Tabulated(solid, resolution=resolution).distance(x) - exact)[exact.abs() < 0.2].abs().max())


@pytest.mark.parametrize("solid", [Circle(0.5), Sphere(0.5)], ids=["circle", "sphere"])
def test_the_error_falls_with_the_square_of_the_spacing(solid: Solid) -> None:
    resolutions = [16, 32, 64]
    errors = [worst(solid, n) for n in resolutions]
    slope = np.polyfit(np.log([n - 1 for n in resolutions]), np.log(errors), 1)[0]
    assert abs(slope + 2) < 0.3
    # At a distance of 0.2 inside the surface the level sets have kappa = 1 / 0.3, or the double, and h is 1.6 / 63.
    assert errors[-1] < (solid.box.space - 1) / 0.3 * (1.6 / 63) ** 2 / 8 * 1.1


def test_at_the_grid_points_the_distance_is_exact() -> None:
    solid = Circle(0.5)
    axis = torch.linspace(-0.8, 0.8, 17, dtype=torch.float64)
    x = torch.cartesian_prod(axis, axis)
    assert torch.allclose(Tabulated(solid, resolution=17).distance(x), solid.distance(x), rtol=0, atol=1e-14)


def test_each_coordinate_runs_along_its_own_axis(generator: torch.Generator) -> None:
    solid = Translated(Cuboid((0.4, 1.0, 2.0), radius=0.15), (3, 5, 7))
    x = solid.box.expanded(0.1).uniform(2000, generator=generator)
    found = Tabulated(solid, resolution=64).distance(x)
    assert (found - solid.distance(x)).abs().max() < 0.03


def test_far_from_the_origin_nothing_is_lost(generator: torch.Generator) -> None:
    here, there = Circle(0.5), Circle(0.5, center=(1e6 + 0.3, -3e6))
    x = here.box.uniform(500, generator=generator)
    far = x + torch.tensor([1e6 + 0.3, -3e6], dtype=torch.float64)
    assert torch.allclose(Tabulated(there).distance(far), Tabulated(here).distance(x), rtol=0, atol=1e-8)


def test_beyond_the_grid_the_value_at_its_side_is_used() -> None:
    table = Tabulated(Circle(0.5), margin=0.5)
    x = torch.tensor([[1.0, 0.0], [7.0, 0.0]], dtype=torch.float64)
    near, far = table.distance(x).tolist()
    assert near == pytest.approx(0.5, abs=1e-3) and far == near


def test_the_values_have_the_dtype_of_the_points() -> None:
    assert Tabulated(Circle(0.5)).distance(torch.zeros(3, 2)).dtype == torch.float32


def test_box_and_samples_are_those_of_the_solid(generator: torch.Generator) -> None:
    table = Tabulated(Circle(0.5))
    assert table.box == Box((-0.5, -0.5), (0.5, 0.5))
    exact = Circle(0.5).sample(50, generator=torch.Generator().manual_seed(0)).points
    assert torch.equal(table.sample(50, generator=generator).points, exact)


def test_a_grid_has_at_least_two_points_a_side() -> None:
    with pytest.raises(ValueError, match=r"Tabulated\(resolution=1\): a grid needs at least 2 points a side"):
        Tabulated(Circle(0.5), resolution=1)
