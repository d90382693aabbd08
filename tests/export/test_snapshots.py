import numpy as np
import pytest

from levelflow import EmptyLevelSet
from levelflow.export.snapshots import check_times, snapshots
from tests.export.moving import GROWTH, growing, radius
from tests.fields import placed, siren


def test_snapshots_are_on_the_surface_with_its_normals_and_velocities():
    center = np.array([3.0, -2.0, 1.0])
    found = list(snapshots(growing(tuple(center)), [-2.5, 0.0, 1.0], resolution=32))
    assert [s.time for s in found] == [-2.5, 0.0, 1.0] and [s.is_empty for s in found] == [True, False, False]
    for s in found[1:]:
        n = (s.mesh.vertices - center) / radius(s.time)
        assert np.allclose(np.linalg.norm(n, axis=1), 1, atol=1e-4)
        assert np.allclose(s.mesh.normals, n, atol=2e-4)
        assert np.allclose(s.velocities, GROWTH * s.mesh.normals, atol=1e-12)
        assert s.mesh.volume > 0 and s.mesh.is_watertight and s.colours is None and s.uv is None


def test_a_static_field_has_one_snapshot_and_no_velocities():
    (only,) = snapshots(growing().at(0.5), resolution=16)
    assert only.time == 0 and only.velocities is None and abs(only.mesh.box.upper[0] - radius(0.5)) < 1e-6


def test_a_plane_curve_has_snapshots_too():
    (only,) = snapshots(growing(space=2), [0.0], resolution=32)
    assert only.mesh.faces.shape[1] == 2 and np.allclose(only.velocities, GROWTH * only.mesh.normals)


def test_snapshots_are_made_when_they_are_asked_for():
    steps = snapshots(growing(), [0.0, 1.0], resolution=8)
    assert next(steps).time == 0


def test_only_a_surface_that_is_nowhere_is_an_error():
    with pytest.raises(EmptyLevelSet, match=r"no surface at any of the times \[-3.0, -2.5\].*positive everywhere"):
        list(snapshots(growing(), [-3.0, -2.5], resolution=8))


@pytest.mark.parametrize(
    ("field", "times", "message"),
    [
        (growing(), [], r"the field moves from -4 to 1; say at which times"),
        (growing(), [0.0, 0.0], "must increase; sort them"),
        (growing(), [0.5, 0.0], "must increase; sort them"),
        (growing(), [0.0, 2.0], r"at\(2\): the field was solved for times from -4 to 1"),
        (growing().at(0.0), [0.0], "does not depend on time; leave the times out"),
        (placed(3, 2), [2.0], "has 2 times or parameters"),
        (siren(3, 1), [], "the field moves; say at which times"),
    ],
)
def test_times_that_are_not_those_of_the_field_are_refused(field, times, message):
    with pytest.raises(ValueError, match=message):
        check_times(field, times, call="snapshots")
