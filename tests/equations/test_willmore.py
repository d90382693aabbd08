"""Willmore flow against what stands still under it, circles that grow, and the variation of the energy itself."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from levelflow.curvature import total_curvature
from levelflow.equations import MeanCurvature, Willmore
from levelflow.jets import Jet
from tests.fields import Explicit, differentiated, points


def with_curvature(function: Callable[[Tensor, Tensor], Tensor], x: Tensor, t: Tensor) -> Jet:
    """The jet of a function, and beside it that of its curvature: four derivatives by automatic differentiation."""

    def kappa(x: Tensor, t: Tensor) -> Tensor:
        return total_curvature(differentiated(function, x, t))

    return replace(differentiated(function, x, t), curvature=differentiated(kappa, x, t))


def torus(major: float, minor: float) -> Callable[[Tensor, Tensor], Tensor]:
    return lambda x, t: ((x[:, :2].norm(dim=1) - major) ** 2 + x[:, 2] ** 2).sqrt() - minor


def on_torus(major: float, minor: float, n: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    u, v = 2 * math.pi * torch.rand(2, n, generator=generator, dtype=torch.float64)
    rho = major + minor * v.cos()
    return torch.stack([rho * u.cos(), rho * u.sin(), minor * v.sin()], dim=1), v


def test_spheres_of_any_size_stand_still(generator: torch.Generator) -> None:
    x = torch.randn(50, 3, generator=generator, dtype=torch.float64)
    jet = with_curvature(lambda x, t: (x * x).sum(1) - 0.3, x, x.new_zeros(50, 1))
    assert Willmore(2.0).speed(x, x.new_zeros(50, 1), jet).abs().max() < 1e-10


def test_the_torus_of_clifford_stands_still_and_others_go_towards_it(generator: torch.Generator) -> None:
    minor = 0.3
    x, v = on_torus(math.sqrt(2) * minor, minor, 100, generator)
    t = x.new_zeros(100, 1)
    still = Willmore(1.0).speed(x, t, with_curvature(torus(math.sqrt(2) * minor, minor), x, t))
    assert still.abs().max() < 1e-9
    # The descent of the energy lowers it: that of a thinner torus falls as it gets thicker on the whole.
    x, v = on_torus(2 * minor, minor, 2000, generator)
    t = x.new_zeros(2000, 1)
    thin = Willmore(1.0).speed(x, t, with_curvature(torus(2 * minor, minor), x, t))
    weights = 2 + v.cos()
    assert (thin * weights).sum() > 0


def test_the_speed_is_the_descent_of_the_energy(generator: torch.Generator) -> None:
    # E(eps) of the torus with its tube widened by eps phi, against the integral of -v phi.
    major, minor, n = 1.0, 0.4, 400
    v = 2 * math.pi * torch.arange(n, dtype=torch.float64) / n
    phi = 1 + 0.3 * v.cos() + 0.2 * (2 * v).cos()

    def energy(eps: float) -> float:
        r = torch.fft.fft(minor + eps * phi)
        wave = 1j * torch.fft.fftfreq(n, 1 / n, dtype=torch.float64)
        curve = torch.fft.ifft(r).real
        x, z = major + curve * v.cos(), curve * v.sin()
        d = lambda y, k: torch.fft.ifft(wave**k * torch.fft.fft(y)).real  # noqa: E731
        g = (d(x, 1) ** 2 + d(z, 1) ** 2).sqrt()
        kappa = (d(x, 1) * d(z, 2) - d(z, 1) * d(x, 2)) / g**3 + d(z, 1) / (g * x)
        return float((kappa**2 / 4 * 2 * math.pi * x * g).mean() * 2 * math.pi)

    x = torch.stack([major + minor * v.cos(), 0 * v, minor * v.sin()], dim=1)
    t = x.new_zeros(n, 1)
    speed = Willmore(1.0).speed(x, t, with_curvature(torus(major, minor), x, t))
    area = 2 * math.pi * x[:, 0] * minor
    descent = -float((speed.detach() * phi * area).mean() * 2 * math.pi)
    assert (energy(1e-4) - energy(-1e-4)) / 2e-4 == pytest.approx(descent, rel=1e-5)
    assert energy(0.0) == pytest.approx(math.pi**2 * 2.5**2 / math.sqrt(2.5**2 - 1), rel=1e-9)


def test_a_circle_grows_as_the_root_of_the_root() -> None:
    rate = 0.7

    def growing(x: Tensor, t: Tensor) -> Tensor:
        return (x.norm(dim=1) ** 4 - rate * t[:, 0]).sqrt().sqrt() - 0.3

    field = Explicit(growing, 2, 1)
    x, t = points(field, 200)
    x = 0.5 + x.abs()
    t = 0.1 * t
    jet = with_curvature(growing, x, t)
    assert Willmore(rate).residual(x, t, jet).abs().max() < 1e-11
    assert Willmore(2 * rate).residual(x, t, jet).abs().min() > 1e-3


def test_speeds_of_second_and_fourth_order_add_up(generator: torch.Generator) -> None:
    x = torch.randn(20, 3, generator=generator, dtype=torch.float64)
    t = x.new_zeros(20, 1)
    jet = with_curvature(lambda x, t: (x**4).sum(1) - 0.3, x, t)
    both = Willmore(0.2) + MeanCurvature(0.1)
    assert both.bends
    assert torch.allclose(both.speed(x, t, jet), Willmore(0.2).speed(x, t, jet) + MeanCurvature(0.1).speed(x, t, jet))


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan])
def test_a_rate_that_is_not_positive_is_refused(rate: float) -> None:
    with pytest.raises(ValueError, match=rf"Willmore\(rate={rate:g}\): the rate must be positive"):
        Willmore(rate)


def test_a_jet_without_the_curvature_is_refused() -> None:
    x = torch.ones(3, 2, dtype=torch.float64)
    jet = differentiated(lambda x, t: x.norm(dim=1), x, x.new_zeros(3, 1))
    with pytest.raises(ValueError, match="says nothing of the derivatives of the curvature"):
        Willmore(1.0).speed(x, x.new_zeros(3, 1), jet)
