"""The files of ParaView, read by VTK where it is installed, and by a small parser everywhere."""

import base64
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import trimesh

from levelflow.export.paraview import write_pvd, write_vtp
from levelflow.export.snapshots import Snapshot, snapshots
from tests.export.moving import GROWTH, growing, radius

CENTER = np.array([3.0, -2.0, 1.0])
TIMES = [-3.0, 0.0, 1 / 3]
KINDS = {"Float32": "<f4", "Float64": "<f8", "Int64": "<i8", "UInt8": "u1"}


@pytest.fixture(scope="module")
def sphere():
    return list(snapshots(growing(tuple(CENTER)), TIMES, resolution=24))


def parsed(path):
    """The arrays of a `.vtp` by name, and the piece."""
    root = ElementTree.parse(path).getroot()
    assert root.attrib["byte_order"] == "LittleEndian" and root.attrib["header_type"] == "UInt64"
    arrays = {}
    for element in root.iter("DataArray"):
        data = base64.b64decode(element.text, validate=True)
        assert int.from_bytes(data[:8], "little") == len(data) - 8
        values = np.frombuffer(data[8:], KINDS[element.attrib["type"]])
        width = int(element.attrib.get("NumberOfComponents", 1))
        arrays[element.attrib["Name"]] = values.reshape(-1, width) if width > 1 else values
    return arrays, next(root.iter("Piece")).attrib


def collection(path):
    sets = ElementTree.parse(path).getroot().find("Collection").findall("DataSet")
    return {float(each.attrib["timestep"]): each.attrib["file"] for each in sets}


def test_the_collection_holds_the_real_times_of_the_surfaces_that_are_there(sphere, tmp_path):
    seen = []
    entries = write_pvd(sphere, tmp_path / "wave.pvd", on_entry=seen.append)
    assert entries == seen and [entry.file is None for entry in entries] == [True, False, False]
    assert collection(tmp_path / "wave.pvd") == {0.0: "wave/wave_0001.vtp", 1 / 3: "wave/wave_0002.vtp"}
    for time, file in collection(tmp_path / "wave.pvd").items():
        arrays, piece = parsed(tmp_path / file)
        assert arrays["TimeValue"] == [time]
        points, faces = arrays["Points"], arrays["connectivity"].reshape(-1, 3)
        assert int(piece["NumberOfPoints"]) == len(points) and int(piece["NumberOfPolys"]) == len(faces)
        assert np.array_equal(arrays["offsets"], 3 * np.arange(1, len(faces) + 1))
        n = (points - CENTER) / radius(time)
        assert np.allclose(points.min(0), CENTER - radius(time), atol=1e-5)
        assert np.allclose(arrays["Normals"], n, atol=1e-3)
        assert np.allclose(arrays["velocity"], GROWTH * arrays["Normals"], atol=1e-6)
        assert trimesh.Trimesh(points, faces, process=False).volume > 0


def test_vtk_reads_the_same(sphere, tmp_path):
    vtk = pytest.importorskip("vtk", reason="vtk is not installed")
    write_vtp(sphere[2], tmp_path / "a.vtp")
    reader = vtk.vtkXMLPolyDataReader()
    reader.SetFileName(str(tmp_path / "a.vtp"))
    reader.Update()
    data, r = reader.GetOutput(), radius(1 / 3)
    bounds = np.array(data.GetBounds()).reshape(3, 2)
    assert np.allclose(bounds, CENTER[:, None] + [-r, r], atol=1e-5)
    assert data.GetNumberOfPolys() == len(sphere[2].mesh.faces)
    assert data.GetFieldData().GetArray("TimeValue").GetValue(0) == 1 / 3
    mass = vtk.vtkMassProperties()
    mass.SetInputData(data)
    assert abs(mass.GetVolume() / sphere[2].mesh.volume - 1) < 1e-5
    first = np.array(data.GetPointData().GetArray("velocity").GetTuple(0))
    assert np.allclose(first, sphere[2].velocities[0], atol=1e-6) and data.GetPointData().GetNormals() is not None


def test_colours_are_carried(sphere, tmp_path):
    mesh = sphere[1].mesh
    colours = np.arange(4 * len(mesh.vertices)).reshape(-1, 4).astype(np.uint8)
    write_vtp(Snapshot(0.0, mesh, colours=colours), tmp_path / "a.vtp")
    arrays, _ = parsed(tmp_path / "a.vtp")
    assert np.array_equal(arrays["colours"], colours) and "velocity" not in arrays


def test_a_plane_curve_lies_at_height_zero(tmp_path):
    (curve,) = snapshots(growing(space=2), [0.0], resolution=24)
    write_vtp(curve, tmp_path / "curve.vtp")
    arrays, piece = parsed(tmp_path / "curve.vtp")
    assert int(piece["NumberOfLines"]) == len(curve.mesh.faces) and piece["NumberOfPolys"] == "0"
    assert not arrays["Points"][:, 2].any() and np.array_equal(arrays["offsets"][:2], [2, 4])


def test_the_same_snapshots_give_the_same_bytes_and_far_ones_lose_nothing(tmp_path):
    (far,) = snapshots(growing((1e6, 0.0, 0.0)), [0.0], resolution=12)
    for name in "ab":
        write_vtp(far, tmp_path / f"{name}.vtp")
    assert (tmp_path / "a.vtp").read_bytes() == (tmp_path / "b.vtp").read_bytes()
    assert np.array_equal(parsed(tmp_path / "a.vtp")[0]["Points"], far.mesh.vertices)


def test_what_cannot_be_written_is_answered(sphere, tmp_path):
    with pytest.raises(ValueError, match="write_vtp: the surface has vanished at t = -3"):
        write_vtp(sphere[0], tmp_path / "a.vtp")
    with pytest.raises(FileNotFoundError, match="write_pvd: there is no folder"):
        write_pvd(sphere, tmp_path / "no" / "a.pvd")
