"""The command line as a user meets it: what is written, what is said, and the exit code."""

import json
import math
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import torch

from levelflow import Mesh, __version__, load
from levelflow.cli.names import times_in, velocity_named
from levelflow.equations import FeaturePreserving
from levelflow.equations.described import equation_of
from levelflow.saving import describe
from levelflow.shapes import Sphere

pytestmark = pytest.mark.filterwarnings("default")
SMALL = ("--width", "16", "--depth", "2", "--quiet")
MEDIUM = ("--width", "32", "--depth", "2", "--quiet")


def test_help_and_version(run):
    code, out, _ = run("--help")
    assert code == 0
    for verb in ("demo", "fit", "smooth", "advect", "morph", "mesh", "measure", "info"):
        assert verb in out
    assert run("--version")[:2] == (0, f"levelflow {__version__}\n")


def test_help_does_not_load_the_engine():
    text = "import sys, levelflow.cli; sys.exit(int('torch' in sys.modules or 'numpy' in sys.modules))"
    assert subprocess.run([sys.executable, "-c", text], check=False).returncode == 0


def test_smooth_writes_field_meshes_picture_and_report(run, tmp_path):
    code, out, err = run("smooth", "sphere", "--rate", "0.1", "--times", "-0.1,0,0.2", "-o", tmp_path / "out",
                         "--steps", 150, "--width", 32, "--depth", 2, "--resolution", 48)  # fmt: skip
    assert code == 0 and "sharpens before t = 0" in err
    names = sorted(p.name for p in (tmp_path / "out").iterdir())
    assert names == ["field.safetensors", "frames.png", "report.json", "t=+0.000.ply", "t=+0.200.ply", "t=-0.100.ply"]
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["settings"]["seed"] == 0 and report["steps"] == 150 and report["accuracy"]["0"]["mean"] < 0.01
    assert set(report["residuals"]) == {"on_surface", "off_surface", "equation"}
    for frame in report["frames"]:
        radius = math.sqrt(0.25 - 0.4 * frame["time"])
        assert abs(frame["area"] / (4 * math.pi * radius**2) - 1) < 0.08
        assert Mesh.read(tmp_path / "out" / frame["file"]).is_watertight
    assert "report.json" in out
    field = load(tmp_path / "out" / "field.safetensors")
    assert field.box.times == ((-0.1, 0.2),) and field.provenance["inputs"] == ["sphere"]


def test_a_shape_is_carried_along_characteristics_unless_a_network_is_to_be_distilled(run, tmp_path):
    """A field that is given needs no training at all; the exact motion brings it back after a whole turn."""
    run("fit", "torus", "-o", tmp_path / "torus.safetensors", "--steps", 12, *SMALL)
    common = ("--rate", 2 * math.pi, "--axis", "1,0,0", "--times", "0,1", "--resolution", 16)
    assert run("advect", tmp_path / "torus.safetensors", "-o", tmp_path / "a", *common, *SMALL)[0] == 0
    report = json.loads((tmp_path / "a" / "report.json").read_text())
    assert report["steps"] == 12 and report["seconds"]["training"] < 5
    field = load(tmp_path / "a" / "field.safetensors")
    x = torch.rand(50, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) - 0.5
    assert torch.allclose(field.at(0.0)(x), field.at(1.0)(x), atol=1e-5)
    assert (field.at(0.0)(x) - field.at(0.25)(x)).abs().max() > 0.05
    assert run("advect", "torus", "--distil", "-o", tmp_path / "b", "--steps", 5, *common, *SMALL)[0] == 0
    assert describe(tmp_path / "b" / "field.safetensors")["network"]["time"] == 1


def test_the_results_come_back_in_the_units_of_the_file(run, tmp_path):
    center = np.array([1200.0, -300.0, 40.0])
    ball = Mesh.read(_ball(tmp_path, 50.0, center))
    code, *_ = run("advect", tmp_path / "ball.ply", "--velocity", "translation", "--by", "30,0,0", "--times", "0,1",
                   "-o", tmp_path / "out", "--steps", 150, "--width", 32, "--depth", 2, "--resolution", 48)  # fmt: skip
    assert code == 0
    for t, x in ((0, 0.0), (1, 30.0)):
        moved = Mesh.read(tmp_path / "out" / f"t=+{t}.000.ply")
        assert np.allclose(moved.box.center, center + [x, 0, 0], atol=1.0)
        assert np.allclose(moved.box.size, ball.box.size, rtol=0.03)


