import json

import numpy as np
import pytest
import trimesh

from levelflow import Mesh
from levelflow.export.ply import write_ply
from levelflow.export.sequences import Entry, numbered, write_sequence, write_series
from levelflow.export.snapshots import Snapshot, snapshots
from tests.export.moving import GROWTH, growing, radius

CENTER = np.array([3.0, -2.0, 1.0])
TIMES = [-3.0, 0.0, 0.5]


@pytest.fixture(scope="module")
def sphere():
    return list(snapshots(growing(tuple(CENTER)), TIMES, resolution=24))


def test_files_are_numbered_in_the_order_of_time_and_vanished_surfaces_keep_their_number(sphere, tmp_path):
    seen = []
    entries = write_sequence(sphere, tmp_path / "wave.ply", write_ply, on_entry=seen.append)
    assert entries == seen
    assert entries == [Entry(-3.0, None), *(Entry(t, tmp_path / f"wave_000{i}.ply") for i, t in ((1, 0.0), (2, 0.5)))]
    for entry in entries[1:]:
        other = trimesh.load(entry.file, process=False)
        assert np.allclose(other.bounds, CENTER + radius(entry.time) * np.array([[-1] * 3, [1] * 3]), atol=1e-5)
        assert other.is_watertight and 0.95 < other.volume / (4 / 3 * np.pi * radius(entry.time) ** 3) < 1
        assert np.allclose(other.vertex_normals, (other.vertices - CENTER) / radius(entry.time), atol=1e-3)


def test_the_series_names_the_files_with_their_times(sphere, tmp_path):
    series = write_series(write_sequence(sphere, tmp_path / "wave.ply", write_ply), tmp_path / "wave.ply")
    assert series.name == "wave.ply.series"
    assert json.loads(series.read_text()) == {
        "file-series-version": "1.0",
        "files": [{"name": "wave_0001.ply", "time": 0.0}, {"name": "wave_0002.ply", "time": 0.5}],
    }


def test_one_alone_has_no_number(sphere, tmp_path):
    assert write_sequence(sphere[1:2], tmp_path / "one.ply", write_ply, alone=True)[0].file == tmp_path / "one.ply"
    assert numbered("a/wave.x.ply", 12).name == "wave.x_0012.ply"


def test_ply_has_what_a_snapshot_has(sphere, tmp_path):
    still = sphere[2]
    n, m = len(still.mesh.vertices), len(still.mesh.faces)
    colours = np.arange(4 * n).reshape(n, 4).astype(np.uint8)
    uv = np.linspace(0, 1, 6 * m).reshape(m, 3, 2)
    write_ply(Snapshot(0.5, still.mesh, still.velocities, colours, uv), tmp_path / "a.ply")
    other = trimesh.load(tmp_path / "a.ply", process=False)
    raw = other.metadata["_ply_raw"]["vertex"]["data"]
    assert np.allclose(np.stack([raw[f"v{axis}"] for axis in "xyz"], 1).reshape(n, 3), still.velocities, atol=1e-6)
    assert np.allclose(np.linalg.norm(still.velocities, axis=1), GROWTH)
    stored = np.stack([raw[c] for c in ("red", "green", "blue", "alpha")], 1).reshape(n, 4)
    assert np.array_equal(stored, colours)
    texture = other.metadata["_ply_raw"]["face"]["data"]["texcoord"]
    assert np.allclose(np.asarray(texture["f1"] if texture.dtype.names else texture).reshape(m, 3, 2), uv, atol=1e-6)
    again = Mesh.read(tmp_path / "a.ply")
    assert np.allclose(again.vertices, still.mesh.vertices, atol=1e-6) and np.array_equal(again.faces, still.mesh.faces)


def test_coordinates_far_from_the_origin_are_kept(tmp_path):
    (far,) = snapshots(growing((1e6, 0.0, 0.0)), [0.0], resolution=12)
    write_ply(far, tmp_path / "far.ply")
    assert np.abs(Mesh.read(tmp_path / "far.ply").vertices - far.mesh.vertices).max() < 1e-9


def test_a_plane_curve_is_written_with_its_velocities(tmp_path):
    (curve,) = snapshots(growing(space=2), [0.0], resolution=24)
    write_ply(curve, tmp_path / "curve.ply")
    again = Mesh.read(tmp_path / "curve.ply")
    assert again.faces.shape[1] == 2 and abs(again.volume / curve.mesh.volume - 1) < 1e-6
    assert b"property float vy" in (tmp_path / "curve.ply").read_bytes()


def test_the_same_snapshot_gives_the_same_bytes(sphere, tmp_path):
    for name in "ab":
        write_ply(sphere[1], tmp_path / f"{name}.ply")
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


def test_what_cannot_be_written_is_answered(sphere, tmp_path):
    with pytest.raises(ValueError, match="write_ply: the surface has vanished at t = -3"):
        write_ply(sphere[0], tmp_path / "a.ply")
    with pytest.raises(FileNotFoundError, match="no folder"):
        write_ply(sphere[1], tmp_path / "no" / "a.ply")
    assert not list(tmp_path.iterdir())
