"""Gradient descent of energies: the area gives mean curvature, the volume an offset, others are one's own."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from levelflow.flows import Descent, MeanCurvature, area, dirichlet
from levelflow.flows.laplacian import Laplacian
from levelflow.shapes import Mesh
from tests.flows.examples import after, arc, ball, icosphere, moved, polygon, tube


def minus_volume(vertices: Tensor, faces: Tensor) -> Tensor:
    """Minus the enclosed volume, or area."""
    corners = vertices[faces]
    return -torch.linalg.det(corners).sum() / math.factorial(vertices.shape[1])


@pytest.mark.parametrize("mesh", [polygon(30), arc(), icosphere(2), ball(3, 12), tube()], ids=repr)
def test_energies_are_areas(mesh: Mesh) -> None:
    vertices, faces = torch.tensor(mesh.vertices), torch.tensor(mesh.faces)
    assert float(area(vertices, faces)) == pytest.approx(mesh.area)
    double = 2 * mesh.area if mesh.vertices.shape[1] == 3 else mesh.area
    assert float(dirichlet(vertices, faces)) == pytest.approx(double, rel=0.02)


@pytest.mark.parametrize("mesh", [polygon(30), arc(), icosphere(2)], ids=repr)
def test_gradients_are_the_laplacian_of_the_positions(mesh: Mesh) -> None:
    expected = Laplacian.of(mesh.vertices, mesh.faces).stiffness @ mesh.vertices
    for energy, factor in ((area, 1), (dirichlet, 2)):
        vertices = torch.tensor(mesh.vertices, requires_grad=True)
        energy(vertices, torch.tensor(mesh.faces)).backward()
        assert np.allclose(vertices.grad, factor * expected, atol=1e-12)


@pytest.mark.parametrize("mesh", [polygon(30), icosphere(2), tube()], ids=repr)
@pytest.mark.parametrize(("energy", "factor"), [(area, 1), (dirichlet, 2)])
def test_descent_of_the_area_is_mean_curvature(mesh: Mesh, energy: object, factor: int) -> None:
    """With the reach that makes it implicit, sqrt(rate dt), it is the same step."""
    rate, dt = 0.1, 0.02
    step = MeanCurvature(rate).displacement(mesh, dt, time=0.0)
    descent = Descent(energy, rate / factor, reach=math.sqrt(rate * dt), fixed_boundary=True)  # type: ignore[arg-type]
    assert np.allclose(descent.displacement(mesh, dt, time=0.0), step, atol=1e-12)


def test_a_sphere_shrinks_by_descent_of_its_area() -> None:
    """On an extracted sphere, with the reach that is chosen by itself."""
    result = after(Descent(area, 0.1), ball(3, 20), until=0.3, steps=40)
    radii = np.linalg.norm(result.vertices, axis=1)
    assert radii.mean() == pytest.approx(math.sqrt(0.25 - 4 * 0.1 * 0.3), rel=0.015)


@pytest.mark.parametrize("reach", [0.0, None])
def test_the_speed_does_not_depend_on_the_resolution(reach: float | None) -> None:
    """Without a mass the gradient would be four times as large on edges twice as long."""
    speeds = []
    for subdivisions in (2, 3):
        mesh = icosphere(subdivisions, radius=0.5)
        step = Descent(area, 0.1, reach=reach).displacement(mesh, 1e-3, time=0.0) / 1e-3
        speeds.append(np.linalg.norm(step, axis=1).mean())
    assert speeds == pytest.approx([0.4, 0.4], rel=0.05)
    assert speeds[1] == pytest.approx(speeds[0], rel=0.04)


@pytest.mark.parametrize("space", [2, 3])
def test_an_energy_of_ones_own(space: int) -> None:
    """The more volume the better: every point moves along its normal, at the rate."""
    mesh = polygon(100) if space == 2 else icosphere(3)
    result = moved(mesh, Descent(minus_volume, 0.3, reach=0.0).displacement(mesh, 0.5, time=0.0))
    assert np.linalg.norm(result.vertices, axis=1).mean() == pytest.approx(1.15, rel=2e-3)


def test_a_force_on_one_point_is_spread_over_the_reach() -> None:
    mesh = icosphere(3)
    tip = int(mesh.vertices[:, 2].argmax())
    pull = Descent(lambda vertices, faces: -vertices[tip, 2], 0.1, reach=0.2)
    step = pull.displacement(mesh, 0.1, time=0.0)
    away = np.linalg.norm(mesh.vertices - mesh.vertices[tip], axis=1)
    near = step[(away > 0.1) & (away < 0.2), 2]
    assert near.min() > 0.2 * step[tip, 2] > 0
    # What is spread is the force: the mass times the displacement sums up to it.
    mass = Laplacian.of(mesh.vertices, mesh.faces).mass
    assert (mass * step[:, 2]).sum() == pytest.approx(0.1 * 0.1)


def test_boundaries_are_held_when_asked() -> None:
    mesh = tube()
    ends = np.abs(mesh.vertices[:, 2]) == 1
    assert np.abs(Descent(area, 0.1).displacement(mesh, 0.1, time=0.0)[ends]).min(0).max() > 0.01
    assert not Descent(area, 0.1, fixed_boundary=True).displacement(mesh, 0.1, time=0.0)[ends].any()


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan])
def test_a_rate_that_is_not_positive_is_refused(rate: float) -> None:
    with pytest.raises(ValueError, match=rf"Descent\(rate={rate:g}\): the rate must be positive"):
        Descent(area, rate)


def test_a_negative_reach_is_refused() -> None:
    with pytest.raises(ValueError, match=r"Descent\(reach=-1\): the reach is a length"):
        Descent(area, 1.0, reach=-1.0)


@pytest.mark.parametrize(
    ("energy", "message"),
    [
        (lambda vertices, faces: vertices.square().sum(1), r"the shape \(9,\); wanted is one number"),
        (lambda vertices, faces: vertices.detach().sum(), "does not depend on the vertices"),
        (
            lambda vertices, faces: (vertices[:, 1] * 0).sqrt().sum(),
            "not finite at 9 of 9 vertices, the first is vertex 0",
        ),
    ],
    ids=["a number for each vertex", "detached", "infinite"],
)
def test_energies_that_cannot_be_descended(energy: object, message: str) -> None:
    with pytest.raises(ValueError, match=f"Descent: .*{message}"):
        Descent(energy, 1.0).displacement(polygon(9), 0.1, time=0.0)  # type: ignore[arg-type]
