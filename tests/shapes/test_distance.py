"""Distances to triangles and segments, against formulas."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from levelflow.shapes import Cuboid, Mesh, MeshWarning, Polygon, Rectangle, Sphere
from levelflow.shapes.distance import TriangleDistance

CUBE_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2
CUBE_QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
CUBE_FACES = np.concatenate([CUBE_QUADS[:, [0, 1, 2]], CUBE_QUADS[:, [0, 2, 3]]])


def cube(sides: tuple[float, ...] = (1, 1, 1), at: tuple[float, ...] = (0, 0, 0)) -> Mesh:
    return Mesh(CUBE_CORNERS * sides + at, CUBE_FACES)


def globe(rings: int) -> Mesh:
    """The unit sphere, cut along latitudes and longitudes."""
    polar, around = np.linspace(0, np.pi, rings + 1)[1:-1], np.linspace(0, 2 * np.pi, 2 * rings, endpoint=False)
    p, a = (grid.reshape(-1) for grid in np.meshgrid(polar, around, indexing="ij"))
    points = np.stack([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)], 1)
    n = 2 * rings
    i, j = (grid.reshape(-1) for grid in np.meshgrid(np.arange(rings - 2), np.arange(n), indexing="ij"))
    k = (j + 1) % n
    quads = np.stack([i * n + j, (i + 1) * n + j, (i + 1) * n + k, i * n + k], 1)
    j, k = np.arange(n), (np.arange(n) + 1) % n
    north, south, last = np.full(n, len(points)), np.full(n, len(points) + 1), (rings - 2) * n
    caps = np.concatenate([np.stack([north, j, k], 1), np.stack([south, last + k, last + j], 1)])
    return Mesh(
        np.concatenate([points, [[0, 0, 1], [0, 0, -1]]]), np.concatenate([quads[:, :3], quads[:, [0, 2, 3]], caps])
    )


def tube(n: int = 64) -> Mesh:
    """A cylinder of radius 1 and height 2 around z, open at both ends."""
    a = np.linspace(0, 2 * np.pi, n, endpoint=False)
    ring = np.stack([np.cos(a), np.sin(a)], 1)
    points = np.concatenate([np.insert(ring, 2, -1, axis=1), np.insert(ring, 2, 1, axis=1)])
    j, k = np.arange(n), (np.arange(n) + 1) % n
    return Mesh(points, np.concatenate([np.stack([j, k, n + k], 1), np.stack([j, n + k, n + j], 1)]), name="tube")


def points_around(mesh: Mesh, n: int = 2000, seed: int = 0) -> torch.Tensor:
    return mesh.box.expanded(0.5).uniform(n, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("offset", [0.0, 1e5])
def test_a_cube_has_the_distance_of_the_solid_box(offset: float) -> None:
    mesh = cube((1, 2, 0.5), (offset, 0, 0))
    x = points_around(mesh)
    exact = Cuboid((1, 2, 0.5)).distance(x - torch.tensor([offset, 0, 0], dtype=x.dtype))
    assert (mesh.distance(x) - exact).abs().max() < (1e-12 if not offset else 1e-10)


def test_a_square_has_the_distance_of_the_rectangle() -> None:
    corners = np.array([[-1, -0.5], [1, -0.5], [1, 0.5], [-1, 0.5]])
    mesh = Mesh(corners, np.array([[0, 1], [1, 2], [2, 3], [3, 0]]))
    x = points_around(mesh)
    assert (mesh.distance(x) - Rectangle((2, 1)).distance(x)).abs().max() < 1e-12


def test_a_curve_has_the_distance_of_the_polygon_in_pieces_too(monkeypatch: pytest.MonkeyPatch) -> None:
    corners = ((0, 0), (2, 0), (2, 1), (1, 0.3), (0, 1))
    mesh = Mesh(np.array(corners), np.array([[0, 1], [1, 2], [2, 3], [3, 4], [4, 0]]))
    monkeypatch.setattr(
        TriangleDistance, "_chunks", lambda self, n: [slice(i, i + 7) for i in range(0, n, 7)], raising=True
    )
    x = points_around(mesh, 100)
    assert (mesh.distance(x) - Polygon(corners).distance(x)).abs().max() < 1e-12


def test_a_fine_globe_converges_to_the_sphere_in_second_order() -> None:
    errors = []
    for rings in (16, 32, 64):
        mesh = globe(rings)
        assert mesh.is_watertight
        x = points_around(mesh)
        errors.append((mesh.distance(x) - Sphere(1).distance(x)).abs().max().item())
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] < 1.3e-3
    assert (np.abs(order - 2) < 0.1).all()


def test_the_winding_number_of_an_open_tube_is_the_solid_angle_it_fills() -> None:
    mesh = tube(512)
    z = np.linspace(-3, 3, 25)
    on_axis = np.stack([0 * z, 0 * z, z], 1)
    # The two discs that are missing are seen under the solid angles 2 pi (1 - cos).
    discs = [np.sign(end - z) * (1 - np.abs(end - z) / np.hypot(1, end - z)) / 2 for end in (1, -1)]
    expected = (np.abs(z) <= 1) * 1.0 - discs[0] + discs[1]
    off_the_ends = np.abs(np.abs(z) - 1) > 1e-9
    winding = TriangleDistance(mesh.vertices, mesh.faces).winding(on_axis)
    assert np.abs(winding - expected)[off_the_ends].max() < 0.01


def test_the_magnitude_of_the_distance_to_an_open_mesh_is_exact() -> None:
    mesh = tube(256)
    x = points_around(mesh)
    across, along = x[:, :2].norm(dim=1) - 1, (x[:, 2].abs() - 1).clamp(min=0)
    with pytest.warns(MeshWarning):
        distance = mesh.distance(x)
    assert (distance.abs() - torch.hypot(across, along)).abs().max() < 1e-4
    middle = x[:, 2].abs() < 0.3
    assert (distance[middle] < 0).equal(across[middle] < 0)


def test_closest_points_faces_and_signs() -> None:
    search = TriangleDistance(CUBE_CORNERS, CUBE_FACES)
    x = np.array([[2.0, 0.1, 0.2], [0.4, 0.1, 0.2]])
    distance, face, point = search.closest(x)
    assert np.allclose(distance, [1.5, 0.1], atol=1e-14)
    assert np.allclose(point, [[0.5, 0.1, 0.2], [0.5, 0.1, 0.2]], atol=1e-14)
    assert (CUBE_CORNERS[CUBE_FACES[face]][:, :, 0] == 0.5).all()
    assert np.allclose(search(x), [1.5, -0.1], atol=1e-14)


@pytest.mark.parametrize("d", [2, 3])
def test_points_that_are_not_finite_have_no_distance(d: int) -> None:
    mesh = cube() if d == 3 else Mesh(np.array([[0, 0], [1, 0], [0, 1]]), np.array([[0, 1], [1, 2], [2, 0]]))
    x = torch.full((3, d), 2.0)
    x[0, 0], x[1, 1] = torch.nan, torch.inf
    assert mesh.distance(x).isnan().tolist() == [True, True, False]
    assert mesh.distance(x[:0]).shape == (0,)


def test_the_distance_follows_dtype_and_can_be_differentiated() -> None:
    mesh = globe(32)
    x = points_around(mesh, 300).float().requires_grad_()
    distance = mesh.distance(x)
    assert distance.dtype == torch.float32
    assert torch.equal(distance.detach(), mesh.distance(x.detach()))
    (gradient,) = torch.autograd.grad(distance.sum(), x)
    assert torch.allclose(gradient.norm(dim=1), torch.ones(300), atol=1e-6)
    outward = (gradient * x).sum(1) / x.norm(dim=1)
    assert outward[x.norm(dim=1) > 0.5].min() > 0.95


def test_on_the_surface_the_gradient_is_the_normal() -> None:
    mesh = cube()
    points, normals = mesh.sample(500, generator=torch.Generator().manual_seed(0))
    points.requires_grad_()
    (gradient,) = torch.autograd.grad(mesh.distance(points).sum(), points)
    assert torch.allclose(gradient, normals, atol=1e-12)


def test_x_of_another_dimension_is_refused() -> None:
    with pytest.raises(ValueError, match=r"x of the shape \(5, 2\); wanted is \(n, 3\)"):
        cube().distance(torch.zeros(5, 2))
