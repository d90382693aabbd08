"""The Laplacian of a mesh: what it does to known functions, and what becomes of bad triangles."""

from __future__ import annotations

import numpy as np
import pytest

from levelflow.flows.laplacian import Laplacian, boundary
from levelflow.shapes import Mesh
from tests.flows.examples import DIRTY, arc, ball, icosphere, polygon, tube


def laplacian(mesh: Mesh) -> Laplacian:
    return Laplacian.of(mesh.vertices, mesh.faces)


def test_cotangents_of_equilateral_triangles() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0.75**0.5, 0]])
    found = Laplacian.of(vertices, np.array([[0, 1, 2]]))
    weight = 0.5 / 3**0.5
    assert np.allclose(found.stiffness.toarray(), weight * (3 * np.eye(3) - np.ones((3, 3))))
    assert np.allclose(found.mass, 3**0.5 / 12)


@pytest.mark.parametrize("mesh", [icosphere(2), ball(3, 16), tube(), polygon(9), arc()], ids=repr)
def test_constants_have_none_and_the_mass_is_the_area(mesh: Mesh) -> None:
    found = laplacian(mesh)
    assert np.abs(found.stiffness @ np.ones(len(mesh.vertices))).max() < 1e-9
    assert abs(found.stiffness - found.stiffness.T).max() < 1e-12
    # Delaunay triangles have the area of the mesh, since they are straight on it.
    assert found.mass.sum() == pytest.approx(mesh.area, rel=1e-6)


@pytest.mark.parametrize("space", [2, 3])
def test_on_a_ball_coordinates_are_eigenfunctions(space: int) -> None:
    mesh = polygon(100) if space == 2 else icosphere(3)
    found = laplacian(mesh)
    error = (found.stiffness @ mesh.vertices) / found.mass[:, None] - (space - 1) * mesh.vertices
    assert np.abs(error).max() < 0.02


def test_the_length_of_an_edge_is_its_unit() -> None:
    small, large = laplacian(ball(3, 12)), laplacian(Mesh(1e9 * ball(3, 12).vertices, ball(3, 12).faces))
    assert abs(small.stiffness - large.stiffness).max() < 1e-6
    assert np.allclose(large.mass, 1e18 * small.mass)
    curve, longer = laplacian(polygon(9)), laplacian(polygon(9, radius=1e-9))
    assert np.allclose(curve.stiffness.toarray(), 1e-9 * longer.stiffness.toarray())
    assert np.allclose(curve.mass, 1e9 * longer.mass)


def test_inside_a_surface_no_weight_is_negative() -> None:
    """Two triangles with the long diagonal of a rhombus, whose cotangent is negative, get the short one."""
    vertices = np.array([[-2.0, 0, 0], [0, -0.5, 0], [2, 0, 0], [0, 0.5, 0]])
    weights = -Laplacian.of(vertices, np.array([[0, 1, 2], [0, 2, 3]])).stiffness.toarray()
    assert weights[0, 2] == 0
    assert weights[1, 3] > 0
    sphere = -laplacian(ball(3, 24)).stiffness
    sphere.setdiag(0)
    assert sphere.min() > -1e-9


def test_screened_solves_and_holds() -> None:
    mesh = tube()
    found, ends = laplacian(mesh), boundary(mesh.faces, len(mesh.vertices))
    load = np.random.default_rng(0).normal(size=mesh.vertices.shape)
    solution = found.screened(0.3, held=ends)(load)
    matrix = np.diag(found.mass) + 0.3 * found.stiffness.toarray()
    assert np.allclose((matrix @ solution)[~ends], load[~ends])
    assert not solution[ends].any()
    assert not found.screened(0.3, held=np.ones_like(ends))(load).any()


def test_boundaries() -> None:
    mesh = tube(along=5)
    assert np.array_equal(boundary(mesh.faces, len(mesh.vertices)), np.abs(mesh.vertices[:, 2]) == 1)
    assert np.flatnonzero(boundary(arc(9).faces, 9)).tolist() == [0, 8]
    assert not boundary(ball(3, 12).faces, len(ball(3, 12).vertices)).any()


@pytest.mark.parametrize("name", DIRTY)
def test_it_is_finite_and_semi_definite_on_any_mesh(name: str) -> None:
    mesh = DIRTY[name]
    found = laplacian(mesh)
    assert np.isfinite(found.stiffness.data).all() and np.isfinite(found.mass).all() and (found.mass >= 0).all()
    x = np.random.default_rng(0).normal(size=(len(mesh.vertices), 5))
    assert ((x * (found.stiffness @ x)).sum(0) >= -1e-9).all()
    solution = found.screened(1e-3, held=np.zeros(len(x), dtype=bool))(x)
    assert np.isfinite(solution).all()
    assert not solution[found.mass == 0].any()
