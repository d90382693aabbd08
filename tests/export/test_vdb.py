"""OpenVDB level sets: written where LEVELFLOW_OPENVDB_PYTHON names an interpreter with OpenVDB, read by tinyvdb."""

import os
import subprocess
import sys

import numpy as np
import pytest

from levelflow import Box
from levelflow.export.snapshots import snapshots
from levelflow.export.vdb import HALF_WIDTH, INTERPRETER, level_sets, write_vdb
from levelflow.extraction import ExtractionWarning
from tests.export.moving import growing, radius
from tests.fields import siren

CENTER = np.array([3.0, -2.0, 1.0])


@pytest.fixture(scope="module")
def field():
    return growing(tuple(CENTER), steepness=5.0)


@pytest.fixture(scope="module")
def sphere(field):
    return list(level_sets(field, snapshots(field, [-3.0, 0.0], resolution=40), resolution=40))


@pytest.fixture
def openvdb():
    python = os.environ.get(INTERPRETER)
    if not python:
        pytest.skip(
            f"no interpreter with OpenVDB: set {INTERPRETER}, on Debian with python3-openvdb to /usr/bin/python3"
        )
    return python


def test_the_band_holds_distances_whatever_the_slope_of_the_field(sphere):
    band = sphere[1]
    distance = np.linalg.norm(band.grid.points(band.index) - CENTER, axis=1) - radius(0.0)
    assert np.abs(band.values - distance).max() < 2e-3
    assert np.abs(band.values).max() < HALF_WIDTH * band.grid.spacing
    inside = 4 / 3 * np.pi * np.diff((radius(0.0) + HALF_WIDTH * band.grid.spacing * np.array([-1, 1])) ** 3)
    assert abs(len(band.values) * band.grid.spacing**3 / inside - 1) < 0.02
    assert sphere[0].is_empty and sphere[0].time == -3


def test_the_band_goes_over_the_sides_of_the_box():
    field = growing()
    field.box = Box((-0.76,) * 3, (0.76,) * 3, ((-4.0, 1.0),))
    (band,) = level_sets(field, snapshots(field, [1.0], resolution=20), resolution=20)
    assert band.index.min() == -2 and band.index.max() == 22


def test_tinyvdb_reads_the_level_set(sphere, openvdb, tmp_path):
    tinyvdb = pytest.importorskip("tinyvdb", reason="tinyvdb is not installed")
    write_vdb(sphere[1], tmp_path / "a.vdb", python=openvdb)
    file = tinyvdb.open(str(tmp_path / "a.vdb"))
    file.read_grids()
    assert file.grid_count == 1 and file.grid_name(0) == "surface" and file.grid_type_name(0) == "Tree_float_5_4_3"
    grid = file.grid(0)
    assert grid.metadata["class"] == "level set"
    assert np.allclose(grid.transform["voxel_size"], sphere[1].grid.spacing)
    assert np.allclose(grid.transform["translation"], sphere[1].grid.lower)
    assert grid.float_background() == pytest.approx(HALF_WIDTH * sphere[1].grid.spacing)
    sparse = grid.to_sparse()
    index = np.frombuffer(sparse["coords"], np.int32).reshape(-1, 3)
    values = np.frombuffer(sparse["values"], np.float32)
    assert sparse["count"] == len(sphere[1].values)
    order, other = np.lexsort(index.T), np.lexsort(sphere[1].index.T)
    assert np.array_equal(index[order], sphere[1].index[other])
    assert np.array_equal(values[order], sphere[1].values[other])


def test_openvdb_finds_the_surface_and_its_inside(sphere, openvdb, tmp_path):
    write_vdb(sphere[1], tmp_path / "a.vdb", python=openvdb)
    program = """
import sys
try:
    import openvdb
except ModuleNotFoundError:
    import pyopenvdb as openvdb
grid = openvdb.read(sys.argv[1], "surface")
points, quads = grid.convertToQuads()
print(grid.gridClass, grid["time"], *points.min(0), *points.max(0))
at = grid.getConstAccessor()
print(at.getValue((20, 20, 20)), at.isValueOn((20, 20, 20)), at.getValue((0, 0, 0)), grid.background)
"""
    done = subprocess.run([openvdb, "-c", program, tmp_path / "a.vdb"], capture_output=True, text=True, check=True)
    first, second = done.stdout.splitlines()
    assert first.startswith("level set 0.0 ")
    corners = np.array(first.split()[3:], dtype=float).reshape(2, 3)
    assert np.allclose(corners, [CENTER - radius(0.0), CENTER + radius(0.0)], atol=5e-3)
    middle, active, outside, background = second.split()
    assert float(middle) == -float(background) and float(outside) == float(background) and active == "False"


def test_the_same_level_set_gives_the_same_bytes(sphere, openvdb, tmp_path):
    for name in "ab":
        write_vdb(sphere[1], tmp_path / f"{name}.vdb", python=openvdb)
    assert (tmp_path / "a.vdb").read_bytes() == (tmp_path / "b.vdb").read_bytes()


def test_the_interpreter_is_named_by_the_environment(sphere, tmp_path, monkeypatch):
    monkeypatch.setenv(INTERPRETER, str(tmp_path / "no-python"))
    with pytest.raises(ModuleNotFoundError, match=rf"no-python' does not run .*set {INTERPRETER} to one that"):
        write_vdb(sphere[1], tmp_path / "a.vdb")


def test_without_openvdb_the_error_says_how_to_get_it(sphere, tmp_path):
    hidden = tmp_path / "python"
    hidden.write_text(f"#!/bin/sh\nexec {sys.executable} -S -c 'import openvdb'\n")
    hidden.chmod(0o755)
    with pytest.raises(ModuleNotFoundError, match=rf"apt install python3-openvdb.*{INTERPRETER}=/usr/bin/python3"):
        write_vdb(sphere[1], tmp_path / "a.vdb", python=str(hidden))
    hidden.write_text("#!/bin/sh\necho out of luck >&2\nexit 3\n")
    with pytest.raises(RuntimeError, match=r"OpenVDB in .* failed: out of luck"):
        write_vdb(sphere[1], tmp_path / "a.vdb", python=str(hidden))
    hidden.write_text("#!/bin/sh\nexit 3\n")
    with pytest.raises(RuntimeError, match=r"failed: exit code 3"):
        write_vdb(sphere[1], tmp_path / "a.vdb", python=str(hidden))
    assert [path.name for path in tmp_path.iterdir()] == ["python"]


def test_what_has_no_level_set_grid_is_refused(sphere, tmp_path):
    with pytest.raises(ValueError, match="write_vdb: the surface has vanished at t = -3"):
        write_vdb(sphere[0], tmp_path / "a.vdb")
    with pytest.raises(ValueError, match="level_sets.*no box"):
        next(level_sets(siren(3, 1), []))
    curve = growing(space=2)
    with pytest.raises(ValueError, match="is a curve in the plane"):
        next(level_sets(curve, snapshots(curve, [0.0], resolution=8), resolution=8))
    cut = growing()
    cut.box = Box((-1, -1, 0), (1, 1, 1), ((-4.0, 1.0),))
    with pytest.warns(ExtractionWarning), pytest.raises(ValueError, match="t = 0 is not watertight: it leaves the box"):
        next(level_sets(cut, snapshots(cut, [0.0], resolution=8), resolution=8))