def test_morph_mesh_measure_and_info_work_together(run, tmp_path):
    folder = tmp_path / "out"
    assert (
        run("morph", "sphere", "torus", "-o", folder, "--times", "0,1", "--steps", 200, "--resolution", 40, *MEDIUM)[0]
        == 0
    )
    assert (
        run("mesh", folder / "field.safetensors", "--time", 0.5, "--resolution", 40, "-o", tmp_path / "half.obj")[0]
        == 0
    )
    code, out, _ = run("measure", tmp_path / "half.obj", "sphere")
    assert code == 0 and "chamfer" in out and "volume" in out
    code, out, _ = run("info", folder / "field.safetensors")
    assert code == 0 and json.loads(out)["box"]["times"] == [[0.0, 1.0]]
    code, out, _ = run("info", tmp_path / "half.obj")
    assert code == 0 and "watertight: yes" in out and "box from" in out


def test_a_fitted_field_is_a_shape_for_other_commands(run, tmp_path):
    field = tmp_path / "ball.safetensors"
    code, out, _ = run("fit", "sphere", "-o", field, "--steps", 150, "--width", 32, "--depth", 2)
    assert code == 0 and "mean distance to the given surface" in out
    assert (
        run("smooth", field, "-o", tmp_path / "out", "--times", "0,1", "--steps", 5, "--resolution", 16, *SMALL)[0] == 0
    )
    assert run("measure", field, "sphere")[0] == 0


@pytest.mark.parametrize(("given", "threshold"), [(("auto",), 16.0), (("0.05",), 20.0), (("0.05", "--relative"), 32.0)])
def test_edges_are_kept_beyond_a_radius_in_the_units_of_the_file(run, tmp_path, given, threshold):
    """A cuboid of side 1 has a box of half the side 0.625."""
    code, *_ = run("smooth", "cuboid", "--rate", "0.001", "--keep-edges", *given, "-o", tmp_path / "out",
                   "--times", "0,1", "--steps", 2, "--resolution", 8, *SMALL)  # fmt: skip
    equation = equation_of(load(tmp_path / "out" / "field.safetensors").provenance)
    assert code == 0 and isinstance(equation, FeaturePreserving) and math.isclose(equation.threshold, threshold)


def test_a_point_cloud_is_smoothed(run, tmp_path):
    points = np.random.default_rng(0).normal(size=(400, 3))
    np.savetxt(tmp_path / "cloud.xyz", points / np.linalg.norm(points, axis=1, keepdims=True))
    assert run("info", tmp_path / "cloud.xyz")[0] == 0
    code, *_ = run("smooth", tmp_path / "cloud.xyz", "-o", tmp_path / "o", "--times", "0,1", "--steps", 60,
                   "--resolution", 24, *SMALL)  # fmt: skip
    assert code == 0


