"""Cameras: what they frame, and where points land."""

import numpy as np
import pytest

from levelflow.boxes import Box
from levelflow.rendering.camera import Camera

BOX = Box((-1, -2, 0), (3, 1, 5))
CORNERS = np.array([[x, y, z] for x in (-1, 3) for y in (-2, 1) for z in (0, 5)], dtype=np.float64)


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize(("azimuth", "elevation"), [(0, 0), (30, 15), (150, -40), (-90, 80)])
def test_the_subject_fills_the_picture(azimuth: float, elevation: float, orthographic: bool) -> None:
    for subject in (BOX, CORNERS):
        camera = Camera.around(subject, azimuth, elevation, orthographic=orthographic)
        pixels = camera.project(CORNERS, height=100, width=100)[:, :2]
        assert pixels.min() >= 0
        assert pixels.max() <= 100
        assert np.ptp(pixels, axis=0).max() > 70


def test_directions_of_the_default_view() -> None:
    camera = Camera.around(Box((-1, -1, -1), (1, 1, 1)), 0, 0)
    assert np.allclose(camera.axes, np.eye(3))
    side = Camera.around(Box((-1, -1, -1), (1, 1, 1)), 90, 0)
    assert side.eye[0] > 1
    tall = Camera.around(Box((-1, -1, -1), (1, 1, 1)), 0, 0, up=(0, 0, 1))
    assert tall.eye[1] < -1
    assert np.allclose(tall.axes[1], [0, 0, 1])


def test_a_point_lands_where_similar_triangles_put_it() -> None:
    camera = Camera((0, 0, 10), field_of_view=float(np.degrees(2 * np.arctan(0.5))))
    column, row, nearness = camera.project(np.array([[1.0, 0.5, 2.0]]), height=100, width=200)[0]
    # At a depth of 8 the shorter side spans 8 units, so a unit is 12.5 pixels.
    assert (column, row) == pytest.approx((100 + 12.5, 50 - 6.25))
    assert camera.depth(np.array([nearness]))[0] == pytest.approx(8)
    behind = camera.project(np.array([[0.0, 0.0, 11.0]]), height=100, width=200)[0]
    assert behind[2] == -np.inf


@pytest.mark.parametrize("orthographic", [False, True])
def test_a_point_of_a_ray_lands_where_the_ray_starts_at_its_depth(orthographic: bool) -> None:
    camera = Camera.around(BOX, 40, 20, orthographic=orthographic)
    columns, rows, depth = np.array([0.5, 31.0, 59.9]), np.array([3.0, 20.0, 39.9]), np.array([2.0, 5.0, 9.0])
    origins, directions = camera.rays(columns, rows, height=40, width=60)
    there = camera.project(origins + depth[:, None] * directions, height=40, width=60)
    assert np.allclose(there[:, :2], np.stack([columns, rows], axis=1))
    assert np.allclose(camera.depth(there[:, 2]), depth)
    assert np.allclose(-directions @ camera.axes[2], 1)
    aside, _ = camera.rays(columns[:1] + 1, rows[:1], height=40, width=60)
    step = (
        np.linalg.norm(aside - origins[:1])
        if orthographic
        else np.linalg.norm(camera.rays(columns[:1] + 1, rows[:1], height=40, width=60)[1] - directions[:1])
    )
    assert step == pytest.approx(camera.footprint(height=40, width=60))


def test_the_plane_is_seen_from_the_front() -> None:
    camera = Camera.around(Box((0, 0), (2, 1)))
    pixels = camera.project(np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 1.0]]), height=108, width=108)
    assert np.allclose(pixels[:, :2], [[4, 79], [104, 79], [4, 29]])


def test_cameras_that_cannot_be() -> None:
    with pytest.raises(ValueError, match="is at the target"):
        Camera((1, 2, 3), (1, 2, 3))
    with pytest.raises(ValueError, match="points along the view"):
        Camera((0, 5, 0))
    with pytest.raises(ValueError, match="between 0 and 180"):
        Camera((0, 0, 5), field_of_view=180)
