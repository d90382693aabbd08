"""Measures against distances and residuals that are known exactly."""

import numpy as np
import pytest
import torch
from torch import Tensor

from levelflow.boxes import Box
from levelflow.equations.curvature import MeanCurvature
from levelflow.extraction import extract
from levelflow.fields import Field
from levelflow.jets import Jet
from levelflow.measures import Spread, chamfer, hausdorff, residual_table, surface_distance
from levelflow.shapes.analytic import Sphere
from levelflow.shapes.cloud import PointCloud
from levelflow.shapes.mesh import Mesh
from levelflow.shapes.shape import Samples, Shape

BOX = Box((-1, -1, -1), (1, 1, 1))


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def sphere_mesh(radius: float) -> Mesh:
    return extract(Sphere(radius).distance, resolution=48, box=BOX, refine=3)


def square(shift: float = 0.0) -> Mesh:
    """The unit square at the height `shift`."""
    vertices = np.array([[0, 0, shift], [1, 0, shift], [1, 1, shift], [0, 1, shift]], dtype=np.float64)
    return Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]))


class ShrinkingSphere(Field):
    """sqrt(|x|^2 + 4 rate t) - r0, the exact solution of motion by mean curvature."""

    space, times = 3, 1

    def __init__(self, radius: float, rate: float) -> None:
        super().__init__()
        self.radius, self.rate, self.box = radius, rate, BOX.during((0.0, 0.5))

    def push(self, jet: Jet) -> Jet:
        raise NotImplementedError

    def forward(self, x: Tensor, t: Tensor | None = None) -> Tensor:
        assert t is not None
        return (x.square().sum(1) + 4 * self.rate * t[:, 0]).sqrt() - self.radius

    def jet(self, x: Tensor, t: Tensor | None = None, *, order: int = 1) -> Jet:
        assert t is not None
        root = self(x, t) + self.radius
        first = torch.cat([x, torch.full_like(t, 2 * self.rate)], dim=1) / root[:, None]
        unit = x / root[:, None]
        second = (torch.eye(3, dtype=x.dtype) - unit[:, :, None] * unit[:, None, :]) / root[:, None, None]
        return Jet(root - self.radius, first, second, 3)


def test_concentric_spheres_are_the_difference_of_radii_apart() -> None:
    a, b = Sphere(0.5), Sphere(0.7)
    inner, outer = sphere_mesh(0.5), sphere_mesh(0.7)
    for first, second, tolerance in ((a, b, 1e-12), (inner, outer, 5e-3), (inner, b, 2e-3)):
        found = surface_distance(first, second, n=3000, generator=generator())
        for value in (*found.there, *found.back, found.chamfer, found.hausdorff):
            assert value == pytest.approx(0.2, abs=tolerance)


def test_a_surface_is_at_no_distance_from_itself() -> None:
    mesh = sphere_mesh(0.5)
    assert hausdorff(mesh, mesh, n=1000, generator=generator()) < 1e-9
    assert chamfer(Sphere(0.5), Sphere(0.5), n=1000, generator=generator()) < 1e-15


def test_parallel_squares() -> None:
    assert chamfer(square(), square(0.3), generator=generator()) == pytest.approx(0.3)
    assert hausdorff(square(), square(0.3), generator=generator()) == pytest.approx(0.3)


def test_both_ways_differ_where_one_surface_is_part_of_the_other() -> None:
    whole = square()
    half = Mesh(whole.vertices * [0.5, 1, 1], whole.faces)
    found = surface_distance(half, whole, n=20_000, generator=generator())
    assert found.there == pytest.approx((0, 0), abs=1e-12)
    # From the other half, x - 1/2 is uniform on [0, 1/2]; the farthest points are vertices.
    assert found.back.mean == pytest.approx(1 / 8, rel=0.02)
    assert found.hausdorff == pytest.approx(0.5, abs=1e-12)
    turned = surface_distance(whole, half, n=20_000, generator=generator())
    assert turned.hausdorff == found.hausdorff
    assert turned.there.mean == pytest.approx(1 / 8, rel=0.02)


