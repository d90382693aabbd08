"""`levelflow export` as a user meets it: one trained field, every format, and what is answered to wrong use."""

import json
import os
import re
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import trimesh

from levelflow import SIREN, Budget, Mesh, Sphere, Transported, equations, fit, save, solve
from levelflow.export.vdb import INTERPRETER

pytestmark = pytest.mark.filterwarnings("default")
CENTER = np.array([30.0, -20.0, 10.0])
SMALL = ("--resolution", 24)


@pytest.fixture(scope="module")
def fields(tmp_path_factory):
    """A ball of radius 5 that moves by 2 along x in a unit of time, another that shrinks, and one that stands still."""
    folder = tmp_path_factory.mktemp("fields")
    ball = Sphere(5.0, center=tuple(CENTER))
    budget = Budget(200)
    moved = solve(
        equations.Transport(equations.Constant((2.0, 0.0, 0.0))), SIREN(3, 1, width=24, depth=2), at={0.0: ball},
        until=1.0, budget=budget,
    )  # fmt: skip
    save(moved, folder / "moving.safetensors")
    still = fit(SIREN(3, width=24, depth=2), ball, budget=budget)
    save(still, folder / "still.safetensors")
    pushes = (equations.Transport(equations.Constant(b)) for b in ((2.0, 0.0, 0.0), (0.0, 4.0, 0.0)))
    save(Transported(equations.Family(*pushes), still, until=(1.0, 1.0)), folder / "pair.safetensors")
    return folder


