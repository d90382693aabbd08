"""GLB files, read by trimesh, by a strict parser, and by the Khronos validator where it is installed.

The validator is the npm package gltf-validator; LEVELFLOW_GLTF_VALIDATOR names its folder.
"""

import json
import os
import shutil
import subprocess

import numpy as np
import pytest
import trimesh

from levelflow.export.gltf import write_glb, write_morph_glb
from levelflow.export.scene import Scene, Up
from levelflow.export.snapshots import Snapshot, snapshots
from levelflow.export.tracking import track
from tests.export.moving import growing, radius

CENTER = np.array([3.0, -2.0, 1.0])
TIMES = [-3.0, -1.0, 0.0, 1.0]
KINDS = {5126: "<f4", 5125: "<u4", 5123: "<u2"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


@pytest.fixture(scope="module")
def sphere():
    return list(snapshots(growing(tuple(CENTER)), TIMES, resolution=24))


@pytest.fixture(scope="module")
def carried():
    return list(track(growing(tuple(CENTER)), [0.0, 0.25, 1.0], resolution=24))


def parsed(path):
    """The document and the arrays of its accessors, after checks that a strict loader makes."""
    data = path.read_bytes()
    assert data[:4] == b"glTF" and int.from_bytes(data[4:8], "little") == 2
    assert int.from_bytes(data[8:12], "little") == len(data)
    size = int.from_bytes(data[12:16], "little")
    assert data[16:20] == b"JSON" and size % 4 == 0
    document = json.loads(data[20 : 20 + size])
    rest = data[20 + size :]
    assert rest[4:8] == b"BIN\0" and int.from_bytes(rest[:4], "little") == len(rest) - 8
    assert document["buffers"] == [{"byteLength": len(rest) - 8}]
    arrays = []
    for accessor in document["accessors"]:
        view, kind = document["bufferViews"][accessor["bufferView"]], np.dtype(KINDS[accessor["componentType"]])
        width = WIDTHS[accessor["type"]]
        assert view["byteOffset"] % 4 == 0 and view["byteOffset"] + view["byteLength"] <= len(rest) - 8
        assert view["byteLength"] == accessor["count"] * width * kind.itemsize
        array = np.frombuffer(rest, kind, accessor["count"] * width, 8 + view["byteOffset"]).reshape(-1, width)
        for name, extreme in (("min", array.min(0)), ("max", array.max(0))):
            assert np.array_equal(accessor.get(name, extreme), extreme)
        assert np.isfinite(array).all()
        arrays.append(array)
    for mesh in document["meshes"]:
        for primitive in mesh["primitives"]:
            attributes = {name: arrays[i] for name, i in primitive["attributes"].items()}
            count = len(attributes["POSITION"])
            assert all(len(array) == count for array in attributes.values())
            assert arrays[primitive["indices"]].max() == count - 1
            assert np.allclose(np.linalg.norm(attributes["NORMAL"], axis=1), 1, atol=1e-6)
            for target in primitive.get("targets", []):
                assert all(len(arrays[i]) == count for i in target.values())
    for animation in document.get("animations", []):
        for sampler in animation["samplers"]:
            seconds = arrays[sampler["input"]][:, 0]
            assert seconds[0] == 0 and (np.diff(seconds) > 0).all()
    return document, arrays


def validate(path):
    """The messages of the Khronos validator about errors and warnings."""
    folder, node = os.environ.get("LEVELFLOW_GLTF_VALIDATOR"), shutil.which("node")
    if not folder or node is None:
        pytest.skip("the Khronos validator is not there: install node, `npm install gltf-validator`, and set "
                    "LEVELFLOW_GLTF_VALIDATOR to its folder in node_modules")  # fmt: skip
    program = (
        "const [folder, file] = process.argv.slice(1);"
        "require(folder).validateBytes(new Uint8Array(require('fs').readFileSync(file)))"
        ".then(report => console.log(JSON.stringify(report.issues)));"
    )
    done = subprocess.run([node, "-e", program, folder, path], capture_output=True, text=True, check=True)
    return [message for message in json.loads(done.stdout)["messages"] if message["severity"] < 2]


def shown(document, arrays, second):
    """The names of the meshes whose nodes have scale 1 at a second of the animation."""
    (animation,) = document["animations"]
    names = []
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        assert sampler["interpolation"] == "STEP" and channel["target"]["path"] == "scale"
        at = np.searchsorted(arrays[sampler["input"]][:, 0], second, side="right") - 1
        scale = arrays[sampler["output"]][at]
        assert len(arrays[sampler["output"]]) == len(arrays[sampler["input"]])
        assert scale.tolist() in ([0, 0, 0], [1, 1, 1])
        if scale[0] == 1:
            names.append(document["nodes"][channel["target"]["node"]]["name"])
    return names


def test_each_time_has_a_node_that_is_shown_in_its_turn(sphere, tmp_path):
    write_glb(sphere, tmp_path / "a.glb", scene=Scene(fps=10))
    document, arrays = parsed(tmp_path / "a.glb")
    names = ["t = -1", "t = 0", "t = 1"]
    assert [node["extras"]["time"] for node in document["nodes"][1:]] == TIMES[1:]
    # Evenly or not, times keep their proportions: frames 0, 1.5, 2.25, 3 at 10 per second.
    for second, found in ((0.0, []), (0.149, []), (0.151, names[:1]), (0.224, names[:1]), (0.226, names[1:2]),
                          (0.299, names[1:2]), (0.301, names[2:]), (9.0, names[2:])):  # fmt: skip
        assert shown(document, arrays, second) == found
    scene = trimesh.load_scene(tmp_path / "a.glb", process=False)
    assert list(scene.geometry) == names
    for snapshot in sphere[1:]:
        body, r = scene.geometry[f"t = {snapshot.time:g}"], radius(snapshot.time)
        body.apply_translation(document["nodes"][0]["translation"])
        assert np.allclose(body.bounds, [CENTER - r, CENTER + r], atol=1e-5)
        assert body.is_watertight and abs(body.volume / snapshot.mesh.volume - 1) < 1e-5
        assert np.allclose(body.vertex_normals, (body.vertices - CENTER) / r, atol=1e-3)


def test_a_program_without_animation_shows_the_first_surface(sphere, tmp_path):
    write_glb(sphere, tmp_path / "a.glb")
    scene = trimesh.load_scene(tmp_path / "a.glb")
    bodies = [scene.geometry[name].copy().apply_transform(scene.graph[node][0])
              for node, name in ((node, scene.graph[node][1]) for node in scene.graph.nodes_geometry)]  # fmt: skip
    sizes = [np.ptp(body.bounds, axis=0).max() for body in bodies]
    assert np.allclose(sorted(sizes), [0, 0, 2 * radius(-1.0)], atol=1e-5)
    assert np.allclose(scene.bounds, [CENTER - radius(-1.0), CENTER + radius(-1.0)], atol=1e-5)


def test_one_surface_needs_no_animation(sphere, tmp_path):
    write_glb(sphere[1:2], tmp_path / "a.glb")
    write_morph_glb(sphere[1:2], tmp_path / "b.glb")
    for name in "ab":
        document, _ = parsed(tmp_path / f"{name}.glb")
        assert "animations" not in document and "scale" not in document["nodes"][1]


def test_a_scene_is_in_metres_with_y_up(sphere, tmp_path):
    write_glb(sphere[2:3], tmp_path / "a.glb", scene=Scene(up=Up.Z, metres_per_unit=0.01))
    x, y, z = CENTER
    r, middle = 0.01 * radius(0.0), 0.01 * np.array([x, z, -y])
    assert np.allclose(trimesh.load_scene(tmp_path / "a.glb").bounds, [middle - r, middle + r], atol=1e-6)


def test_coordinates_far_from_the_origin_are_kept(tmp_path):
    far = np.array([1e6, 5.0, -3e5])
    for up in Up:
        write_glb(snapshots(growing(tuple(far)), [0.0], resolution=16), tmp_path / "a.glb", scene=Scene(up=up))
        bounds = trimesh.load_scene(tmp_path / "a.glb").bounds
        middle = far if up is Up.Y else far[[0, 2, 1]] * [1, 1, -1]
        assert np.allclose(bounds, [middle - radius(0.0), middle + radius(0.0)], rtol=0, atol=1e-5)
        parsed(tmp_path / "a.glb")


def test_morph_targets_carry_one_mesh_to_each_time(carried, tmp_path):
    write_morph_glb(carried, tmp_path / "a.glb", scene=Scene(fps=10))
    document, arrays = parsed(tmp_path / "a.glb")
    (primitive,) = document["meshes"][0]["primitives"]
    base = arrays[primitive["attributes"]["POSITION"]]
    shapes = [base, *(base + arrays[target["POSITION"]] for target in primitive["targets"])]
    normals = arrays[primitive["attributes"]["NORMAL"]]
    normals = [normals, *(normals + arrays[target["NORMAL"]] for target in primitive["targets"])]
    faces = arrays[primitive["indices"]].reshape(-1, 3)
    (animation,) = document["animations"]
    (sampler,) = animation["samplers"]
    assert np.allclose(arrays[sampler["input"]][:, 0], [0, 0.05, 0.2])
    assert np.array_equal(arrays[sampler["output"]].reshape(3, 2), [[0, 0], [1, 0], [0, 1]])
    assert document["meshes"][0]["extras"]["targetNames"] == ["t = 0.25", "t = 1"]
    for time, points, directions in zip((0.0, 0.25, 1.0), shapes, normals, strict=True):
        assert np.allclose((points - CENTER) / radius(time), directions, atol=1e-3)
        assert np.allclose(points.min(0), CENTER - radius(time), atol=1e-4)
        assert trimesh.Trimesh(points, faces).volume > 0


def test_colours_become_light_and_texture_coordinates_split_vertices(carried, tmp_path):
    mesh = carried[0].mesh
    n, m = len(mesh.vertices), len(mesh.faces)
    colours = np.tile(np.array([[255, 188, 0, 128]], np.uint8), (n, 1))
    uv = np.zeros((m, 3, 2))
    uv[0] = [[0.25, 0.75], [0.5, 0.5], [0.75, 1]]
    dressed = [Snapshot(s.time, s.mesh, s.velocities, colours, uv) for s in carried]
    for write in (write_glb, write_morph_glb):
        write(dressed, tmp_path / "a.glb")
        document, arrays = parsed(tmp_path / "a.glb")
        primitive = document["meshes"][0]["primitives"][0]
        light = arrays[primitive["attributes"]["COLOR_0"]] / 65535
        assert len(light) == n + 3 and np.allclose(light, [[1, 0.5029, 0, 128 / 255]], atol=1e-3)
        texture = arrays[primitive["attributes"]["TEXCOORD_0"]]
        corners = arrays[primitive["indices"]].reshape(-1, 3)
        assert np.allclose(texture[corners[0]], uv[0] * [1, -1] + [0, 1])
        points = arrays[primitive["attributes"]["POSITION"]] + document["nodes"][0].get("translation", [0, 0, 0])
        assert np.allclose(points[corners], mesh.vertices[mesh.faces], atol=1e-6)
        other = trimesh.load_scene(tmp_path / "a.glb", process=False).geometry
        assert next(iter(other.values())).visual is not None


def test_khronos_validator_finds_nothing_wrong(sphere, carried, tmp_path):
    colours = np.full((len(carried[0].mesh.vertices), 4), 200, np.uint8)
    uv = np.random.default_rng(0).uniform(size=(len(carried[0].mesh.faces), 3, 2))
    dressed = [Snapshot(s.time, s.mesh, s.velocities, colours, uv) for s in carried]
    for write, frames in ((write_glb, sphere), (write_glb, sphere[1:2]), (write_glb, dressed),
                          (write_morph_glb, carried), (write_morph_glb, dressed)):  # fmt: skip
        write(frames, tmp_path / "a.glb", scene=Scene(up=Up.Z, metres_per_unit=0.01))
        assert validate(tmp_path / "a.glb") == []


def test_the_same_snapshots_give_the_same_bytes(sphere, tmp_path):
    for name in "ab":
        write_glb(sphere, tmp_path / f"{name}.glb")
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()


def test_what_cannot_be_written_is_answered(sphere, tmp_path):
    with pytest.raises(ValueError, match=r"write_morph_glb: the faces of the snapshots differ.*`write_glb`"):
        write_morph_glb(sphere[1:], tmp_path / "a.glb")
    with pytest.raises(ValueError, match="write_glb: none of the 1 snapshots"):
        write_glb(sphere[:1], tmp_path / "a.glb")
    with pytest.raises(ValueError, match="no curves in the plane"):
        write_glb(snapshots(growing(space=2), [0.0], resolution=8), tmp_path / "a.glb")
    with pytest.raises(FileNotFoundError, match="no folder"):
        write_glb(sphere, tmp_path / "no" / "a.glb")
    assert not list(tmp_path.iterdir())
