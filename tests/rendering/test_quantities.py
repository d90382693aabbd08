"""Numbers on surfaces against the curvature of spheres and tori and exact solutions of equations."""

import numpy as np
import pytest

from levelflow.boxes import Box
from levelflow.equations import Eikonal, MeanCurvature
from levelflow.extraction import extract
from levelflow.fields import Field
from levelflow.rendering.quantities import Curvature, Residual, mesh_curvature
from levelflow.shapes.analytic import Sphere
from levelflow.shapes.mesh import Mesh
from tests.fields import Explicit

CUBE = Box((-1, -1, -1), (1, 1, 1))


def shrinking(rate: float) -> Field:
    """The field of a sphere under mean curvature: sqrt(x^2 + 4 rate t) - 1/2."""
    return Explicit(lambda x, t: ((x * x).sum(1) + 4 * rate * t[:, 0]).sqrt() - 0.5, 3, 1, box=CUBE.during((0.0, 0.5)))


def round_points(n: int, radius: float) -> np.ndarray:
    points = np.random.default_rng(0).normal(size=(n, 3))
    return radius * points / np.linalg.norm(points, axis=1, keepdims=True)


def test_the_curvature_of_a_sphere_is_two_over_its_radius() -> None:
    field = shrinking(0.1).at(0.0)
    for radius in (0.3, 0.5):
        assert np.allclose(Curvature(field).at(round_points(5000, radius)), 2 / radius)


def test_the_residual_of_an_exact_solution_is_zero_and_of_another_rate_is_known() -> None:
    field, points = shrinking(0.1), round_points(500, 0.4)
    assert np.allclose(Residual(field, MeanCurvature(0.1), (0.2,)).at(points), 0, atol=1e-12)
    # The speed is too small by 0.2 kappa.
    assert np.allclose(Residual(field, MeanCurvature(0.3), (0.2,)).at(points), 0.2 * 2 / 0.4)
    both = Residual(field, MeanCurvature(0.3) + Eikonal(), (0.2,)).at(points)
    slope = 0.4 / np.sqrt(0.4**2 + 4 * 0.1 * 0.2)
    assert np.allclose(both, np.hypot(0.2 * 2 / 0.4, 1 - slope))


def test_cotangent_curvature_of_a_sphere_and_nothing_at_a_border() -> None:
    mesh = extract(Sphere(0.5).distance, resolution=40, box=CUBE, refine=3)
    kappa = mesh_curvature(mesh)
    assert np.median(kappa) == pytest.approx(4, rel=0.01)
    half = Mesh(mesh.vertices, mesh.faces[mesh.vertices[mesh.faces].mean(1)[:, 2] < 0])
    assert np.median(mesh_curvature(half)[half.vertices[:, 2] < -0.1]) == pytest.approx(4, rel=0.01)
    assert np.isfinite(mesh_curvature(half)).all()
    with pytest.raises(ValueError, match="triangles are needed"):
        mesh_curvature(Mesh(np.eye(2), np.array([[0, 1]])))
