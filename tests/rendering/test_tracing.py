"""Sphere tracing against exact intersections of rays with spheres, planes and tori, and against the rasteriser."""

import numpy as np
import pytest
import torch

from levelflow.boxes import Box
from levelflow.extraction import extract
from levelflow.fields import Field
from levelflow.rendering.camera import Camera
from levelflow.rendering.rasterising import rasterise
from levelflow.rendering.tracing import sphere_trace
from tests.fields import Explicit, placed, siren

CUBE = Box((-1, -1, -1), (1, 1, 1))
SIZE = 100


def ball(radius: float = 0.6, *, box: Box = CUBE) -> Field:
    return Explicit(lambda x, t: torch.linalg.vector_norm(x, dim=1) - radius, 3, box=box)


def steep_ball(radius: float = 0.6) -> Field:
    """No distance: slope 0.1 to 20 along a ray, and flat far away."""
    return Explicit(lambda x, t: torch.tanh(10 * ((x * x).sum(1) - radius**2)) * (1.5 + x[:, 0]), 3, box=CUBE)


def ring(major: float = 0.6, minor: float = 0.25) -> Field:
    def distance(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        return torch.hypot(torch.linalg.vector_norm(x[:, :2], dim=1) - major, x[:, 2]) - minor

    return Explicit(distance, 3, box=CUBE)


def exact_depth(camera: Camera, radius: float, height: int, width: int) -> np.ndarray:
    """The depth of the nearer point of a sphere about the origin in each pixel, infinite beside it."""
    rows, columns = (index.reshape(-1) + 0.5 for index in np.indices((height, width)))
    o, v = camera.rays(columns, rows, height=height, width=width)
    a, b, c = (v * v).sum(1), (o * v).sum(1), (o * o).sum(1) - radius**2
    root = b * b - a * c
    return np.where(root > 0, (-b - np.sqrt(root.clip(min=0))) / a, np.inf)


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("field", [ball(), steep_ball()], ids=["distance", "steep and flat"])
def test_a_sphere_is_met_where_the_quadratic_equation_says(field: Field, orthographic: bool) -> None:
    camera = Camera.around(CUBE, 40, 25, orthographic=orthographic)
    hits = sphere_trace(field, camera, height=SIZE, width=120)
    exact = exact_depth(camera, 0.6, SIZE, 120)
    assert np.array_equal(hits.pixels, np.flatnonzero(np.isfinite(exact)))
    pixel = camera.footprint(height=SIZE, width=120) * (1 if orthographic else hits.depth)
    # Where the ray grazes, the depth is as uncertain as the square root of the value.
    assert np.median(np.abs(hits.depth - exact[hits.pixels]) / pixel) < 1e-4
    assert np.quantile(np.abs(hits.depth - exact[hits.pixels]) / pixel, 0.98) < 0.02
    assert np.abs(np.linalg.norm(hits.points, axis=1) - 0.6).max() < 1e-2 * np.max(pixel)
    assert np.allclose(hits.normals, hits.points / 0.6, atol=1e-3)
    assert not hits.behind.any()
    assert np.allclose(np.linalg.norm(hits.towards, axis=1), 1)
    there = camera.project(hits.points, height=SIZE, width=120)
    assert np.allclose(camera.depth(there[:, 2]), hits.depth)


def test_a_torus_is_seen_as_the_rasteriser_sees_its_mesh() -> None:
    camera = Camera.around(CUBE, 30, 50)
    hits = sphere_trace(ring(), camera, height=256, width=256)
    mesh = extract(ring(), resolution=160, refine=3)
    raster = rasterise(mesh, camera, height=256, width=256)
    assert (hits.mask != raster.mask).mean() < 1e-3
    _, ours, others = np.intersect1d(hits.pixels, raster.pixels, return_indices=True)
    gap = np.abs(hits.depth[ours] - raster.depth[others]) / (camera.footprint(height=256, width=256) * 5)
    assert np.quantile(gap, 0.99) < 0.2
    q = np.linalg.norm(hits.points[:, :2], axis=1)
    assert np.abs(np.hypot(q - 0.6, hits.points[:, 2]) - 0.25).max() < 1e-4


def test_a_network_is_seen_as_the_rasteriser_sees_its_mesh() -> None:
    field = placed(3)
    field.field.last.bias.data -= field.field(torch.zeros(1, 3, dtype=torch.float64)).detach()
    camera = Camera.around(field.box, 20, 10)
    with pytest.warns(UserWarning, match="open there"):
        mesh = extract(field, resolution=128, refine=3)
    hits = sphere_trace(field, camera, height=128, width=128)
    raster = rasterise(mesh, camera, height=128, width=128)
    assert (hits.mask != raster.mask).mean() < 0.01
    assert field(torch.from_numpy(hits.points)).abs().max() < 1e-3


def test_a_thin_piece_far_before_a_wide_one_is_not_passed_over() -> None:
    def wire_and_wall(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        wire = torch.hypot(x[:, 0] - 0.013, x[:, 2] - 0.8) - 0.012
        return torch.minimum(wire, x[:, 2] + 0.5)

    camera = Camera.around(CUBE, 0, 0, orthographic=True)
    hits = sphere_trace(Explicit(wire_and_wall, 3, box=CUBE), camera, height=200, width=200, lipschitz=1.0)
    depth = hits.place(hits.depth, background=0.0)[20:180]
    eye = camera.eye[2]
    assert (np.isclose(depth, eye - 0.8, atol=0.02).sum(1) >= 2).all()
    assert (np.isclose(depth, eye + 0.5).sum(1) > 150).all()


def test_the_inside_is_seen_where_the_surface_leaves_the_box_and_from_within() -> None:
    half = Box((-1, -1, -1), (1, 1, 0))
    camera = Camera((0, 0, 5))
    bowl = sphere_trace(ball(box=half), camera, height=64, width=64)
    middle = bowl.pixels == 32 * 64 + 32
    assert bowl.behind[middle].all()
    assert bowl.points[middle][0, 2] == pytest.approx(-0.6, abs=1e-3)
    within = sphere_trace(ball(), Camera((0, 0, 0), (0, 0, -1)), height=32, width=32)
    assert within.mask.all()
    assert within.behind.all()
    assert np.allclose(np.linalg.norm(within.points, axis=1), 0.6, atol=1e-4)
    away = sphere_trace(ball(), Camera((0, 0, 5), (0, 0, 10)), height=16, width=16)
    assert not len(away.pixels)


def test_samples_at_edges_bring_the_area_of_a_disc_closer() -> None:
    camera = Camera((0, 0, 5), orthographic=True)
    exact = np.pi * (0.6 / camera.footprint(height=50, width=50)) ** 2
    covered = [sphere_trace(ball(), camera, height=50, width=50, samples=n).coverage for n in (1, 4)]
    assert set(np.unique(covered[0])) == {0.0, 1.0}
    assert covered[1].max() == 1.0
    assert abs(covered[1].sum() - exact) < 0.002 * exact
    assert ((covered[1] > 0) & (covered[1] < 1)).sum() > 30


def test_values_are_placed_by_their_weights() -> None:
    hits = sphere_trace(ball(), Camera((0, 0, 5)), height=40, width=40, samples=2)
    picture = hits.place(np.full((len(hits.pixels), 3), 2.0), background=np.array([0.0, 1.0, 2.0]))
    assert np.allclose(picture[..., 0], 2 * hits.coverage)
    assert np.allclose(picture[..., 1], 1 + hits.coverage)
    assert np.allclose(picture[..., 2], 2)
    mean = hits.mean(np.full(len(hits.pixels), 3.0))
    assert np.allclose(mean[hits.mask], 3)
    assert not mean[~hits.mask].any()


@pytest.mark.filterwarnings("error")
def test_what_cannot_be_traced() -> None:
    camera = Camera((0, 0, 5))
    with pytest.raises(ValueError, match="at least one pixel"):
        sphere_trace(ball(), camera, height=0, width=8)
    with pytest.raises(ValueError, match="Take a slice"):
        sphere_trace(siren(3, 1), camera, height=8, width=8)
    with pytest.raises(ValueError, match="say where to look"):
        sphere_trace(siren(3), camera, height=8, width=8)
    with pytest.raises(ValueError, match="bounded by 0"):
        sphere_trace(Explicit(lambda x, t: 1 + 0 * x[:, 0], 3, box=CUBE), camera, height=8, width=8)
    with pytest.raises(ValueError, match="not finite at"):
        sphere_trace(Explicit(lambda x, t: x[:, 0].sqrt() + 2, 3, box=CUBE), camera, height=8, width=8, lipschitz=1.0)
