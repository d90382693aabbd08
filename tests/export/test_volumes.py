import time

import numpy as np
import pytest

from levelflow import Box
from levelflow.export.volumes import Grid, Volume, values_at, volumes, write_mhd, write_npz
from tests.export.moving import growing, radius
from tests.fields import placed, siren

CENTER = np.array([3.0, -2.0, 1.0])


@pytest.fixture(scope="module")
def sphere():
    """Values 3 (|x - c| - r); the box has three different sides."""
    field = growing(tuple(CENTER))
    field.box = Box((2.0, -3.0, 0.4), (4.0, -1.2, 1.6), ((-4.0, 1.0),))
    return list(volumes(field, [-3.0, 0.0, 1.0], resolution=20))


def exact(volume):
    axes = [
        low + volume.grid.spacing * np.arange(n) for low, n in zip(volume.grid.lower, volume.grid.counts, strict=True)
    ]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return 3 * (np.linalg.norm(x - CENTER, axis=-1) - radius(volume.time))


def test_a_grid_has_cubic_cells_and_its_box_in_the_middle():
    grid = Grid.over(Box((0.0, 0.0), (1.0, 0.55)), resolution=10)
    assert grid.counts == (11, 7) and grid.spacing == 0.1
    assert np.allclose(grid.lower, (0, -0.025)) and np.allclose(grid.points(np.array([[10, 6]])), [[1, 0.575]])
    with pytest.raises(ValueError, match=r"Grid.over\(resolution=1\): at least 2 cells"):
        Grid.over(Box((0.0,), (1.0,)), resolution=1)


def test_volumes_hold_the_values_of_the_field(sphere):
    assert [v.time for v in sphere] == [-3.0, 0.0, 1.0] and not any(v.is_empty for v in sphere)
    for volume in sphere:
        assert volume.values.shape == (21, 19, 13) and np.allclose(volume.values, exact(volume), atol=1e-6)


def test_npz_holds_the_values_and_where_and_when_they_are(sphere, tmp_path):
    write_npz(sphere[1], tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as data:
        grid = Grid(tuple(data["lower"].tolist()), float(data["spacing"]), data["values"].shape)
        assert np.allclose(data["values"], exact(Volume(float(data["time"]), data["values"], grid)), atol=1e-6)
        assert data["time"] == 0 and data["values"].dtype == np.float32


def test_a_metaimage_is_read_by_its_header(sphere, tmp_path):
    write_mhd(sphere[1], tmp_path / "a.mhd")
    header = dict(line.split(" = ", 1) for line in (tmp_path / "a.mhd").read_text().splitlines())
    assert header["ElementType"] == "MET_FLOAT" and header["BinaryDataByteOrderMSB"] == "False"
    assert list(header)[-1] == "ElementDataFile" and header["Comment"].endswith("time = 0.0")
    counts = [int(word) for word in header["DimSize"].split()]
    raw = np.fromfile(tmp_path / header["ElementDataFile"], "<f4").reshape(counts[::-1]).T
    grid = Grid(tuple(map(float, header["Offset"].split())), float(header["ElementSpacing"].split()[0]), tuple(counts))
    assert np.allclose(raw, exact(Volume(0.0, raw, grid)), atol=1e-6)


def test_vtk_reads_the_metaimage(sphere, tmp_path):
    vtk = pytest.importorskip("vtk", reason="vtk is not installed")
    write_mhd(sphere[2], tmp_path / "a.mhd")
    reader = vtk.vtkMetaImageReader()
    reader.SetFileName(str(tmp_path / "a.mhd"))
    reader.Update()
    image = reader.GetOutput()
    assert image.GetDimensions() == (21, 19, 13) and np.allclose(image.GetOrigin(), sphere[2].grid.lower)
    contour = vtk.vtkFlyingEdges3D()
    contour.SetInputData(image)
    contour.SetValue(0, 0.0)
    contour.Update()
    points = np.array([contour.GetOutput().GetPoint(i) for i in range(contour.GetOutput().GetNumberOfPoints())])
    assert np.allclose(np.linalg.norm(points - CENTER, axis=1), radius(1.0), atol=5e-3)


def test_a_plane_field_has_plane_volumes(tmp_path):
    (volume,) = volumes(growing(space=2), [0.0], resolution=8)
    assert volume.values.shape == (9, 9) and volume.values[4, 4] == -1.5
    write_mhd(volume, tmp_path / "a.mhd")
    assert "NDims = 2\n" in (tmp_path / "a.mhd").read_text()


def test_values_agree_with_the_field(generator):
    field = placed(3, 1)
    x = field.box.uniform(50, generator=generator)
    assert np.allclose(values_at(field, x.numpy(), 3.0), field(x, x.new_full((50, 1), 3.0)).detach().numpy())


def test_the_same_volume_gives_the_same_bytes_at_another_time_of_day(sphere, tmp_path, monkeypatch):
    write_npz(sphere[0], tmp_path / "a.npz")
    monkeypatch.setattr(time, "time", lambda: 2e9)
    write_npz(sphere[0], tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_what_has_no_place_is_refused(sphere, tmp_path):
    with pytest.raises(ValueError, match="volumes.*the field has no box"):
        next(volumes(siren(3)))
    with pytest.raises(ValueError, match="volumes: the field moves"):
        next(volumes(placed(3, 1)))
    for write in (write_npz, write_mhd):
        with pytest.raises(FileNotFoundError, match="no folder"):
            write(sphere[0], tmp_path / "no" / "a.x")
