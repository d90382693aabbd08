"""Pictures: what is where, in which colour, and files that are whole."""

from pathlib import Path

import numpy as np
import pytest
import torch

from levelflow.boxes import Box
from levelflow.extraction import EmptyLevelSet, extract
from levelflow.rendering.camera import Camera
from levelflow.rendering.colours import Scale, bar_width
from levelflow.rendering.images import contact_sheet, image, write
from levelflow.rendering.quantities import Curvature
from levelflow.rendering.shading import Clay, Normals
from levelflow.rendering.tracing import framed
from levelflow.shapes.analytic import Sphere
from levelflow.shapes.mesh import Mesh
from tests.fields import Explicit

GROUND = np.round(255 * np.array(Clay().ground)).astype(np.uint8)
BALL = extract(Sphere(0.6).distance, resolution=32, box=Box((-1, -1, -1), (1, 1, 1)))
RING = extract(lambda x: (x.norm(dim=1) - 0.5).abs() - 0.2, resolution=64, box=Box((-1, -1), (1, 1)))


def test_a_ball_lies_in_the_middle_of_a_light_ground_lit_from_above() -> None:
    picture = image(BALL, size=64)
    assert picture.shape == (64, 64, 3)
    assert picture.dtype == np.uint8
    for corner in (picture[0, 0], picture[0, -1], picture[-1, 0], picture[-1, -1]):
        assert np.array_equal(corner, GROUND)
    assert picture[16, 26].mean() > picture[50, 38].mean() + 40
    # Clay is warm.
    assert picture[32, 32, 0] > picture[32, 32, 2] + 20


def test_the_inside_of_an_open_mesh_has_another_colour() -> None:
    camera = Camera((0, 0, 5), orthographic=True)
    front = image(BALL, camera, size=32)[16, 16].astype(int)
    bowl = Mesh(BALL.vertices, BALL.faces[BALL.vertices[BALL.faces].mean(1)[:, 2] < 0])
    back = image(bowl, camera, size=32)[16, 16].astype(int)
    assert front[0] > front[2]
    assert back[2] > back[0]


def test_pictures_may_be_of_any_shape_and_edges_are_smooth() -> None:
    picture = image(BALL, size=(40, 60), supersampling=3)
    assert picture.shape == (40, 60, 3)
    colours = np.unique(image(RING, size=40, supersampling=3).reshape(-1, 3), axis=0)
    assert len(colours) > 8
    assert len(np.unique(image(RING, size=40, supersampling=1).reshape(-1, 3), axis=0)) == 3


def test_a_curve_is_filled_inside_only() -> None:
    picture = image(RING, Camera.around(Box((-1, -1), (1, 1))), size=108, supersampling=4)
    # A unit is 50 pixels: the hole in the middle, the ring at 0.5, the ground outside.
    assert np.array_equal(picture[54, 54], GROUND)
    assert not np.array_equal(picture[54, 79], GROUND)
    assert np.array_equal(picture[54, 100], GROUND)
    filled = (picture != GROUND).any(2).sum()
    assert filled / 50**2 == pytest.approx(np.pi * (0.49 - 0.09), rel=0.1)
    line = Mesh(np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 1.0]]), np.array([[0, 1], [1, 2]]))
    assert (image(line, size=64) != GROUND).any(2).mean() < 0.1


def test_a_sheet_shows_all_at_one_scale(tmp_path: Path) -> None:
    small = Mesh(BALL.vertices / 2, BALL.faces)
    labels, path = ["t = 0", "t = 1", "t = 2"], tmp_path / "sheet.png"
    sheet = contact_sheet([BALL, small, None], labels, path, size=80, title="Balls")
    tiles = [sheet[26 : 26 + 80, 80 * i : 80 * (i + 1)] for i in range(3)]
    covered = [(tile != GROUND).any(2).sum() for tile in tiles]
    assert covered[0] / covered[1] == pytest.approx(4, rel=0.1)
    assert 0 < covered[2] < 0.1 * covered[0]
    assert (sheet[-20:] != GROUND).any()
    from PIL import Image

    assert np.array_equal(np.array(Image.open(path)), sheet)
    assert list(tmp_path.iterdir()) == [path]


def test_a_sheet_may_have_rows_curves_and_nothing_to_show() -> None:
    assert contact_sheet([RING] * 6, list("abcdef"), size=40).shape == (2 * 60, 3 * 40, 3)
    assert contact_sheet([RING] * 4, list("abcd"), size=40, columns=1).shape == (4 * 60, 40, 3)
    assert contact_sheet([None], ["gone"], size=40).shape == (60, 40, 3)
    triangle = contact_sheet([RING] * 3, list("abc"), size=40, columns=(1, 2))
    assert triangle.shape == (2 * 60, 2 * 40, 3)
    top, bottom = ((triangle[60 * row : 60 * row + 40] != GROUND).any((0, 2)) for row in (0, 1))
    assert not top[:20].any() and top[20:60].any() and not top[60:].any() and bottom[:20].any() and bottom[60:].any()


