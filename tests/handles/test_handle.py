"""Handles: the paths of their regions, the vertices they hold, and what is said of bad ones."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest

from levelflow.boxes import Box
from levelflow.handles import BoxRegion, Handle, HandleWarning, PointsRegion, SphereRegion, selected
from tests.shapes.test_distance import globe

CUBE = BoxRegion(Box((0, 0, 0), (2, 2, 2)))
SQUARE = BoxRegion(Box((0, 0), (2, 2)))
BALL = globe(20)
NORTH = SphereRegion((0, 0, 1), 0.5)
SOUTH = SphereRegion((0, 0, -1), 0.5)


@pytest.mark.parametrize(
    ("handle", "point", "half", "whole"),
    [
        (Handle.fix(CUBE), (3, 1, 1), (3, 1, 1), (3, 1, 1)),
        (Handle.move(CUBE, by=(0, 2, 0)), (3, 1, 1), (3, 2, 1), (3, 3, 1)),
        (Handle.rotate(CUBE, angle=180, axis=(0, 0, 5)), (3, 1, 1), (1, 3, 1), (-1, 1, 1)),
        (Handle.rotate(CUBE, angle=-360, axis=(0, 0, 1)), (3, 1, 1), (-1, 1, 1), (3, 1, 1)),
        (Handle.rotate(CUBE, angle=180, axis=(1, 0, 0), center=(0, 0, 0)), (3, 1, 0), (3, 0, 1), (3, -1, 0)),
        (Handle(CUBE, scale=4.0, by=(0, 0, 2)), (2, 1, 1), (3, 1, 2), (5, 1, 3)),
        (Handle.rotate(SQUARE, angle=180), (2, 1), (1, 2), (0, 1)),
        (Handle(SQUARE, angle=180, by=(4, 0), scale=4), (2, 1), (3, 3), (1, 1)),
    ],
)
def test_points_go_along_the_path(handle: Handle, point: tuple, half: tuple, whole: tuple) -> None:
    x = np.array([point], dtype=float)
    for part, place in ((0.0, point), (0.5, half), (1.0, whole)):
        assert handle.target(x, part) == pytest.approx(np.array([place]), abs=1e-14)


def test_the_origin_is_the_inverse_of_the_target() -> None:
    x = np.random.default_rng(0).normal(size=(50, 3))
    handle = Handle(CUBE, by=(1, 2, 3), angle=77, axis=(1, -2, 0.5), scale=0.3, center=(5, 0, 0))
    for part in (0.0, 0.3, 1.0):
        assert np.abs(handle.origin(handle.target(x, part), part) - x).max() < 1e-13
    # Half of the way twice is the whole of it only for a motion about its own centre, such as this.
    turn = Handle.rotate(CUBE, angle=50, axis=(1, 1, 1))
    assert np.abs(turn.target(turn.target(x, 0.5), 0.5) - turn.target(x, 1.0)).max() < 1e-13


def test_vertices_are_those_in_the_region() -> None:
    north, south = selected([Handle.fix(NORTH), Handle.move(SOUTH, by=(0, 0, 1))], BALL.vertices)
    away = np.linalg.norm(BALL.vertices - [0, 0, 1], axis=1)
    assert north.tolist() == np.flatnonzero(away <= 0.5).tolist()
    assert south.tolist() == np.flatnonzero(np.linalg.norm(BALL.vertices + [0, 0, 1], axis=1) <= 0.5).tolist()
    points = PointsRegion(np.array([[0.0, 0, 1.2], [0, 0, -1]]), 0.45)
    with pytest.warns(HandleWarning, match="nothing moves"):
        (both,) = selected([Handle.fix(points)], BALL.vertices)
    assert set(both) > {len(BALL.vertices) - 2, len(BALL.vertices) - 1}


def test_handles_that_agree_may_overlap_and_each_vertex_has_one() -> None:
    wide = SphereRegion((0, 0, 1), 0.8)
    turned = Handle.rotate(wide, angle=90, axis=(0, 0, 2), center=(0, 0, 7))
    same = Handle.rotate(NORTH, angle=90, axis=(0, 0, 1))
    low = Handle.fix(SOUTH)
    first, second, _ = selected([same, turned, low], BALL.vertices)
    assert len(first) and len(second)
    assert not set(first) & set(second)
    first, second, _ = selected([turned, same, low], BALL.vertices)
    assert len(first) and not len(second)


def test_handles_that_contradict_each_other_are_named() -> None:
    wide = Handle.fix(SphereRegion((0, 0, 1), 0.8), name="crown")
    shared = int((np.linalg.norm(BALL.vertices - [0, 0, 1], axis=1) <= 0.5).sum())
    message = rf"handle 1 \('crown'\) and handle 2 both hold {shared} vertices, such as .* in different places"
    with pytest.raises(ValueError, match=message):
        selected([wide, Handle.move(NORTH, by=(0, 0, 0.1))], BALL.vertices)
    # A full turn ends where it starts, and yet it is not the same as no turn; two turns differ from one.
    for angle in (360, 720):
        with pytest.raises(ValueError, match="in different places"):
            selected([wide, Handle.rotate(NORTH, angle=angle, axis=(1, 0, 0))], BALL.vertices)


def test_a_region_without_any_of_the_surface_is_told_how_far_it_is() -> None:
    away = Handle.fix(SphereRegion((0, 0, 3), 0.5), name="hat")
    message = (
        r"Edit: the region of handle 2 \('hat'\) holds no vertex of the surface; the nearest one, at \(0, 0, 1\), is "
        r"1.5 away. .* the surface lies between \(-1, -1, -1\) and \(1, 1, 1\)"
    )
    with pytest.raises(ValueError, match=message):
        selected([Handle.fix(NORTH), away], BALL.vertices, call="Edit")


def test_no_handles_and_handles_of_another_space_are_refused() -> None:
    with pytest.raises(ValueError, match="selected: there are no handles; give at least one that moves"):
        selected([], BALL.vertices)
    with pytest.raises(ValueError, match=r"handle 1 has a region in R\^2, and the surface lies in R\^3"):
        selected([Handle.fix(SQUARE)], BALL.vertices)


def test_handles_that_change_no_form_are_warned_of() -> None:
    with pytest.warns(HandleWarning, match="all handles are frozen, so nothing moves; add one that does"):
        selected([Handle.fix(NORTH), Handle.fix(SOUTH)], BALL.vertices)
    with pytest.warns(HandleWarning, match="the same motion, so the whole surface goes along; freeze some of it"):
        selected([Handle.move(NORTH, by=(1, 0, 0)), Handle.move(SOUTH, by=(1, 0, 0))], BALL.vertices)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        selected([Handle.fix(NORTH), Handle.move(SOUTH, by=(1, 0, 0))], BALL.vertices)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"by": (1, 2)}, r"`Handle\(by=\(1.0, 2.0\)\)`: the region lies in R\^3; give 3 finite numbers"),
        ({"by": (1, 2, math.nan)}, "give 3 finite numbers"),
        ({"center": (0, 0, math.inf)}, r"`Handle\(center=.*give 3 finite numbers"),
        (
            {"angle": math.nan, "axis": (1, 0, 0)},
            r"`Handle\(angle=nan\)`: the angle must be a finite number",
        ),
        ({"scale": 0}, r"`Handle\(scale=0\)`: the scale must be a positive number; 1 changes nothing"),
        ({"scale": math.inf}, "the scale must be a positive number"),
        ({"angle": 90, "axis": (0, 0, 0)}, "the axis has no direction"),
        ({"angle": 90}, r"`Handle\(angle=90, axis=\(\)\)`: in space an angle in degrees and an axis, .* come together"),
        ({"axis": (0, 0, 1)}, "come together"),
    ],
)
def test_motions_that_cannot_be_are_refused(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Handle(CUBE, **arguments)


def test_the_plane_has_no_axis() -> None:
    with pytest.raises(ValueError, match="in the plane all turns about a point; leave it out"):
        Handle(SQUARE, angle=90, axis=(0, 1))