def test_results_have_a_folder_of_their_own_if_none_is_named(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        code, *_ = run("advect", "sphere", "--times", "0,1", "--steps", 3, "--resolution", 12, *SMALL)
        assert code == 0 and (tmp_path / "sphere-advect" / "report.json").exists()


def test_a_plane_curve_is_moved(run, tmp_path):
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    curve = np.stack([np.cos(angle), 0.5 * np.sin(angle)], axis=1)
    Mesh(curve, np.stack([np.arange(60), np.roll(np.arange(60), -1)], axis=1)).write(tmp_path / "curve.ply")
    for velocity in ("rotation", "translation"):
        assert run("advect", tmp_path / "curve.ply", "--velocity", velocity, "-o", tmp_path / velocity, "--steps", 60,
                   "--times", "0,1", "--resolution", 32, *MEDIUM)[0] == 0  # fmt: skip
    code, _, err = run("advect", tmp_path / "curve.ply", "--velocity", "twist", "-o", tmp_path / "twist", *SMALL)
    assert code == 2 and "three space coordinates" in err


def test_the_same_seed_gives_the_same_file(run, tmp_path):
    for name in ("a", "b"):
        run("advect", "torus", "-o", tmp_path / name, "--steps", 12, "--times", "0,1", "--resolution", 16, *SMALL)
    files = [(tmp_path / name / "field.safetensors").read_bytes() for name in ("a", "b")]
    assert files[0] == files[1]


def test_a_time_budget_is_kept(run, tmp_path):
    started = time.perf_counter()
    run("fit", "sphere", "-o", tmp_path / "f.safetensors", "--seconds", 2, *SMALL)
    assert 2 <= time.perf_counter() - started < 30
    assert json.loads(run("info", tmp_path / "f.safetensors")[1])["provenance"]["steps"] > 10


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("smooth", "none.obj", "-o", "OUT"), 2, "there is no file 'none.obj'"),
        (("smooth", "spher", "-o", "OUT"), 2, "neither a file nor a built-in"),
        (("smooth", "EMPTY.obj", "-o", "OUT"), 2, "EMPTY.obj' is empty"),
        (("smooth", "TEXT.obj", "-o", "OUT"), 2, "TEXT.obj' is not a valid OBJ file"),
        (("smooth", "POINTS.obj", "-o", "OUT"), 2, "no faces"),
        (("smooth", "NAN.obj", "-o", "OUT"), 2, "(?i)nan|not finite"),
        (("smooth", "THREE.xyz", "-o", "OUT"), 2, "3 points"),
        (("smooth", "sphere", "-o", "OUT", "--times", "soon"), 2, "give numbers"),
        (("smooth", "sphere", "-o", "OUT", "--times", "0"), 2, "ask for other times"),
        (("smooth", "sphere", "-o", "OUT", "--rate", "-1"), 2, "the rate must be positive"),
        (("smooth", "sphere", "-o", "OUT", "--keep-edges", "sharp"), 2, "the radius of the sharpest bends.*or auto"),
        (("smooth", "sphere", "-o", "OUT", "--keep-edges", "-1"), 2, "the radius of the sharpest bends.*or auto"),
        (("smooth", "sphere", "-o", "OUT", "--device", "abacus"), 2, "no such kind of device"),
        (("smooth", "sphere", "-o", "OUT", "--steps", "0"), 2, "must be positive"),
        (("smooth", "sphere", "-o", "OUT", "--resolution", "1"), 2, "at least 2 cells"),
        (("smooth", "sphere", "-o", "OUT", "--resume"), 2, "no interrupted run"),
        (("fit", "sphere"), 2, "--output"),
        (("smooth", "sphere", "-o", "TEXT.obj"), 2, "this is a file"),
        (("advect", "sphere", "-o", "OUT", "--axis", "0,0,0"), 2, "not all zero"),
        (("advect", "sphere", "-o", "OUT", "--center", "0,0"), 2, "the shape has 3 coordinates"),
        (("advect", "sphere", "-o", "OUT", "--velocity", "wind"), 2, "known are translation"),
        (("advect", "sphere", "-o", "OUT", "--axis", "up"), 2, "numbers with commas"),
        (("morph", "sphere", "-o", "OUT"), 2, "name at least two"),
        (("morph", "sphere", "torus", "-o", "OUT", "--times", "0,2"), 2, "between the times 0 and 1"),
        (("morph", "CLOUD.xyz", "torus", "-o", "OUT"), 2, "is a point cloud"),
        (("fit", "sphere", "-o", "f.ply"), 2, "a field is a .safetensors file"),
        (("mesh", "EMPTY.obj", "-o", "x.ply"), 2, "is not a field"),
        (("info", "none.ply"), 2, "there is no file"),
        (("dance",), 2, "No such command"),
    ],
    ids=lambda value: " ".join(value[:5]) if isinstance(value, tuple) else "",
)  # fmt: skip
def test_wrong_use_is_answered_in_a_sentence(run, unchecked, tmp_path, monkeypatch, arguments, code, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "EMPTY.obj").write_text("")
    (tmp_path / "TEXT.obj").write_text("Dear user,\nthis is a letter.\n")
    (tmp_path / "POINTS.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    (tmp_path / "NAN.obj").write_text("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "THREE.xyz").write_text("0 0 0\n1 0 0\n0 1 0\n")
    np.savetxt(tmp_path / "CLOUD.xyz", np.random.default_rng(0).normal(size=(40, 3)))
    got, out, err = run(*arguments)
    assert got == code
    assert re.search(message, err), err
    assert "Traceback" not in out + err