def test_pictures_are_written_whole_or_not_at_all(tmp_path: Path) -> None:
    picture = image(RING, size=16)
    write(picture, tmp_path / "ring.png")
    before = (tmp_path / "ring.png").read_bytes()
    with pytest.raises(TypeError):
        write(picture.astype(np.float64), tmp_path / "ring.png")
    assert (tmp_path / "ring.png").read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 1


def test_a_traced_field_looks_like_its_mesh() -> None:
    field = Explicit(lambda x, t: torch.linalg.vector_norm(x, dim=1) - 0.6, 3, box=Box((-1, -1, -1), (1, 1, 1)))
    camera = Camera.around(BALL.vertices)
    smooth = Mesh(BALL.vertices, BALL.faces, normals=BALL.vertices / 0.6)
    mesh, traced = image(smooth, camera, size=96), image(field, camera, size=96)
    assert np.abs(mesh.astype(int) - traced).mean() < 1.0
    # Without a camera the surface fills the picture, not its box.
    covered = (image(field, size=96) != GROUND).any(2)
    assert covered.any(0).sum() > 80
    assert not covered[0].any()


def test_directions_are_colours() -> None:
    camera = Camera((0, 0, 5), orthographic=True)
    picture = image(BALL, camera, size=65, material=Normals())
    # In the middle the normal is z; to the right it turns to x, and up to y.
    assert np.abs(picture[32, 32].astype(int) - [128, 128, 255]).max() <= 4
    assert picture[32, 44, 0] > 190
    assert picture[20, 32, 1] > 190


def test_values_are_colours_of_a_scale_beside_a_bar() -> None:
    camera, scale = Camera((0, 0, 5), orthographic=True), Scale(-1, 1)
    heights = BALL.vertices[:, 1] / 0.6
    picture = image(BALL, camera, size=(90, 120), values=heights, scale=scale)
    assert picture.shape == (90, 120, 3)
    middle = (120 - bar_width(90)) // 2
    above, below = picture[27, middle].astype(int), picture[63, middle].astype(int)
    assert above[0] > above[2] + 40
    assert below[2] > below[0] + 40
    # A scale of its own: the numbers of a sphere's curvature do not vary, and are positive.
    field = Explicit(lambda x, t: torch.linalg.vector_norm(x, dim=1) - 0.6, 3, box=Box((-1, -1, -1), (1, 1, 1)))
    for surface in (BALL, field):
        red = image(surface, camera, size=64, values=Curvature(field))[32, (64 - bar_width(64)) // 2].astype(int)
        assert red[0] > red[2] + 40


def test_pictures_that_cannot_be() -> None:
    with pytest.raises(ValueError, match="at least one pixel"):
        image(BALL, size=0)
    field = Explicit(lambda x, t: x[:, 0] + 5, 3, box=Box((-1, -1, -1), (1, 1, 1)))
    with pytest.raises(EmptyLevelSet, match="has vanished, or lies outside"):
        image(field, size=8)
    with pytest.raises(EmptyLevelSet, match="the camera looks elsewhere"):
        image(field, Camera((0, 0, 5)), size=8)
    with pytest.raises(ValueError, match="has no box"):
        framed(Explicit(lambda x, t: x[:, 0], 3))
    ball = Explicit(lambda x, t: torch.linalg.vector_norm(x, dim=1) - 0.6, 3, box=Box((-1, -1, -1), (1, 1, 1)))
    with pytest.raises(ValueError, match="need a mesh"):
        image(ball, Camera((0, 0, 5)), size=64, values=np.zeros(3))
    with pytest.raises(ValueError, match="give one for each"):
        image(BALL, size=64, values=np.zeros(3))
    with pytest.raises(ValueError, match="no room for the colour bar"):
        image(BALL, size=8, values=np.zeros(len(BALL.vertices)))
    with pytest.raises(ValueError, match="drawn as clay"):
        image(RING, size=8, values=np.zeros(len(RING.vertices)))
    with pytest.raises(ValueError, match="one label per mesh"):
        contact_sheet([BALL], ["a", "b"])
    with pytest.raises(ValueError, match="0 meshes"):
        contact_sheet([], [])
    with pytest.raises(ValueError, match=r"contact_sheet\(columns=\(1, 1\)\): the rows hold 2 of 3 meshes"):
        contact_sheet([BALL] * 3, list("abc"), columns=(1, 1))
