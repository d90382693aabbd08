import sys

import numpy as np
import pytest

from levelflow.export.scene import Scene, Up
from levelflow.export.snapshots import Snapshot, snapshots
from levelflow.export.tracking import track
from levelflow.export.usd import write_usd
from tests.export.moving import GROWTH, growing, radius

CENTER = np.array([3.0, -2.0, 1.0])
TIMES = [-3.0, -1.0, 0.0, 1.0]


@pytest.fixture(scope="module")
def sphere():
    return list(snapshots(growing(tuple(CENTER)), TIMES, resolution=24))


def opened(path):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(path))
    return stage, UsdGeom.Mesh(stage.GetPrimAtPath("/surface/mesh")), UsdGeom


@pytest.mark.parametrize("extension", ["usd", "usda", "usdc"])
def test_points_and_topology_are_samples_at_the_frames_of_their_times(sphere, tmp_path, extension):
    write_usd(sphere, tmp_path / f"a.{extension}", scene=Scene(up=Up.Z, metres_per_unit=0.01, fps=10))
    stage, mesh, geom = opened(tmp_path / f"a.{extension}")
    assert geom.GetStageUpAxis(stage) == "Z" and geom.GetStageMetersPerUnit(stage) == 0.01
    assert stage.GetTimeCodesPerSecond() == 10 and (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 3)
    assert stage.GetDefaultPrim().GetPath() == "/surface"
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none" and mesh.GetOrientationAttr().Get() == "rightHanded"
    frames = mesh.GetPointsAttr().GetTimeSamples()
    assert frames == mesh.GetFaceVertexIndicesAttr().GetTimeSamples() == [0, 1.5, 2.25, 3]
    assert [mesh.GetPrim().GetAttribute("levelflow:time").Get(frame) for frame in frames] == TIMES
    assert len(mesh.GetPointsAttr().Get(0)) == len(mesh.GetFaceVertexCountsAttr().Get(0)) == 0
    cache = geom.BBoxCache(0, ["default"])
    for frame, snapshot in zip(frames[1:], sphere[1:], strict=True):
        r = radius(snapshot.time)
        points, normals = np.array(mesh.GetPointsAttr().Get(frame)), np.array(mesh.GetNormalsAttr().Get(frame))
        faces = np.array(mesh.GetFaceVertexIndicesAttr().Get(frame)).reshape(-1, 3)
        assert list(mesh.GetFaceVertexCountsAttr().Get(frame)) == [3] * len(faces)
        cache.SetTime(frame)
        bounds = cache.ComputeWorldBound(mesh.GetPrim()).ComputeAlignedRange()
        assert np.allclose([bounds.GetMin(), bounds.GetMax()], [CENTER - r, CENTER + r], atol=1e-5)
        assert np.allclose(normals, (points - CENTER) / r, atol=1e-3)
        corners = points[faces].astype(np.float64) - CENTER
        assert np.linalg.det(corners).sum() / 6 == pytest.approx(snapshot.mesh.volume, rel=1e-4)
        assert mesh.ValidateTopology(
            mesh.GetFaceVertexIndicesAttr().Get(frame), mesh.GetFaceVertexCountsAttr().Get(frame), len(points)
        )[0]


def test_velocities_are_in_units_per_second_of_film(sphere, tmp_path):
    """Three frames for four units of time, at 10 frames per second: 40/3 units of time pass in a second."""
    write_usd(sphere, tmp_path / "a.usdc", scene=Scene(fps=10))
    _stage, mesh, _ = opened(tmp_path / "a.usdc")
    velocities, normals = np.array(mesh.GetVelocitiesAttr().Get(3)), np.array(mesh.GetNormalsAttr().Get(3))
    assert np.allclose(velocities, GROWTH * 40 / 3 * normals, atol=1e-5)
    points = np.array(mesh.ComputePointsAtTimes([3.0, 3.1], 3.0))
    assert np.allclose(points[1] - points[0], 0.1 * GROWTH * 4 / 3 * normals, atol=1e-5)


def test_faces_that_all_times_share_are_written_once(tmp_path):
    frames = list(track(growing(), [0.0, 1.0], resolution=16))
    write_usd(frames, tmp_path / "a.usdc")
    _stage, mesh, _ = opened(tmp_path / "a.usdc")
    assert mesh.GetFaceVertexIndicesAttr().GetNumTimeSamples() == 0 and mesh.GetPointsAttr().GetNumTimeSamples() == 2
    assert np.array_equal(np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3), frames[0].mesh.faces)


def test_colours_are_light_and_texture_coordinates_belong_to_corners(sphere, tmp_path):
    mesh = sphere[2].mesh
    colours = np.tile(np.array([[255, 188, 0, 128]], np.uint8), (len(mesh.vertices), 1))
    uv = np.linspace(0, 1, 6 * len(mesh.faces)).reshape(-1, 3, 2)
    write_usd([sphere[0], Snapshot(0.0, mesh, None, colours, uv)], tmp_path / "a.usda")
    _stage, prim, geom = opened(tmp_path / "a.usda")
    primvars = geom.PrimvarsAPI(prim)
    assert np.allclose(primvars.GetPrimvar("displayColor").Get(1), [[1, 0.5029, 0]], atol=1e-3)
    assert np.allclose(primvars.GetPrimvar("displayOpacity").Get(1), 128 / 255)
    texture = primvars.GetPrimvar("st")
    assert texture.GetInterpolation() == "faceVarying" and np.allclose(texture.Get(1), uv.reshape(-1, 2), atol=1e-6)
    assert len(texture.Get(0)) == 0 and not prim.GetVelocitiesAttr().HasAuthoredValue()


def test_coordinates_far_from_the_origin_are_kept(tmp_path):
    write_usd(snapshots(growing((1e6, 0.0, -1e6)), [0.0], resolution=12), tmp_path / "a.usdc")
    _stage, mesh, geom = opened(tmp_path / "a.usdc")
    bounds = geom.BBoxCache(0, ["default"]).ComputeWorldBound(mesh.GetPrim()).ComputeAlignedRange()
    assert np.allclose(bounds.GetMin(), [1e6 - 0.5, -0.5, -1e6 - 0.5], rtol=0, atol=1e-5)


def test_the_same_snapshots_give_the_same_bytes(sphere, tmp_path):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    for extension in ("usda", "usdc"):
        for name in "ab":
            write_usd(sphere, tmp_path / f"{name}.{extension}")
        assert (tmp_path / f"a.{extension}").read_bytes() == (tmp_path / f"b.{extension}").read_bytes()


def test_what_cannot_be_written_is_answered(sphere, tmp_path):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    with pytest.raises(ValueError, match=r"cannot write 'a.usdz'; known extensions are .usd, .usda, .usdc"):
        write_usd(sphere, tmp_path / "a.usdz")
    with pytest.raises(ValueError, match="write_usd: none of the 1 snapshots"):
        write_usd(sphere[:1], tmp_path / "a.usd")
    with pytest.raises(FileNotFoundError, match="no folder"):
        write_usd(sphere, tmp_path / "no" / "a.usd")
    assert not list(tmp_path.iterdir())


def test_without_the_package_the_error_says_how_to_install_it(sphere, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr.Usd", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'levelflow\[usd\]'"):
        write_usd(sphere, tmp_path / "a.usd")
