"""The rasteriser against exact projections, depths and areas."""

import numpy as np
import pytest

from levelflow.boxes import Box
from levelflow.extraction import extract
from levelflow.rendering.camera import Camera
from levelflow.rendering.rasterising import rasterise
from levelflow.shapes.analytic import Sphere
from levelflow.shapes.mesh import Mesh

UNIT = Box((-1, -1, -1), (1, 1, 1))


def grid(corners: np.ndarray, n: int) -> Mesh:
    """A planar quadrilateral as 2 n^2 triangles."""
    u, v = (axis.reshape(-1, 1) for axis in np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1)))
    a, b, c, d = corners
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).reshape(-1)
    faces = np.concatenate([np.stack([i, i + 1, i + n + 2], 1), np.stack([i, i + n + 2, i + n + 1], 1)])
    return Mesh((1 - u) * (1 - v) * a + u * (1 - v) * b + u * v * c + (1 - u) * v * d, faces)


SLOPE = np.array([[-1, -1, 0.5], [1, -1, 0], [1, 1, 0.5], [-1, 1, 1]], dtype=np.float64)


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("n", [1, 7, 200])
def test_depth_of_a_plane_is_exact_for_triangles_of_any_size(n: int, orthographic: bool) -> None:
    camera = Camera((0.3, 0.2, 6), orthographic=orthographic)
    mesh, size = grid(SLOPE, n), 101
    raster = rasterise(mesh, camera, height=size, width=size)
    points = np.einsum("pi,pic->pc", raster.barycentric, mesh.vertices[mesh.faces[raster.faces]])
    # The points seen lie on the plane z = (2 - x + y) / 4 and project to the pixels' centres.
    assert np.allclose(points[:, 2], 0.5 - points[:, 0] / 4 + points[:, 1] / 4, atol=1e-9)
    there = camera.project(points, height=size, width=size)
    assert np.allclose(there[:, 0], raster.pixels % size + 0.5, atol=1e-6)
    assert np.allclose(there[:, 1], raster.pixels // size + 0.5, atol=1e-6)
    assert np.allclose(camera.depth(there[:, 2]), raster.depth, rtol=1e-9)
    assert np.allclose(raster.barycentric.sum(1), 1)
    assert raster.barycentric.min() > -1e-6


def test_fine_and_coarse_triangles_cover_the_same_pixels() -> None:
    camera = Camera((0.3, 0.2, 6))
    coarse, fine = (rasterise(grid(SLOPE, n), camera, height=160, width=120) for n in (1, 300))
    assert np.array_equal(coarse.mask, fine.mask)
    assert coarse.mask.shape == (160, 120)
    assert np.allclose(coarse.depth, fine.depth)


def test_the_disc_of_a_sphere_has_the_exact_area() -> None:
    mesh = extract(Sphere(0.7).distance, resolution=64, box=UNIT, refine=3)
    size = 256
    flat = Camera((0, 0, 5), orthographic=True)
    unit = size / 2 / (5 * np.tan(np.radians(12.5)))
    covered = rasterise(mesh, flat, height=size, width=size).mask.sum()
    assert covered == pytest.approx(np.pi * (0.7 * unit) ** 2, rel=3e-3)
    # In perspective the silhouette is seen under the angle asin(r / distance).
    radius = np.tan(np.arcsin(0.7 / 5)) * 5 * unit
    assert rasterise(mesh, Camera((0, 0, 5)), height=size, width=size).mask.sum() == pytest.approx(
        np.pi * radius**2, rel=3e-3
    )


def test_the_nearer_of_two_surfaces_is_seen_and_interpolated() -> None:
    near, far = grid(SLOPE * [0.5, 0.5, 0] + [0, 0, 1], 2), grid(SLOPE * [1, 1, 0], 3)
    for first, second in ((near, far), (far, near)):
        both = Mesh(
            np.concatenate([first.vertices, second.vertices]),
            np.concatenate([first.faces, second.faces + len(first.vertices)]),
        )
        raster = rasterise(both, Camera((0, 0, 8), orthographic=True), height=64, width=64)
        depth = raster.place(raster.depth, background=np.inf)
        assert depth[32, 32] == pytest.approx(7)
        assert set(np.round(depth[np.isfinite(depth)], 9)) == {7.0, 8.0}
        heights = raster.interpolate(both.vertices[both.faces][..., 2:])
        assert np.allclose(heights[:, 0], 8 - raster.depth)


def test_no_holes_and_nothing_behind_the_eye() -> None:
    mesh = extract(Sphere(0.7).distance, resolution=100, box=UNIT)
    mask = rasterise(mesh, Camera.around(mesh.box), height=90, width=90).mask
    for row in mask[mask.any(1)]:
        assert row[np.flatnonzero(row)[0] : np.flatnonzero(row)[-1] + 1].all()
    inside = rasterise(mesh, Camera((0, 0, 0), (0, 0, -1)), height=16, width=16)
    assert inside.mask.all()
    assert inside.depth.max() < 0.71
    assert not len(rasterise(mesh, Camera((0, 0, 5), (0, 0, 10)), height=16, width=16).pixels)


def test_segments_are_not_rasterised() -> None:
    with pytest.raises(ValueError, match="triangles are needed"):
        rasterise(Mesh(np.eye(2), np.array([[0, 1]])), Camera((0, 0, 5)), height=8, width=8)
