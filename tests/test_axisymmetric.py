"""The references against exact solutions and each other; what they say of the shapes of the suite and the demo."""

import math

import numpy as np
import pytest

from levelflow.shapes import Dumbbell, Sphere, Torus
from levelflow.suite import Tube
from levelflow.suite.energies import BENT_RING
from tests.axisymmetric import Neck, Revolved, bent_ring, collapse, pinch, ring


def dumbbell(n: int) -> Neck:
    """The neck and half of a ball of the demo's dumbbell; the other half of the ball is far from the neck."""
    return Neck(lambda z: np.maximum(0.12, np.sqrt(np.maximum(0.09 - (z - 0.5) ** 2, 0))), 0.5, n=n, stop=0.004)


def corrugated(depth: float, n: int) -> Neck:
    return Neck(lambda z: 0.3 - depth * np.cos(np.pi * z), 1.0, n=n, stop=0.004)


def test_a_cylinder_shrinks_like_a_circle():
    tube = Neck(lambda z: np.full_like(z, 0.3), 1.0, n=10, stop=0.01)
    assert abs(tube.pinch / 0.045 - 1) < 1e-6
    assert np.allclose(tube.radius(np.array([0.0, 0.4]), 0.02), math.sqrt(0.09 - 0.04), rtol=1e-6)


def test_a_sphere_in_the_half_plane_shrinks_with_second_order():
    errors = []
    for n in (25, 50):
        z, r = Revolved(Sphere(0.5), 0.7, 0.7, spacing=1 / n).run(0.04).profile()
        errors.append(float(((r * r + z * z).sqrt()[z < 0.2] / 0.3 - 1).abs().max()))
    assert errors[1] < 5e-4 and math.log2(errors[0] / errors[1]) > 1.5


def test_a_thin_ring_shrinks_like_a_circle():
    """Its parallels are so long that their curvature hardly counts: r^2 / 2."""
    assert abs(ring(10.0, 0.1) / 0.005 - 1) < 1e-4


@pytest.mark.parametrize(("depth", "truth"), [(0.1, 0.024153), (0.2, 0.006130)])
def test_pinch_times_of_corrugated_cylinders(depth, truth):
    assert abs(corrugated(depth, 200).pinch / truth - 1) < 2e-4
    assert abs(pinch(Revolved(Tube(0.3, depth, 1.2), 0.6, 1.0, spacing=0.02), last=0.05) / truth - 1) < 0.01


@pytest.mark.parametrize(("minor", "truth"), [(0.2, 0.020210), (0.3, 0.046136), (0.4, 0.083997), (0.5, 0.136644)])
def test_collapse_times_of_tori(minor, truth):
    assert abs(ring(1.0, minor) / truth - 1) < 1e-4
    flow = Revolved(Torus(1.0, minor), 1.2 + minor, 0.2 + minor, spacing=0.04)
    assert abs(collapse(flow, last=1.1 * truth) / truth - 1) < 0.005


@pytest.mark.slow
@pytest.mark.parametrize(("minor", "truth"), [(0.65, 0.1711), (0.7, 0.0816), (0.8, 0.02654)])
def test_closing_times_of_the_holes_of_tori(minor, truth):
    assert abs(ring(1.0, minor, n=128) / truth - 1) < 1e-3
    assert abs(pinch(Revolved(Torus(1.0, minor), 2.0, 1.0, spacing=0.02), last=0.2) / truth - 1) < 5e-3


def test_the_dumbbell_of_the_demo_pinches_at_0_00759():
    """The same time and profile from the front and from the level set, which has the whole balls."""
    front = dumbbell(250)
    assert abs(front.pinch / 0.0075904 - 1) < 1e-4
    assert abs(dumbbell(500).pinch / front.pinch - 1) < 1e-4
    flow = Revolved(Dumbbell(0.3, 1.0, 0.12), 0.4, 0.9, spacing=0.01)
    z, r = flow.run(0.006).profile()
    near = z < 0.5
    assert np.abs(r[near].numpy() - front.radius(z[near].numpy(), 0.006)).max() < 3e-4
    assert abs(pinch(flow, last=0.01) / front.pinch - 1) < 1e-3


def test_a_film_between_rings_too_far_apart_pinches_off_and_leaves_two():
    """As the suite says: the front as far as it goes, the level set with the same mask on to the two films."""

    def held(z):
        return (0.4 - abs(z)).clip(0, 0.05) / 0.05

    front = Neck(lambda z: np.full_like(z, 0.4), 0.6, n=300, stop=0.004, mask=held)
    assert abs(front.pinch / 0.114624 - 1) < 1e-4
    assert np.allclose(front.radius(np.array([0.0, 0.4, 0.5]), 0.05), [0.273302, 0.4, 0.4], atol=5e-5)
    flow = Revolved(Tube(0.4, 0.0, 0.6), 0.6, 0.6, spacing=0.02, mask=held)
    assert abs(pinch(flow, last=0.2) / front.pinch - 1) < 0.03
    flow.run(0.2)
    heights = [flow.on_axis(i) for i in range(len(flow.z))]
    film = float(flow.z[[value < 0 for value in heights].index(True)])
    assert abs(film - 0.376) < 0.02 and all(value < 0 for value in heights[-10:])


def test_a_film_within_the_critical_distance_comes_to_rest_as_a_catenoid():
    held = Neck(lambda z: 0.4 * np.cosh(z / 0.4) + 0.08 * np.clip(1 - (z / 0.25) ** 2, 0, None) ** 2, 0.5, n=200,
                stop=0.004, mask=lambda z: np.clip((0.25 - abs(z)) / 0.05, 0, 1), last=0.25)  # fmt: skip
    assert math.isnan(held.pinch)
    assert np.allclose(held.radius(np.array([0.0, 0.2]), 0.25), 0.4 * np.cosh([0.0, 0.5]), rtol=5e-4)


def test_what_does_not_happen_in_time_is_said():
    with pytest.raises(ValueError, match=r"time_of\(last=0.001\): the quantity is still -.*; wait longer"):
        pinch(Revolved(Sphere(0.5), 0.7, 0.7, spacing=0.1), last=0.001)


def test_a_torus_under_willmore_flow_tends_to_cliffords_and_the_suite_knows_its_way() -> None:
    start, middle, end = bent_ring(0.5, 0.25, [0.0, 0.001, 0.03], n=25)
    for row, t in ((start, 0.0), (middle, 0.001)):
        low, high, energy = BENT_RING[t]
        assert row == pytest.approx([low, high, np.pi * energy], rel=1e-4)
    assert start[2] == pytest.approx(np.pi**2 * 4 / np.sqrt(3))
    assert end[2] == pytest.approx(2 * np.pi**2, rel=1e-4)
    assert (end[1] + end[0]) / (end[1] - end[0]) == pytest.approx(np.sqrt(2), rel=1e-2)
