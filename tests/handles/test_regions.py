"""Regions: how far points are from them, and paint carried from one mesh to another."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from levelflow.boxes import Box
from levelflow.handles import BoxRegion, PaintedRegion, PointsRegion, Region, SphereRegion
from tests.shapes.test_distance import globe

SQUARE = BoxRegion(Box((0, 0), (2, 1)))
DISC = SphereRegion((1, 0), 0.5)
TWO = PointsRegion(np.array([[0.0, 0], [4, 0]]), 1.0)
HALF = PaintedRegion([[0.0, 0], [1, 0], [2, 0], [3, 0]], [False, False, True, True], reach=2.0)


@pytest.mark.parametrize(
    ("region", "point", "distance"),
    [
        (SQUARE, (2, 1), 0),
        (SQUARE, (0.3, 0.2), 0),
        (SQUARE, (5, 5), 5),
        (SQUARE, (1, -2), 2),
        (DISC, (1.5, 0), 0),
        (DISC, (1, 2), 1.5),
        (TWO, (4, 1), 0),
        (TWO, (2, 0), 1),
        (HALF, (1.6, 0), 0),
        (HALF, (3, 2), 0),
        (HALF, (1.4, 0), 0.6),
        (HALF, (3, 2.1), 2.1),
    ],
)
def test_distances_are_zero_in_the_region_and_exact_outside(region: Region, point: tuple, distance: float) -> None:
    assert region.distance(np.array([point], dtype=float)) == pytest.approx([distance], abs=1e-12)


def test_the_middle_of_a_region() -> None:
    assert (SQUARE.pivot, DISC.pivot, TWO.pivot, HALF.pivot) == ((1, 0.5), (1, 0), (2, 0), (2.5, 0))


def test_paint_reaches_a_tenth_of_the_size_unless_told_otherwise() -> None:
    region = PaintedRegion([[0.0, 0, 0], [3, 0, 0], [0, 7, 0]], np.array([True, False, False]))
    assert repr(region) == "PaintedRegion(1 of 3 vertices, reach=0.7)"
    assert region.distance(np.array([[0, 0, 0.69], [0, 0, 0.71]])) == pytest.approx([0, 0.71])


def ply(path: Path, names: str, rows: list[tuple]) -> Path:
    kinds = {"x": "float", "y": "float", "z": "float", "quality": "float"}
    head = "".join(f"property {kinds.get(name, 'uchar')} {name}\n" for name in names.split())
    body = "\n".join(" ".join(map(str, row)) for row in rows)
    path.write_text(f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\n{head}end_header\n{body}\n")
    return path


def test_paint_is_read_from_a_property_and_carried_to_another_mesh(tmp_path: Path) -> None:
    coarse, fine = globe(24).vertices, globe(60).vertices
    rows = [(x, y, z, 255 * (z > 0.3), 0, 0, z) for x, y, z in coarse.tolist()]
    file = ply(tmp_path / "ball.ply", "x y z red green blue quality", rows)
    for region in (PaintedRegion.read(file, "red", above=127), PaintedRegion.read(file, "quality", above=0.3)):
        held = region.distance(fine) == 0
        assert held[fine[:, 2] > 0.4].all()
        assert not held[fine[:, 2] < 0.2].any()


def test_paint_of_a_curve(tmp_path: Path) -> None:
    edges = "element edge 1\nproperty int vertex1\nproperty int vertex2\n"
    file = ply(tmp_path / "curve.ply", "x y z quality", [(0, 0, 0, 1.0), (4, 0, 0, 0.0)])
    region = PaintedRegion.read(file, "quality")
    assert region.pivot == (0, 0, 0)
    text = file.read_text().replace("end_header", edges + "end_header")
    file.write_text(text + "0 1\n")
    assert PaintedRegion.read(file, "quality").pivot == (0, 0)


def test_regions_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match=r"`SphereRegion\(center=\(0.0, nan\)\)`: the centre must be finite"):
        SphereRegion((0, math.nan), 1.0)
    for radius in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match=r"`SphereRegion\(radius=.*\)`: the radius must be a positive length"):
            SphereRegion((0, 0), radius)
    with pytest.raises(ValueError, match="`PointsRegion.*the radius must be a positive length"):
        PointsRegion(np.zeros((1, 3)), 0.0)
    with pytest.raises(ValueError, match=r"the points have the shape \(0, 3\); give at least one"):
        PointsRegion(np.empty((0, 3)), 1.0)
    with pytest.raises(ValueError, match=r"point 2 is \(0.0, nan\), not finite"):
        PointsRegion(np.array([[0.0, 0], [0, math.nan]]), 1.0)


def test_paint_that_cannot_be_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"vertices of the shape \(2, 3\) and paint of the shape \(3,\) and type bool"):
        PaintedRegion(np.zeros((2, 3)), np.ones(3, dtype=bool))
    with pytest.raises(ValueError, match="type float64; give vertices .* one bool for each, such as `values > 0.5`"):
        PaintedRegion(np.zeros((2, 3)), np.ones(2))
    with pytest.raises(ValueError, match="1 vertices are not finite"):
        PaintedRegion([[0.0, math.nan], [0, 0]], [True, True])
    with pytest.raises(ValueError, match="none of the 2 vertices is painted"):
        PaintedRegion(np.eye(2), [False, False])
    with pytest.raises(ValueError, match=r"`PaintedRegion\(reach=-1\)`: the reach must be a positive length"):
        PaintedRegion(np.eye(2), [False, True], reach=-1)
    file = ply(tmp_path / "ball.ply", "x y z red", [(0, 0, 0, 255)])
    with pytest.raises(ValueError, match=r"'ball.ply' have no property 'paint'; they have x, y, z, red"):
        PaintedRegion.read(file, "paint")
    file.write_bytes(b"solid")
    with pytest.raises(ValueError, match=r"PaintedRegion.read: 'ball.ply' is not a valid PLY file: it has no header"):
        PaintedRegion.read(file, "red")
