"""Normals and curvatures of surfaces whose geometry is known, whatever the field that has them as a zero set."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from levelflow.curvature import (
    gauss_curvature,
    gradient_norm,
    mean_curvature,
    normal,
    principal_curvatures,
    squared_curvature,
    surface_laplacian,
    total_curvature,
)
from levelflow.jets import Jet
from tests.fields import Explicit, points, siren

Function = Callable[[Tensor], Tensor]


def jet_of(function: Function, x: Tensor) -> Jet:
    return Explicit(lambda x, t: function(x), x.shape[1]).jet(x, order=2)


def warped(function: Function) -> Function:
    """A field with the same zero set, whose gradient has any length and whose Hessian is another."""
    return lambda x: (1.5 + torch.sin(3 * x[:, 0] + x[:, 1])) * torch.sinh(function(x))


WARPS = pytest.mark.parametrize("warp", [lambda f: f, warped], ids=["distance", "warped"])


def on_circle(n: int, radius: float) -> tuple[Tensor, Tensor]:
    """Points of a circle in the plane, and their angles."""
    angle = torch.linspace(0.1, 2 * math.pi, n, dtype=torch.float64)
    return radius * torch.stack([angle.cos(), angle.sin()], dim=1), angle


def on_sphere(n: int, generator: torch.Generator) -> Tensor:
    return torch.nn.functional.normalize(torch.randn(n, 3, generator=generator, dtype=torch.float64), dim=1)


def is_close(found: Tensor, exact: Tensor | float, tolerance: float = 1e-11) -> bool:
    return bool((found - exact).abs().max() < tolerance)


@WARPS
def test_a_sphere_is_curved_by_one_over_r_in_every_direction(
    warp: Callable[[Function], Function], generator: torch.Generator
) -> None:
    n = on_sphere(50, generator)
    jet = jet_of(warp(lambda x: x.norm(dim=1) - 0.7), 0.7 * n)
    assert is_close(normal(jet), n)
    assert is_close(total_curvature(jet), 2 / 0.7)
    assert is_close(mean_curvature(jet), 1 / 0.7)
    assert is_close(gauss_curvature(jet), 1 / 0.49)
    # Half of the digits are lost where the two curvatures agree: they are the roots of a quadratic.
    assert is_close(principal_curvatures(jet), 1 / 0.7, 1e-6)


@WARPS
def test_a_cylinder_is_curved_around_and_not_along(warp: Callable[[Function], Function]) -> None:
    around, angle = on_circle(40, 0.4)
    x = torch.cat([around, torch.cos(5 * angle)[:, None]], dim=1)
    jet = jet_of(warp(lambda x: x[:, :2].norm(dim=1) - 0.4), x)
    assert is_close(total_curvature(jet), 2.5)
    assert is_close(mean_curvature(jet), 1.25)
    assert is_close(gauss_curvature(jet), 0)
    assert is_close(principal_curvatures(jet), torch.tensor([0.0, 2.5]))


@WARPS
def test_a_torus_has_the_curvatures_of_its_formula(warp: Callable[[Function], Function]) -> None:
    major, minor = 1.0, 0.4
    _, around = on_circle(60, major)
    angle = 7 * around
    out = major + minor * angle.cos()
    x = torch.stack([out * around.cos(), out * around.sin(), minor * angle.sin()], dim=1)
    jet = jet_of(
        warp(lambda x: torch.hypot(torch.hypot(x[:, 0], x[:, 1]) - major, x[:, 2]) - minor),
        x,
    )
    ring = angle.cos() / out
    assert is_close(principal_curvatures(jet), torch.stack([ring, torch.full_like(ring, 1 / minor)], dim=1), 1e-10)
    assert is_close(mean_curvature(jet), (ring + 1 / minor) / 2)
    assert is_close(gauss_curvature(jet), ring / minor)


@WARPS
@pytest.mark.parametrize("direction", [(0.6, 0.8), (1.0, 2.0, -2.0)])
def test_a_plane_is_flat(
    direction: tuple[float, ...], warp: Callable[[Function], Function], generator: torch.Generator
) -> None:
    n = torch.nn.functional.normalize(torch.tensor(direction, dtype=torch.float64), dim=0)
    x = torch.randn(30, len(direction), generator=generator, dtype=torch.float64)
    x = x - (x @ n)[:, None] * n
    jet = jet_of(warp(lambda x: x @ n), x)
    assert is_close(normal(jet), n)
    assert is_close(mean_curvature(jet), 0)
    assert is_close(principal_curvatures(jet), 0, 1e-6)


@WARPS
def test_a_circle_has_one_curvature(warp: Callable[[Function], Function]) -> None:
    x, _ = on_circle(40, 0.3)
    jet = jet_of(warp(lambda x: x.norm(dim=1) - 0.3), x)
    assert is_close(normal(jet), x / 0.3)
    for curvature in (total_curvature(jet), mean_curvature(jet), principal_curvatures(jet)[:, 0]):
        assert is_close(curvature, 1 / 0.3)
    assert principal_curvatures(jet).shape == (40, 1)


def test_a_hyperbolic_paraboloid_bends_both_ways_at_its_saddle() -> None:
    jet = jet_of(lambda x: x[:, 2] - (3 * x[:, 0] ** 2 - x[:, 1] ** 2) / 2, torch.zeros(1, 3, dtype=torch.float64))
    # Over the graph the normal points up, away from the ground, and so a graph that bends up has curvature -3.
    assert is_close(principal_curvatures(jet), torch.tensor([[-3.0, 1.0]]))
    assert is_close(mean_curvature(jet), -1)
    assert is_close(gauss_curvature(jet), -3)


def test_the_total_curvature_is_the_divergence_of_the_normal(generator: torch.Generator) -> None:
    field = siren(3)
    x = torch.rand(20, 3, generator=generator, dtype=torch.float64).requires_grad_()
    n = normal(field.jet(x, order=1))
    divergence = sum(torch.autograd.grad(n[:, i].sum(), x, retain_graph=True)[0][:, i] for i in range(3))
    kappa = total_curvature(field.jet(x, order=2))
    assert ((kappa - divergence).abs() < 1e-11 * kappa.abs().clamp_min(1)).all()


def test_the_principal_curvatures_are_the_eigenvalues_of_the_shape_operator(generator: torch.Generator) -> None:
    jet = siren(3).jet(torch.rand(40, 3, generator=generator, dtype=torch.float64), order=2)
    n = normal(jet)
    tangent = torch.eye(3, dtype=torch.float64) - n[:, :, None] * n[:, None, :]
    operator = tangent @ (jet.hessian / gradient_norm(jet)[:, None, None]) @ tangent
    values = torch.linalg.eigvalsh(operator)
    rest = torch.gather(values, 1, values.abs().argsort(dim=1)[:, 1:].sort(dim=1).values)
    found = principal_curvatures(jet)
    assert ((found - rest).abs() < 1e-9 * rest.abs().amax(1, keepdim=True)).all()


def test_where_the_gradient_vanishes_the_normal_is_zero_and_training_goes_on() -> None:
    jet = jet_of(lambda x: (x * x).sum(1), torch.zeros(1, 3, dtype=torch.float64))
    assert (normal(jet) == 0).all()
    slope = torch.zeros(1, 3, requires_grad=True)
    gradient_norm(Jet(torch.zeros(1), slope, None, 3)).sum().backward()
    assert slope.grad is not None and slope.grad.isfinite().all()


def test_gauss_curvature_needs_a_surface_in_space() -> None:
    jet = jet_of(lambda x: x.norm(dim=1), torch.ones(1, 2, dtype=torch.float64))
    with pytest.raises(ValueError, match="the jet has 2 space coordinates; Gauss curvature needs 3"):
        gauss_curvature(jet)


def test_squared_curvature_is_the_sum_of_the_squares() -> None:
    field = Explicit(lambda x, t: (x**4).sum(1) + x[:, 0] * x[:, 1] - 0.4, 3)
    x, _ = points(field, 50)
    jet = field.jet(x, order=2)
    squares = (principal_curvatures(jet) ** 2).sum(1)
    assert torch.allclose(squared_curvature(jet), squares, rtol=1e-9)


def test_the_surface_laplacian_of_a_harmonic_on_a_sphere_is_that_of_its_degree() -> None:
    sphere = Explicit(lambda x, t: (x * x).sum(1) - 0.3, 3)
    # x y / r^2 is a spherical harmonic of degree 2, whatever it does across the spheres.
    harmonic = Explicit(lambda x, t: x[:, 0] * x[:, 1] * (1 + 3 * (x * x).sum(1)), 3)
    x, _ = points(sphere, 50)
    found = surface_laplacian(sphere.jet(x, order=2), harmonic.jet(x, order=2))
    assert torch.allclose(found, -6 * harmonic(x) / (x * x).sum(1), rtol=1e-9)