def test_points_are_taken_as_they_are() -> None:
    a = np.array([[0.0, 0.0], [1.0, 0.0]])
    found = surface_distance(a, torch.tensor([[0.0, 1.0], [1.0, 3.0], [1.0, 1.0]]), generator=generator())
    assert found.there == (1, 1)
    assert found.back == (pytest.approx(5 / 3), 3)
    samples = Sphere(0.5).sample(500, generator=generator()).points.numpy()
    found = surface_distance(PointCloud(samples), Sphere(0.4), n=100, generator=generator())
    assert found.there.max == pytest.approx(0.1)


def test_curves_in_the_plane() -> None:
    turn = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], 1)
    segments = np.stack([np.arange(400), np.roll(np.arange(400), -1)], 1)
    found = surface_distance(Mesh(circle, segments), Mesh(1.25 * circle, segments), n=2000, generator=generator())
    assert found.chamfer == pytest.approx(0.25, abs=1e-4)


def test_the_same_seed_gives_the_same_distance() -> None:
    a, b = sphere_mesh(0.5), square()
    assert surface_distance(a, b, n=500, generator=generator()) == surface_distance(a, b, n=500, generator=generator())
    assert "chamfer 0.3, Hausdorff 0.3" in str(surface_distance(square(), square(0.3), generator=generator()))


def test_columns_of_an_exact_solution_are_zero() -> None:
    table = residual_table(
        ShrinkingSphere(0.5, 0.1), MeanCurvature(rate=0.1), Sphere(0.5), time=0.0, generator=generator()
    )
    assert table.surface.max < 1e-15
    assert table.distance is not None
    assert table.distance.max < 1e-15
    assert table.equation.max < 1e-12


def test_columns_of_a_wrong_field_are_its_errors() -> None:
    table = residual_table(
        ShrinkingSphere(0.4, 0.1), MeanCurvature(rate=0.2), Sphere(0.5), time=(0.0,), n=2000, generator=generator()
    )
    assert table.surface == pytest.approx((0.1, 0.1))
    assert table.distance == pytest.approx((0.1, 0.1))
    # F = f_t - rate |grad f| kappa, and |grad f| kappa = 2 / sqrt(|x|^2 + 4 rate t): off by 0.2 / that root.
    assert 0.2 / np.sqrt(3 + 0.2) < table.equation.mean < table.equation.max
    assert str(table).splitlines()[0].split() == ["on-surface", "off-surface", "equation"]
    assert str(table).splitlines()[2].split()[:2] == ["0.1", "0.1"]


def test_an_equation_is_judged_where_it_draws() -> None:
    """The rate is right at t = 0, where this equation draws all of its times, and wrong afterwards."""

    class AtOnce(MeanCurvature):
        def draw(self, n: int, *, generator: torch.Generator) -> Tensor:
            return torch.zeros(n, 1, dtype=torch.float64)

        def residual(self, x: Tensor, t: Tensor, jet: Jet) -> Tensor:
            return super().residual(x, t, jet) + t[:, 0]

    field = ShrinkingSphere(0.5, 0.1)
    table = residual_table(field, AtOnce(rate=0.1), Sphere(0.5), time=0.0, generator=generator())
    assert table.equation.max < 1e-12


class Skin(Shape):
    """A sphere whose distance is not known."""

    box = BOX

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        return Sphere(0.5).sample(n, generator=generator)


def test_without_a_distance_there_is_no_such_column() -> None:
    table = residual_table(ShrinkingSphere(0.5, 0.1), MeanCurvature(rate=0.1), Skin(), time=0.0, generator=generator())
    assert table.distance is None
    assert "off-surface" not in str(table)


def test_what_cannot_be_measured_says_why() -> None:
    field, equation = ShrinkingSphere(0.5, 0.1), MeanCurvature(rate=0.1)
    with pytest.raises(ValueError, match="one value for each"):
        residual_table(field, equation, Sphere(0.5), time=(0.0, 1.0), generator=generator())
    field.box = None
    with pytest.raises(ValueError, match="has no box"):
        residual_table(field, equation, Sphere(0.5), time=0.0, generator=generator())
    with pytest.raises(TypeError, match="Skin has no distance. Extract a mesh"):
        chamfer(Sphere(0.5), Skin(), n=10, generator=generator())
    with pytest.raises(ValueError, match=r"a lies in R\^2 and b in R\^3"):
        chamfer(np.zeros((3, 2)), Sphere(0.5), n=10, generator=generator())
    assert Spread.of(torch.tensor([-3.0, 1.0])) == (2, 3)
