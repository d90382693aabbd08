import numpy as np
import pytest
import trimesh

from levelflow import Box, Mesh, extract
from levelflow.export.printing import write_stl
from levelflow.extraction import ExtractionWarning
from tests.export.moving import growing, radius


@pytest.fixture(scope="module")
def ball():
    return extract(growing().at(0.0), resolution=24, refine=3)


def test_a_solid_is_watertight_in_the_file_and_in_millimetres(ball, tmp_path):
    write_stl(ball, tmp_path / "ball.stl", millimetres_per_unit=1000)
    other = trimesh.load(tmp_path / "ball.stl")
    assert other.is_watertight and other.is_winding_consistent
    assert np.allclose(other.bounds, [[-1000 * radius(0)] * 3, [1000 * radius(0)] * 3], atol=1e-2)
    assert abs(other.volume / (1e9 * ball.volume) - 1) < 1e-5


def test_triangles_that_float32_makes_degenerate_are_left_out(ball, tmp_path):
    vertices = np.concatenate([ball.vertices, ball.vertices[ball.faces[0, :1]] + 1e-12])
    a, b, c = ball.faces[0]
    other = next(i for i, f in enumerate(ball.faces) if i and {a, b} <= set(f))
    d = next(v for v in ball.faces[other] if v not in (a, b))
    middle = len(ball.vertices)
    rest = np.delete(ball.faces, [0, other], axis=0)
    split = [[a, middle, c], [middle, b, c], [b, middle, d], [middle, a, d]]
    write_stl(Mesh(vertices, np.concatenate([rest, split])), tmp_path / "a.stl")
    assert len(trimesh.load(tmp_path / "a.stl", process=False).faces) == len(ball.faces)


def test_the_same_solid_gives_the_same_bytes(ball, tmp_path):
    for name in "ab":
        write_stl(ball, tmp_path / f"{name}.stl")
    assert (tmp_path / "a.stl").read_bytes() == (tmp_path / "b.stl").read_bytes()


def test_what_cannot_be_printed_is_refused(ball, tmp_path):
    with pytest.warns(ExtractionWarning):
        cut = extract(growing().at(0.0), resolution=24, box=Box((-1, -1, 0), (1, 1, 1)))
    with pytest.raises(ValueError, match=r"not watertight, it is open along \d+ edges"):
        write_stl(cut, tmp_path / "a.stl")
    doubled = Mesh(ball.vertices, np.concatenate([ball.faces, ball.faces]))
    with pytest.raises(ValueError, match="more than two triangles meet in an edge"):
        write_stl(doubled, tmp_path / "a.stl")
    with pytest.raises(ValueError, match=r"encloses a volume of -.*faces inward"):
        write_stl(Mesh(ball.vertices, ball.faces[:, ::-1]), tmp_path / "a.stl")
    with pytest.raises(ValueError, match="STL holds no curves"):
        write_stl(extract(growing(space=2).at(0.0), resolution=8), tmp_path / "a.stl")
    with pytest.raises(FileNotFoundError, match="no folder"):
        write_stl(ball, tmp_path / "no" / "a.stl")
    assert not list(tmp_path.iterdir())
