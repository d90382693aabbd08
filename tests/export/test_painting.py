import numpy as np
import pytest
import trimesh

from levelflow import Mesh, extract
from levelflow.export.painting import Paint, PaintWarning, painted, painted_once
from levelflow.export.snapshots import Snapshot, snapshots
from levelflow.export.tracking import track
from tests.export.moving import growing, splitting


def striped(field, t, tmp_path):
    """The surface at a time as a file, its colours linear in the direction from the centre."""
    mesh = extract(field.at(t), resolution=48, refine=3)
    n = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    colours = np.concatenate([np.round(127.5 * (n + 1)), np.full((len(n), 1), 255)], 1).astype(np.uint8)
    trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=colours, process=False).export(tmp_path / "paint.ply")
    return Paint.read(tmp_path / "paint.ply")


def stripes(vertices):
    return 127.5 * (vertices / np.linalg.norm(vertices, axis=1, keepdims=True) + 1)


def cylinder(n=64, m=24):
    """A tube of height 1 around z, unrolled: u runs once around and jumps from 1 to 0 at the seam, v runs up."""
    u, v = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, m + 1), indexing="ij")
    angle = 2 * np.pi * u
    vertices = np.stack([np.cos(angle) / 2, np.sin(angle) / 2, v], -1).reshape(-1, 3)
    corner = np.arange((n + 1) * (m + 1)).reshape(n + 1, m + 1)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    uv = np.stack([u, v], -1).reshape(-1, 2)
    return Paint(vertices, faces, None, uv[faces], "tube")


def test_colours_of_the_closest_point_are_those_of_the_same_place(tmp_path):
    paint = striped(growing(), 0.0, tmp_path)
    (snapshot,) = painted(snapshots(growing(), [0.0], resolution=24), paint)
    assert np.abs(snapshot.colours[:, :3] - stripes(snapshot.mesh.vertices)).max() < 2
    assert (snapshot.colours[:, 3] == 255).all() and snapshot.uv is None and paint.size == pytest.approx(1, abs=1e-3)


def test_colours_go_with_the_motion(tmp_path):
    """The paint is off centre: its closest points are not where the vertices came from."""
    paint = striped(growing(), 0.0, tmp_path)
    empty, early, late = painted(
        snapshots(growing(), [-2.5, -1.0, 1.0], resolution=24), paint, along=growing(), time=0.0
    )
    assert empty.colours is None
    for snapshot in (early, late):
        assert np.abs(snapshot.colours[:, :3] - stripes(snapshot.mesh.vertices)).max() < 2


def test_closest_points_far_away_are_said_to_mean_little(tmp_path):
    paint = striped(growing(), 0.0, tmp_path)
    with pytest.warns(PaintWarning, match=r"at t = 1, 1e\+02 % of the vertices are further than 0.05 from paint.ply"):
        list(painted(snapshots(growing(), [1.0], resolution=16), paint))


def test_what_was_born_in_a_pinch_is_said_to_come_from_nowhere(tmp_path):
    field = splitting()
    paint = striped(field, 0.0, tmp_path)
    with pytest.warns(PaintWarning, match=r"% of the vertices at t = 0.5 cannot be carried back to t = 0"):
        list(painted(snapshots(field, [0.5], resolution=32), paint, along=field, time=0.0))


def test_a_tracked_mesh_keeps_its_colours(tmp_path):
    paint = striped(growing(), 0.0, tmp_path)
    first, last = painted_once(track(growing(), [0.0, 1.0], resolution=24), paint)
    assert np.array_equal(first.colours, last.colours)
    assert np.abs(last.colours[:, :3] - stripes(last.mesh.vertices)).max() < 2


def test_texture_coordinates_do_not_stretch_across_a_seam():
    paint = cylinder()
    n = 41
    angle = 2 * np.pi * (np.arange(n) + 0.3) / n
    circle = np.stack([np.cos(angle) / 2, np.sin(angle) / 2], 1)
    vertices = np.concatenate([np.pad(circle, ((0, 0), (0, 1)), constant_values=z) for z in (0.2, 0.6)])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    faces = np.concatenate([np.stack([i, j, n + j], 1), np.stack([i, n + j, n + i], 1)])
    (snapshot,) = painted([Snapshot(0.0, Mesh(vertices, faces))], paint)
    assert snapshot.uv.shape == (2 * n, 3, 2) and snapshot.colours is None
    assert np.ptp(snapshot.uv[:, :, 0], axis=1).max() < 1.2 / n
    around = np.exp(2j * np.pi * snapshot.uv[:, :, 0])
    exact = (vertices[faces][:, :, 0] + 1j * vertices[faces][:, :, 1]) * 2
    assert np.abs(around - exact).max() < 0.03
    assert np.allclose(snapshot.uv[:, :, 1], vertices[faces][:, :, 2], atol=1e-9)


def test_colours_of_faces_and_texture_coordinates_are_read(tmp_path):
    box = trimesh.creation.box()
    box.visual.face_colors = np.arange(48).reshape(12, 4).astype(np.uint8)
    box.export(tmp_path / "faces.ply")
    paint = Paint.read(tmp_path / "faces.ply")
    assert np.array_equal(paint.colours[:, 0], paint.colours[:, 2]) and paint.colours[5, 0, 0] == 20
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.1 0.2\nvt 0.9 0.2\nvt 0.1 0.7\nf 1/1 2/2 3/3\n")
    assert np.allclose(Paint.read(tmp_path / "a.obj").uv, [[[0.1, 0.2], [0.9, 0.2], [0.1, 0.7]]])


def test_real_texture_coordinates_are_carried(meshes):
    paint, mesh = Paint.read(meshes / "spot.obj"), Mesh.read(meshes / "spot.obj")
    surface = extract(mesh.distance, resolution=48, box=mesh.box.expanded(0.05))
    (snapshot,) = painted([Snapshot(0.0, surface)], paint)
    assert np.ptp(snapshot.uv, axis=1).max() < 0.3
    assert snapshot.uv.min() > -0.1 and snapshot.uv.max() < 1.1


def test_what_cannot_be_painted_is_refused(tmp_path):
    (tmp_path / "plain.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(ValueError, match=r"'plain.obj' has neither colours nor texture coordinates"):
        Paint.read(tmp_path / "plain.obj")
    (tmp_path / "bad.ply").write_text("nonsense")
    with pytest.raises(ValueError, match="'bad.ply' is not a mesh that can be read"):
        Paint.read(tmp_path / "bad.ply")
    with pytest.raises(FileNotFoundError, match="there is no file"):
        Paint.read(tmp_path / "none.ply")
    with pytest.raises(ValueError, match="a curve in the plane takes no colours"):
        next(painted(snapshots(growing(space=2), [0.0], resolution=8), cylinder()))
    with pytest.raises(ValueError, match="the field has 0 times; give one that moves"):
        next(painted([], cylinder(), along=growing().at(0.0)))
    with pytest.raises(ValueError, match=r"at\(9\): the field was solved for times from -4 to 1"):
        next(painted([], cylinder(), along=growing(), time=9.0))