@pytest.fixture
def here(fields, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for file in fields.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    return tmp_path


def is_the_ball(vertices, time, tolerance=0.4):
    return np.allclose(
        [vertices.min(0), vertices.max(0)], CENTER + [2 * time, 0, 0] + np.array([[-5], [5]]), atol=tolerance
    )


def test_help_says_what_can_be_written(run):
    code, out, _ = run("export", "--help")
    assert code == 0 and "OpenVDB" in out and "--track" in out
    assert "export" in run("--help")[1]


def test_a_folder_gets_numbered_ply_files_and_the_collection_of_paraview(run, here):
    code, out, _ = run("export", "moving.safetensors", "--times", "0:1:3", "-o", "out/deep", *SMALL)
    assert code == 0 and "moving_0002.ply: t = 1" in out and "out/deep: 3 frames" in out
    names = {path.name for path in (here / "out" / "deep").iterdir()}
    plys = {f"moving_000{i}.ply" for i in range(3)}
    assert names == {"moving", "moving.ply.series", "moving.pvd"} | plys
    sets = ElementTree.parse(here / "out/deep/moving.pvd").getroot().iter("DataSet")
    assert [float(each.attrib["timestep"]) for each in sets] == [0.0, 0.5, 1.0]
    series = json.loads((here / "out/deep/moving.ply.series").read_text())["files"]
    for entry in series:
        mesh = Mesh.read(here / "out/deep" / entry["name"])
        assert is_the_ball(mesh.vertices, entry["time"]) and mesh.volume > 0 and mesh.is_watertight


def test_one_time_is_one_file(run, here):
    assert run("export", "moving.safetensors", "--times", "0.5", "-o", "one.ply", "-q", *SMALL) == (0, "", "")
    assert is_the_ball(trimesh.load("one.ply").vertices, 0.5)
    assert run("export", "still.safetensors", "-o", "still.ply", *SMALL)[:2] == (
        0, "  still.ply: t = 0\nstill.ply: 1 frame\n",
    )  # fmt: skip
    assert sorted(path.name for path in here.glob("*.ply")) == ["one.ply", "still.ply"]


def test_a_walk_through_parameters_is_exported_like_a_motion(run, here):
    """Two units along x and then four along y; the vertices of a tracked mesh go along with the pushes."""
    walk = ("--path", "0,0:1,0:1,1", "--frames", 3, *SMALL)
    code, out, err = run("export", "pair.safetensors", *walk, "-o", "out", "--track")
    assert code == 0 and "out: 3 frames" in out, err
    first, middle, last = (trimesh.load(f"out/pair_000{i}.ply", process=False).vertices for i in range(3))
    assert is_the_ball(first, 0) and np.allclose(middle - first, [2, 0, 0], atol=1e-4)
    assert np.allclose(last - first, [2, 4, 0], atol=1e-4)
    assert run("export", "pair.safetensors", *walk, "-o", "out.npz")[0] == 0
    assert run("export", "pair.safetensors", "--time", "0.5,0", "-o", "one.ply", "-q", *SMALL) == (0, "", "")
    assert is_the_ball(trimesh.load("one.ply").vertices, 0.5)


def test_a_film_is_one_file(run, here):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Usd, UsdGeom

    common = ("--times", "0:1:3", *SMALL, "--up", "z", "--metres-per-unit", "0.01", "--fps", "10")
    assert run("export", "moving.safetensors", "-o", "film.usda", *common)[0] == 0
    stage = Usd.Stage.Open("film.usda")
    assert UsdGeom.GetStageUpAxis(stage) == "Z" and UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    assert stage.GetTimeCodesPerSecond() == 10 and stage.GetEndTimeCode() == 2
    code, out, _ = run("export", "moving.safetensors", "-o", "film.glb", *common)
    assert code == 0 and re.search(r"t = 0.5: [\d,]+ faces\n", out) and "film.glb: 3 frames" in out
    scene = trimesh.load_scene("film.glb")
    assert list(scene.geometry) == ["t = 0", "t = 0.5", "t = 1"]
    x, y, z = 0.01 * CENTER
    assert np.allclose(scene.bounds, np.array([x, z, -y]) + [[-0.05] * 3, [0.05] * 3], atol=0.004)
    assert np.allclose(scene.geometry["t = 1"].bounds.mean(0), [1, 0, 0], atol=0.4)
    assert run("export", "moving.safetensors", "-o", "film.pvd", *common)[0] == 0 and (here / "film").is_dir()


def test_a_tracked_mesh_becomes_morph_targets(run, here):
    code, _, err = run("export", "moving.safetensors", "--times", "0:0.5:3", "--track", "-o", "t.glb", *SMALL)
    assert code == 0, err
    assert b'"targetNames":["t = 0.25","t = 0.5"]' in (here / "t.glb").read_bytes()


def test_volumes_and_stl(run, here, monkeypatch):
    for kind in ("npz", "mhd", "stl"):
        command = ("export", "moving.safetensors", "--times", "0,1", "-o", kind, "--format", kind, *SMALL)
        assert run(*command, "--metres-per-unit", "0.001")[0] == 0
        assert {f"moving_000{i}.{kind}" for i in range(2)} <= {path.name for path in (here / kind).iterdir()}
    assert is_the_ball(trimesh.load("stl/moving_0001.stl").vertices, 1.0)
    with np.load("npz/moving_0001.npz") as data:
        assert data["time"] == 1
    monkeypatch.setenv(INTERPRETER, str(here / "none"))
    code, _, err = run("export", "moving.safetensors", "--times", "0", "-o", "a.vdb", *SMALL)
    assert code == 1 and "set LEVELFLOW_OPENVDB_PYTHON to one that has OpenVDB" in err


def test_openvdb_files(run, here):
    if not os.environ.get(INTERPRETER):
        pytest.skip(f"no interpreter with OpenVDB: set {INTERPRETER}")
    assert run("export", "moving.safetensors", "--times", "0,1", "-o", "a.vdb", *SMALL)[0] == 0
    assert (here / "a_0001.vdb").read_bytes()[:4] == b" BDV"


def test_colours_of_the_input_are_taken_along(run, here):
    ball = trimesh.creation.icosphere(subdivisions=3, radius=5.0)
    colours = np.where(ball.vertices[:, 1:2] > 0, [[255, 0, 0, 255]], [[0, 0, 255, 255]]).astype(np.uint8)
    trimesh.Trimesh(ball.vertices + CENTER, ball.faces, vertex_colors=colours).export("paint.ply")
    common = ("export", "moving.safetensors", "--times", "0,0.5", "--colours", "paint.ply", *SMALL)
    assert run(*common, "-o", "out", "--colours-time", "0")[0] == 0
    mesh = trimesh.load("out/moving_0001.ply", process=False)
    upper = mesh.vertices[:, 1] > CENTER[1] + 1
    assert (mesh.visual.vertex_colors[upper, 0] > 200).mean() > 0.95
    code, _, err = run(*common, "-o", "t.glb", "--track")
    assert code == 0, err
    assert b"COLOR_0" in (here / "t.glb").read_bytes()
    code, _, err = run(*common, "-o", "far", "--format", "ply")
    assert code == 0 and "the colour of the closest point means little there" in err


def test_a_surface_that_changes_is_not_tracked(run, here):
    code, _, err = run("export", "moving.safetensors", "--times", "0,1", "--track", "-o", "t.glb", "--resolution", 48)
    assert code in (0, 1) and (code == 0 or "does not arrive at t = 1" in err)


def test_an_empty_level_set_is_answered(run, here):
    from levelflow import Box, Placed

    gone = Placed(SIREN(3, 1, width=4, depth=1), Box((-1,) * 3, (1,) * 3, ((0, 1),)))
    gone.field.last.weight.data.zero_()
    gone.field.last.bias.data.fill_(1.0)
    save(gone, here / "gone.safetensors")
    for name in ("a.ply", "a.glb", "a.pvd", "a.stl", "a.usd"):
        code, _, err = run("export", "gone.safetensors", "--times", "0,1", "-o", name, *SMALL)
        assert code == 1 and "no surface at any of the times [0.0, 1.0]" in err and "Traceback" not in err
        assert not (here / name).exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("moving", "--times", "0,1", "-o", "a.fbx"), r"\.fbx is not a known format; known are ply, stl"),
        (("moving", "--times", "0,1", "-o", "a", "--format", "fbx"), "--format fbx: known are ply, stl"),
        (("moving", "--times", "0,1", "-o", "a.ply", "--format", "stl"), "the extension of a.ply says ply"),
        (("moving", "--times", "0,1", "-o", "FILE"), "this is a file; name a folder"),
        (
            ("moving", "--times", "0,3", "-o", "a.ply"),
            r"at\(3\): the field was solved for times",
        ),
        (("moving", "-o", "a.ply"), "moves from t = 0 to 1; say when with --times"),
        (("still", "--track", "-o", "a.glb"), "nothing moves; leave --track out, or say when with --times"),
        (("moving", "--time", "0", "--track", "-o", "a.glb"), "nothing moves; leave --track out, or say when"),
        (("moving", "--times", "0", "--time", "0", "-o", "a.ply"), "give one of --times, --time and --path"),
        (("moving", "--time", "0,1", "-o", "a.ply"), r"2 number\(s\) are given; one for each is needed"),
        (("pair", "--times", "0,1", "-o", "a.ply"), "say how to walk through them, .* such as --path 0,0:1,0:1,1, or"),
        (("pair", "--path", "0,0:1", "-o", "a.ply"), "give two corners or more with one number for each"),
        (("pair", "--path", "0,0:1,1", "--frames", "1", "-o", "a.ply"), "a walk has at least two frames"),
        (("moving", "--times", "soon", "-o", "a.ply"), "give numbers"),
        (
            ("still", "--times", "0", "-o", "a.ply"),
            "does not depend on time; leave --times out",
        ),
        (("moving", "--times", "0", "-o", "a.glb", "--up", "x"), "--up x: give y or z"),
        (
            ("moving", "--times", "0", "-o", "a.glb", "--fps", "0"),
            r"Scene\(fps=0\): give a positive number",
        ),
        (("moving", "--times", "0", "-o", "a.ply", "--resolution", "1"), "at least 2 cells"),
        (("moving", "--times", "0", "-o", "a.vdb", "--track"), "holds a grid, no mesh to carry along"),
        (("moving", "--times", "0", "-o", "a.stl", "--colours", "p.ply"), "has no place for colours"),
        (
            ("moving", "--times", "0", "-o", "a.ply", "--colours-time", "0"),
            "name the mesh with the colours",
        ),
        (("moving", "--times", "0", "-o", "a.ply", "--colours", "p.ply"), "Paint.read: there is no file"),
        (("moving", "--times", "0", "-o", "a.pvd", "--colours", "UV.obj"), "texture coordinates only"),
        (("none", "-o", "a.ply"), "there is no file"),
        (("FILE", "-o", "a.ply"), "is not a field"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_wrong_use_is_answered_in_a_sentence(run, unchecked, here, arguments, message):
    (here / "FILE").write_text("a letter")
    (here / "UV.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    field, *rest = arguments
    code, out, err = run("export", field if field == "FILE" else f"{field}.safetensors", *rest)
    assert code == 2 and re.search(message, err), err
    assert "Traceback" not in out + err
    assert not [path for path in here.iterdir() if path.name.startswith("a.")]


def test_a_missing_extra_is_named_with_its_command(run, here, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr.Usd", None)
    code, _, err = run("export", "moving.safetensors", "--times", "0", "-o", "a.usd", *SMALL)
    assert code == 1 and "pip install 'levelflow[usd]'" in err
