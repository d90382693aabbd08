"""Masks: values in regions and at their edges, and what is painted on a circle and read from files."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
import trimesh

from levelflow.equations import BoxMask, PaintedMask, ProductOfMasks, SphereMask
from levelflow.equations.masks import painted_vertices
from levelflow.shapes.reading import read_vertex_properties

SQUARE = BoxMask((-1.0, -1.0), (1.0, 0.5), 0.2, inside=0.25, outside=2.0)
DISK = SphereMask((1.0, 0.0), 0.5, 0.1)


@pytest.mark.parametrize("mask", [SQUARE, DISK], ids=["box", "sphere"])
def test_a_region_has_one_value_another_lies_away_from_it_and_the_edge_is_smooth(mask, generator):
    x = 4 * torch.rand(4000, 2, generator=generator, dtype=torch.float64) - 2
    if mask is SQUARE:
        gap = torch.linalg.vector_norm(
            ((x - x.new_tensor([0.0, -0.25])).abs() - x.new_tensor([1, 0.75])).clamp(0), dim=1
        )
    else:
        gap = (torch.linalg.vector_norm(x - x.new_tensor([1.0, 0.0]), dim=1) - 0.5).clamp(0)
    values = mask(x)
    assert torch.allclose(values[gap == 0], x.new_tensor(mask.inside))
    assert torch.allclose(values[gap >= mask.soft], x.new_tensor(mask.outside))
    share = ((values - mask.inside) / (mask.outside - mask.inside))[gap.argsort()]
    assert (share.diff() >= -1e-12).all() and ((share > 0.01) & (share < 0.99)).any()
    assert torch.autograd.gradcheck(mask, x[:300].clone().requires_grad_())


def test_a_box_may_be_open_and_masks_multiply():
    half = BoxMask((-math.inf, -math.inf), (math.inf, 0.0), 0.1, inside=0.0, outside=1.0)
    x = torch.tensor([[1e6, -5.0], [-1e6, 0.0], [3.0, 0.1], [1.0, 0.2]], dtype=torch.float64)
    assert half(x).tolist() == [0.0, 0.0, 1.0, 1.0]
    assert ProductOfMasks((half, DISK))(x).tolist() == [0.0, 0.0, 0.0, 1.0]


def circle(n: int = 400) -> np.ndarray:
    angle = np.linspace(0, 2 * math.pi, n, endpoint=False)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def test_what_is_painted_black_keeps_still_up_to_its_border_and_the_edge_is_as_wide_as_said(generator):
    points, soft = circle(), 0.2
    mask = PaintedMask.of(points, (points[:, 0] > 0).astype(float), soft=soft, name="half.ply")
    assert repr(mask) == "PaintedMask('half.ply')"
    along = torch.tensor(circle(1000), dtype=torch.float64)
    for distance in (0.95, 1.0, 1.1):
        x = distance * along
        values, side = mask(x), x[:, 0]
        assert values.min() >= 0 and values.max() <= 1 + 1e-6
        assert values[side < -0.25 * soft].max() < 1e-3 and values[side < 0].max() < 0.1
        assert values[side > 1.3 * soft].min() > 0.999
    # Off the surface too, and far away, it is that of the nearest vertices.
    assert torch.allclose(mask(torch.tensor([[-9.0, 0.3], [9.0, 0.3], [0.4, 0.0]], dtype=torch.float64)).round(),
                          torch.tensor([0.0, 1.0, 1.0], dtype=torch.float64))  # fmt: skip


def test_grey_is_interpolated_with_continuous_derivatives(generator):
    """Values that grow linearly along x: in the middle of the paint the mask is that line, up to the softening."""
    points = np.stack(np.meshgrid(np.linspace(-1, 1, 81), np.linspace(-1, 1, 81)), axis=-1).reshape(-1, 2)
    mask = PaintedMask.of(points, (points[:, 0] + 1) / 2, soft=0.1)
    x = 1.6 * torch.rand(500, 2, generator=generator, dtype=torch.float64) - 0.8
    assert (mask(x) - (x[:, 0] + 1) / 2).abs().max() < 0.05
    double = PaintedMask(mask.table.double(), mask.box)
    x = x[:50].requires_grad_()
    assert torch.autograd.gradcheck(double, x) and torch.autograd.gradgradcheck(double, x)


def test_a_single_point_is_a_mask_of_one_value():
    mask = PaintedMask.of(np.array([[1.0, 2.0]]), np.array([0.25]))
    assert torch.allclose(mask(torch.rand(10, 2, dtype=torch.float64)), torch.full((10,), 0.25, dtype=torch.float64))


def ply(path, properties, rows, *, kind="ascii"):
    lines = ["ply", f"format {kind} 1.0", f"element vertex {len(rows)}", *properties, "end_header"]
    path.write_text("\n".join([*lines, *(" ".join(map(str, row)) for row in rows)]) + "\n")
    return path


POSITION = ["property float x", "property float y", "property float z"]
COLOUR = [f"property uchar {name}" for name in ("red", "green", "blue")]


def test_colours_and_properties_are_read_from_files(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=1)
    grey = np.arange(len(ball.vertices)).astype(np.uint8)
    colours = np.stack([grey, grey, grey, np.full_like(grey, 255)], axis=1)
    for name in ("a.ply", "a.obj", "a.glb"):
        trimesh.Trimesh(ball.vertices, ball.faces, vertex_colors=colours, process=False).export(tmp_path / name)
        points, values = painted_vertices(tmp_path / name)
        nearest = np.linalg.norm(points[:, None] - ball.vertices, axis=2).argmin(1)
        assert np.allclose(values, grey[nearest] / 255, atol=1e-6) and len(points) >= len(grey)
    assert PaintedMask.read(tmp_path / "a.ply", soft=0.5).name == "a.ply"
    path = ply(tmp_path / "p.ply", [*POSITION[:2], *COLOUR, "property float quality"],
               [(0, 1, 255, 255, 255, 0.5), (2, 3, 0, 51, 0, 0.25)])  # fmt: skip
    points, values = painted_vertices(path)
    assert points.tolist() == [[0, 1], [2, 3]] and np.allclose(values, [1.0, 17 / 255])
    assert painted_vertices(path, by="quality")[1].tolist() == [0.5, 0.25]
    floats = [line.replace("uchar", "float") for line in COLOUR]
    assert painted_vertices(ply(tmp_path / "f.ply", [*POSITION, *floats], [(0, 0, 0, 0.5, 0.5, 0.5)]))[1] == 0.5
    assert set(read_vertex_properties(path, call="a test")[1]) == {"red", "green", "blue", "quality"}


def test_what_is_no_mask_in_a_file_is_said(tmp_path):
    bare = ply(tmp_path / "bare.ply", POSITION, [(0, 0, 0)])
    named = ply(tmp_path / "named.ply", [*POSITION, "property float quality"], [(0, 0, 0, 1)])
    (tmp_path / "letter.ply").write_text("Dear user")
    (tmp_path / "letter.glb").write_text("Dear user")
    trimesh.creation.icosphere(subdivisions=0).export(tmp_path / "plain.obj")
    for path, by, message in (
        (bare, None, r"the vertices of 'bare.ply' have no colours\. Paint on them, black where nothing is to move"),
        (named, None, r"have no colours, only quality; one of these is the mask by='quality' \(--mask-by quality\)"),
        (named, "mask", "its vertices have no such property, only quality"),
        (tmp_path / "plain.obj", None, "the vertices of 'plain.obj' have no colours; PLY files can hold them"),
        (tmp_path / "plain.obj", "mask", "only the vertices of a PLY file have properties"),
        (tmp_path / "letter.ply", None, "'letter.ply' is not a valid PLY file"),
        (tmp_path / "letter.glb", None, "'letter.glb' is not a mesh that can be read"),
    ):
        with pytest.raises(ValueError, match=message):
            painted_vertices(path, by=by)
    with pytest.raises(FileNotFoundError, match="there is no file"):
        painted_vertices(tmp_path / "none.ply")


def test_wrong_numbers_are_refused(unchecked):
    for lower, upper, message in (
        ((0.0, 0.0), (1.0, 0.0), "the lower corner is not below the upper one"),
        ((0.0,), (1.0, 1.0), "the lower corner is not below the upper one"),
        ((math.nan, 0.0), (1.0, 1.0), "the lower corner is not below the upper one"),
    ):
        with pytest.raises(ValueError, match=message):
            BoxMask(lower, upper, 0.1)
    for values in ((math.nan, 0.0), 1.0), ((0.0, 0.0), 0.0), ((0.0, 0.0), math.inf):
        with pytest.raises(ValueError, match="give a finite centre and a positive radius"):
            SphereMask(*values, 0.1)
    for soft in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="soft must be positive, the width of the edge"):
            SphereMask((0.0, 0.0), 1.0, soft)
    with pytest.raises(ValueError, match="the values inside and outside must be finite"):
        BoxMask((0.0, 0.0), (1.0, 1.0), 0.1, inside=math.nan)
    with pytest.raises(ValueError, match="the mask has 2 coordinates, the points have 3"):
        DISK(torch.zeros(1, 3))
    points = circle(10)
    for change, message in (
        ({"values": np.zeros(3)}, "10 points with 3 values"),
        ({"points": np.zeros((0, 2)), "values": np.zeros(0)}, "0 points with 0 values"),
        ({"values": np.r_[math.nan, np.zeros(9)]}, "1 of 10 vertices have a position or value that is not finite"),
        ({"points": np.full((10, 2), math.inf)}, "10 of 10 vertices"),
        ({"values": np.full(10, 7.0)}, "the values go from 7 to 7; a mask is 0 where nothing moves"),
        ({"soft": 0.0}, "soft=0; give the positive width"),
    ):
        with pytest.raises(ValueError, match=message):
            PaintedMask.of(**{"points": points, "values": np.ones(10), **change})
