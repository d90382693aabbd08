"""Flows that keep the volume: to rounding, on closed meshes, on films and on several bodies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from levelflow.flows import Flow, MeanCurvature, NormalOffset, Prescribed, VolumePreserving
from levelflow.flows.normals import smooth_normals
from levelflow.shapes import Mesh
from tests.flows.examples import after, arc, ball, extracted, joined, moved, polygon, ring


def enclosed(curve: Mesh) -> float:
    """The area under the open curve of `arc`."""
    x, y = curve.vertices.T
    return float((-np.diff(x) * (y[1:] + y[:-1]) / 2).sum())


@pytest.mark.parametrize(
    "mesh",
    [
        extracted(lambda x: (x[:, 0] ** 2 / 0.8**2 + x[:, 1] ** 2 / 0.3**2).sqrt() - 1, 24, space=2),
        ring(20),
        joined(ball(3, 10), moved(ball(3, 8, radius=0.3), np.array([2.0, 0, 0]))),
    ],
    ids=["ellipse", "torus", "two spheres"],
)
def test_the_volume_stays_and_the_area_sinks(mesh: Mesh) -> None:
    flow, now = VolumePreserving(MeanCurvature(0.1)), mesh
    for _ in range(5):
        before, now = now, moved(now, flow.displacement(now, 0.02, time=0.0))
        assert abs(now.volume / mesh.volume - 1) < 1e-10
        assert now.area < before.area


def test_a_flow_far_from_keeping_it() -> None:
    mesh = ball(3, 12)
    result = moved(mesh, VolumePreserving(Prescribed((3, 0, 0)) + NormalOffset(0.2)).displacement(mesh, 1.0, time=0.0))
    assert result.volume == pytest.approx(mesh.volume, rel=1e-10)
    assert np.allclose(result.vertices, mesh.vertices + [3, 0, 0], atol=1e-9)


def test_to_first_order_it_takes_the_mean_away() -> None:
    mesh = extracted(lambda x: (x[:, 0] ** 2 / 0.8**2 + x[:, 1] ** 2 / 0.3**2).sqrt() - 1, 40, space=2)
    dt = 1e-5
    plain, kept = (
        flow.displacement(mesh, dt, time=0.0) / dt
        for flow in (MeanCurvature(0.1), VolumePreserving(MeanCurvature(0.1)))
    )
    mean = ((plain - kept) * smooth_normals(mesh)).sum(1)
    # The curvature of a closed curve integrates to 2 pi.
    assert np.allclose(mean, -0.1 * 2 * np.pi / mesh.area, rtol=1e-2)


def test_an_ellipse_becomes_the_circle_of_its_area() -> None:
    mesh = extracted(lambda x: (x[:, 0] ** 2 / 0.8**2 + x[:, 1] ** 2 / 0.3**2).sqrt() - 1, 30, space=2)
    result = after(VolumePreserving(MeanCurvature(1.0)), mesh, until=1.5, steps=60)
    radii = np.linalg.norm(result.vertices - result.box.center, axis=1)
    assert radii.std() < 2e-3
    assert radii.mean() == pytest.approx((0.8 * 0.3) ** 0.5, rel=5e-3)


def test_a_film_on_a_wire_becomes_a_cap() -> None:
    """A curve that is held at its ends and keeps the area under it: an arc of a circle, as the steps get shorter."""
    mesh, errors = arc(20), []
    for steps in (40, 160):
        result = after(VolumePreserving(MeanCurvature(1.0)), mesh, until=2.0, steps=steps)
        assert enclosed(result) == pytest.approx(enclosed(mesh), rel=1e-9)
        assert result.vertices[[0, -1]].tolist() == mesh.vertices[[0, -1]].tolist()
        x, y = result.vertices.T
        fit, *_ = np.linalg.lstsq(np.stack([2 * x, 2 * y, np.ones_like(x)], axis=1), x**2 + y**2, rcond=None)
        radii = np.hypot(x - fit[0], y - fit[1])
        errors.append(np.ptp(radii) / radii.mean())
    assert errors[1] < 0.01
    assert errors[1] < 0.4 * errors[0]


@dataclass(frozen=True)
class Mirror(Flow):
    """What no short step does: the mesh is turned inside out."""

    def displacement(self, mesh: Mesh, dt: float, *, time: float) -> np.ndarray:
        return mesh.vertices * [-2.0, 0.0]


def test_where_no_offset_helps_it_says_so() -> None:
    with pytest.raises(ValueError, match=r"Mirror.*: the volume changes by -6\.\d+ of 3\.\d+, .* a shorter dt"):
        VolumePreserving(Mirror()).displacement(polygon(100), 1.0, time=0.0)
    roof = Mesh([[0.0, 0, 0], [1, 0, 0], [1, 1, 1], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    with pytest.raises(ValueError, match=r"here 4 of 4"):
        VolumePreserving(NormalOffset(1.0)).displacement(roof, 1.0, time=0.0)


def test_what_is_no_flow(unchecked: None) -> None:
    with pytest.raises(TypeError, match=r"flows.VolumePreserving\(0.1\): this is no flow"):
        VolumePreserving(0.1)  # type: ignore[arg-type]