def test_a_time_outside_the_interval_is_answered(run, tmp_path):
    folder = tmp_path / "out"
    run("smooth", "sphere", "-o", folder, "--times", "0,1", "--steps", 5, "--resolution", 16, *SMALL)
    code, _, err = run("mesh", folder / "field.safetensors", "--time", 3, "-o", tmp_path / "x.ply")
    assert code == 2 and "solved for times from 0 to 1" in err
    code, _, err = run("mesh", folder / "field.safetensors", "-o", tmp_path / "x.ply")
    assert code == 2 and "say when with --time" in err


def test_a_full_disk_is_a_failure_and_leaves_nothing_half_written(run, tmp_path, monkeypatch):
    real = os.replace

    def full(source, target):
        if str(target).endswith("field.safetensors"):
            raise OSError(28, "No space left on device", str(target))
        real(source, target)

    monkeypatch.setattr("os.replace", full)
    code, _, err = run("smooth", "sphere", "-o", tmp_path / "out", "--times", "0,1", "--steps", 3, *SMALL)
    assert code == 1 and "No space left" in err and "Traceback" not in err
    assert list((tmp_path / "out").iterdir()) == []


def test_debug_shows_the_traceback(run, monkeypatch):
    with pytest.raises(FileNotFoundError):
        run("info", "none.ply", "--debug")


def test_a_killed_run_goes_on_from_its_checkpoint_and_ends_as_if_nothing_had_been(tmp_path):
    command = [sys.executable, "-m", "levelflow", "advect", "sphere", "--times", "0,1", "--resolution", "16", *SMALL,
               "--steps", "400", "-o"]  # fmt: skip
    environment = {**os.environ, "LEVELFLOW_CHECKPOINT_SECONDS": "0.2", "OMP_NUM_THREADS": "1"}
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    subprocess.run([*command, str(whole)], check=True, env=environment)
    process = subprocess.Popen([*command, str(killed)], env=environment)
    checkpoint = killed / "checkpoint.safetensors"
    while not checkpoint.exists():
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    refused = subprocess.run([*command, str(killed)], env=environment, capture_output=True, text=True, check=False)
    assert refused.returncode == 2 and "holds an interrupted run" in refused.stderr
    other = [part if part != "400" else "300" for part in command]
    refused = subprocess.run(
        [*other, str(killed), "--resume"], env=environment, capture_output=True, text=True, check=False
    )
    assert refused.returncode == 2 and "steps was 400 and is 300" in refused.stderr
    subprocess.run([*command, str(killed), "--resume"], check=True, env=environment)
    assert not checkpoint.exists()
    assert (whole / "field.safetensors").read_bytes() == (killed / "field.safetensors").read_bytes()


def test_times_are_numbers_or_a_range():
    assert times_in("0:1:5") == [0, 0.25, 0.5, 0.75, 1]
    assert times_in("1,-0.5,0") == [-0.5, 0, 1]


def test_velocities_by_name_have_the_units_that_were_asked_for():
    import torch

    x, t = torch.tensor([[0.0, 2.0, 1.0]]).double(), torch.zeros(1, 1).double()
    common = {"by": None, "rate": 2.0, "axis": (0.0, 1.0, 0.0), "center": (0.0, 0.0, 0.0), "reach": None}
    twist = velocity_named("twist", **common, length=10.0, unit=10.0)
    assert torch.allclose(twist(x, t), torch.tensor([[0.4, 0.0, 0.0]]).double())
    turn = velocity_named("rotation", **common, length=10.0, unit=10.0)
    assert torch.allclose(turn(x, t), torch.tensor([[2.0, 0.0, 0.0]]).double())
    assert torch.allclose(
        velocity_named("sink", **common, length=1.0, unit=1e6)(x, t), torch.tensor([[0.0, -4.0, -2.0]]).double()
    )
    moved = velocity_named("translation", **{**common, "by": "1,2,3"}, length=10.0, unit=1.0)
    assert torch.allclose(moved(x, t), torch.tensor([[10.0, 20.0, 30.0]]).double())


def _ball(folder, radius, center):
    from levelflow import extract

    mesh = extract(
        Sphere(radius, center=tuple(center)).distance,
        resolution=24,
        box=Sphere(radius, center=tuple(center)).box.expanded(5.0),
    )
    mesh.write(folder / "ball.ply")
    return folder / "ball.ply"
