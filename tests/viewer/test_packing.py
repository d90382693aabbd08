import numpy as np
import pytest

from levelflow.boxes import Frame
from levelflow.viewer.packing import pack, unpack
from levelflow.viewer.viewed import Surface, ViewedField
from tests.export.moving import growing, radius

CENTER = (3.0, -2.0, 1.0)
FRAME = Frame(CENTER, 2.0)


def seen(space=3):
    return ViewedField(growing(CENTER, space=space), name="").surface((0.5,), resolution=24)


@pytest.mark.parametrize(("compact", "tolerance"), [(False, 1e-7), (True, 1 / 60_000)])
def test_what_is_packed_comes_out_again_in_the_units_of_the_page(compact, tolerance):
    surface = seen()
    header, arrays = unpack(pack(surface, FRAME, compact=compact))
    assert header["time"] == [0.5] and header["note"] == ""
    assert (arrays["index"] == surface.mesh.faces).all()
    assert np.allclose(arrays["position"], (surface.mesh.vertices - CENTER) / 2, atol=tolerance)
    assert np.allclose(arrays["normal"], surface.mesh.normals, atol=0.004 if compact else 1e-6)
    low, high = header["ranges"]["curvature"]
    assert (low, high) == pytest.approx(tuple(np.quantile(surface.quantities["curvature"], (0.02, 0.98))))
    clipped = surface.quantities["curvature"].clip(low, high)
    assert np.allclose(arrays["curvature"].clip(low, high), clipped, atol=(high - low) / 500 + 1e-6)
    assert np.allclose(arrays["speed"], surface.quantities["speed"])


def test_compact_is_half_as_large_and_arrays_are_aligned():
    surface = seen()
    exact, compact = pack(surface, FRAME), pack(surface, FRAME, compact=True)
    assert len(compact) < 0.75 * len(exact)
    for data in (exact, compact):
        assert int.from_bytes(data[4:8], "little") % 4 == 0
        assert all(row["offset"] % 4 == 0 for row in unpack(data)[0]["arrays"])


def test_a_curve_is_a_ribbon_in_the_plane():
    surface = seen(space=2)
    _, arrays = unpack(pack(surface, Frame(CENTER[:2], 2.0)))
    position, index = arrays["position"], arrays["index"]
    assert len(index) == 2 * len(surface.mesh.faces) and (position[:, 2] == 0).all()
    assert np.allclose(np.linalg.norm(position[:, :2], axis=1), radius(0.5) / 2, atol=0.01)
    a, b, c = np.moveaxis(position[index], 1, 0)
    assert (np.cross(b - a, c - a)[:, 2] != 0).all()
    assert (arrays["normal"] == [0, 0, 1]).all() and len(arrays["curvature"]) == len(position)


def test_an_empty_surface_is_its_note():
    header, arrays = unpack(pack(Surface((1.0,), None, {}, "gone"), FRAME))
    assert header["note"] == "gone" and arrays == {}


def test_wrong_bytes_are_refused():
    with pytest.raises(ValueError, match=r"unpack: the bytes start with b'ply\\n', not with b'LVF1'"):
        unpack(b"ply\nformat")
    data = pack(seen(), FRAME)
    for end in (40, len(data) - 8):
        with pytest.raises(ValueError, match=f"unpack: the {end} bytes are cut off"):
            unpack(data[:end])
