import numpy as np
import pytest
import torch

from levelflow import extract
from levelflow.export.normal_motion import carry, slopes
from tests.export.moving import GROWTH, growing, radius, splitting
from tests.fields import Explicit, placed


def directions(n, generator):
    x = torch.randn(n, 3, generator=generator, dtype=torch.float64).numpy()
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def test_the_velocity_of_a_growing_sphere_is_its_growth_along_the_normal(generator):
    n = directions(100, generator)
    local = slopes(growing(), radius(0.4) * n, 0.4)
    assert np.allclose(local.normals, n, atol=1e-12)
    assert np.allclose(local.velocities, GROWTH * n, atol=1e-12)
    assert np.allclose(local.distances, 0, atol=1e-12) and np.allclose(local.newton, 0, atol=1e-12)


def test_a_newton_step_reaches_a_sphere_from_anywhere_on_its_rays(generator):
    n = directions(100, generator)
    local = slopes(growing(), 0.8 * n, 0.0)
    assert np.allclose(0.8 * n + local.newton, radius(0) * n, atol=1e-12)
    assert np.allclose(local.distances, 0.8 - radius(0))


def test_what_has_no_gradient_has_no_velocity_and_what_has_no_time_no_rate():
    still = slopes(Explicit(lambda x, t: (x * x).sum(1) - t[:, 0] ** 2, 3, 1), np.zeros((2, 3)), 0.5)
    assert not still.velocities.any() and not still.newton.any() and not still.normals.any()
    assert not slopes(placed(3), np.ones((2, 3)), 0.0).rate.any()


@pytest.mark.parametrize(("start", "end"), [(0.0, 1.0), (1.0, -1.0), (0.3, 0.3)])
def test_points_of_a_growing_sphere_stay_on_their_rays(generator, start, end):
    n = directions(50, generator)
    carried = carry(growing(), radius(start) * n, start, end, step=0.1)
    assert carried.arrived.all()
    assert np.allclose(carried.points, radius(end) * n, atol=1e-9)


def test_steps_converge_with_an_order_above_three_where_the_surface_turns():
    """f = y - t sin 3x: the normals change with place and time."""

    def f(x, t):
        return x[:, 1] - t[:, 0] * torch.sin(3 * x[:, 0])

    field, x = Explicit(f, 2, 1), np.stack([np.linspace(-1, 1, 9), np.zeros(9)], 1)
    fine = carry(field, x, 0.0, 1.0, step=0.005).points
    coarse, half, quarter = (np.abs(carry(field, x, 0.0, 1.0, step=h).points - fine).max() for h in (0.1, 0.05, 0.025))
    assert np.log2(coarse / quarter) / 2 > 3 and quarter < half < coarse < 1e-4


def test_points_where_a_body_pinches_do_not_arrive():
    field = splitting()
    mesh = extract(field.at(0.0), resolution=32)
    carried = carry(field, mesh.vertices, 0.0, 0.7, step=0.1)
    waist = np.abs(mesh.vertices[:, 0]) < 0.05
    assert not carried.arrived[waist].all() and carried.arrived[np.abs(mesh.vertices[:, 0]) > 0.4].all()


def test_a_field_that_stands_still_carries_nothing():
    still = Explicit(lambda x, t: (x * x).sum(1) - 0.25 + 0 * t[:, 0], 3, 1)
    x = np.array([[0.5, 0, 0], [0, 0.5, 0]])
    assert np.array_equal(carry(still, x, 0.0, 1.0, step=0.1).points, x)
