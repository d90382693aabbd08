import math

import numpy as np
import pytest

from levelflow import Box, Cuboid, EmptyLevelSet, Transported
from levelflow.equations import Rotation, Transport
from levelflow.export.normal_motion import Carried
from levelflow.export.snapshots import snapshots
from levelflow.export.tracking import TopologyChange, track
from tests.export.moving import GROWTH, growing, radius, splitting
from tests.fields import Explicit


def test_a_mesh_goes_with_a_growing_sphere_and_keeps_its_faces():
    first, *rest = track(growing(), [0.0, 0.3, 1.0], resolution=24)
    n = first.mesh.vertices / radius(0.0)
    for snapshot in rest:
        assert np.array_equal(snapshot.mesh.faces, first.mesh.faces)
        assert np.allclose(snapshot.mesh.vertices, radius(snapshot.time) * n, atol=1e-4)
        assert np.allclose(snapshot.velocities, GROWTH * snapshot.mesh.normals, atol=1e-9)
        assert snapshot.mesh.volume > 0


def test_the_carried_mesh_is_the_surface_that_is_there_until_it_splits():
    field, times = splitting(), [0.0, 0.1, 0.2]
    for carried, fresh in zip(track(field, times, resolution=32), snapshots(field, times, resolution=32), strict=True):
        assert abs(carried.mesh.volume / fresh.mesh.volume - 1) < 0.01
        assert np.allclose(carried.mesh.box.lower, fresh.mesh.box.lower, atol=0.01)


def test_a_mesh_turns_with_a_field_that_is_turned():
    """A quarter turn, tangential motion and all: every vertex is where the rotation brings it."""
    field = Transported(Transport(Rotation(math.pi / 2, axis=(0, 0, 1))), Cuboid((1.0, 0.4, 0.3)), until=1.0)
    first, last = track(field, [0.0, 1.0], resolution=32)
    x, y, z = first.mesh.vertices.T
    assert np.allclose(last.mesh.vertices, np.stack([-y, x, z], axis=1), atol=1e-12)


def test_a_plane_curve_is_carried_as_well():
    *_, last = track(growing(space=2), [0.0, 1.0], resolution=24)
    assert np.allclose(np.linalg.norm(last.mesh.vertices, axis=1), radius(1.0), atol=1e-6)


def test_a_mesh_does_not_follow_a_surface_that_splits_vanishes_or_joins():
    with pytest.raises(TopologyChange, match=r"does not arrive at t = 0.7: between t = 0.2 and then"):
        list(track(splitting(), [0.0, 0.2, 0.7], resolution=32))
    shrinking = Explicit(lambda x, t: (x * x).sum(1) - 0.25 + t[:, 0], 3, 1, box=Box((-1,) * 3, (1,) * 3, ((0, 1),)))
    with pytest.raises(TopologyChange, match="between t = 0 and then, the surface vanishes"):
        list(track(shrinking, [0.0, 0.5], resolution=24))


def test_a_body_that_appears_is_noticed():
    """A second ball is born away from the first, whose points all arrive."""

    def f(x, t):
        first = ((x - x.new_tensor([-0.5, 0, 0])) ** 2).sum(1) - 0.04
        return first * (((x - x.new_tensor([0.5, 0, 0])) ** 2).sum(1) - 0.08 * t[:, 0] + 0.04)

    field = Explicit(f, 3, 1, box=Box((-1,) * 3, (1,) * 3, ((0, 1),)))
    with pytest.raises(TopologyChange, match="the mesh has 1 bodies and Euler number 2; the surface has 2 bodies"):
        list(track(field, [0.0, 1.0], resolution=24))


def test_a_surface_that_outgrows_its_mesh_is_noticed():
    """A translated ball: normal velocities carry no point around it, and none gets to its front."""
    field = Explicit(
        lambda x, t: ((x - t * x.new_tensor([[2.0, 0, 0]])) ** 2).sum(1).sqrt() - 0.4, 3, 1,
        box=Box((-0.5,) * 3, (2.5, 0.5, 0.5), ((0, 1),)),
    )  # fmt: skip
    with pytest.raises(TopologyChange, match="a part of the surface, .* away, is not covered by the mesh"):
        list(track(field, [0.0, 1.0], resolution=48))


def test_a_mesh_that_turns_inside_out_is_noticed(monkeypatch):
    def mirrored(field, x, start, end, *, step):
        return Carried(x * [-1, 1, 1], np.ones(len(x), dtype=bool))

    monkeypatch.setattr("levelflow.export.tracking.carry", mirrored)
    with pytest.raises(TopologyChange, match=r"1e\+02 % of the mesh folds over"):
        list(track(growing(), [0.0, 0.001], resolution=24))


def test_what_has_nothing_to_carry_is_refused():
    with pytest.raises(ValueError, match="track: the field does not depend on time"):
        next(track(growing().at(0.0), [0.0]))
    with pytest.raises(EmptyLevelSet):
        next(track(growing(), [-3.0, 0.0], resolution=8))
    with pytest.raises(ValueError, match="track.*must increase"):
        next(track(growing(), [0.0, 0.0]))
