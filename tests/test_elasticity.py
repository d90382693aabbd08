"""The energies of a shell: what rigid motions, scales and rolled plates cost, and that no parametrisation matters."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from levelflow.curvature import normal
from levelflow.elasticity import Shell, area_element, bending, stretching, thickening
from levelflow.fields import Deformed, Map
from levelflow.jets import Jet, identity
from levelflow.networks.invertible import InvertibleResNet
from tests.fields import differentiated, invertible, siren


def jet_of(function, x: Tensor) -> Jet:
    """The jet of a map of space, component by component."""
    parts = [differentiated(lambda x, t, i=i: function(x)[:, i], x, x.new_zeros(len(x), 0)) for i in range(x.shape[1])]
    return Jet(
        torch.stack([part.value for part in parts], dim=-1).detach(),
        torch.stack([part.first for part in parts], dim=-1).detach(),
        torch.stack([part.second for part in parts], dim=-1).detach(),
        x.shape[1],
    )


def drawn(space: int, generator: torch.Generator, n: int = 50) -> Tensor:
    return 2 * torch.rand(n, space, generator=generator, dtype=torch.float64) - 1


def rotation(space: int, generator: torch.Generator) -> Tensor:
    q = torch.linalg.qr(torch.randn(space, space, generator=generator, dtype=torch.float64))[0]
    q[:, 0] *= torch.linalg.det(q)
    return q


@pytest.mark.parametrize("space", [2, 3])
def test_a_rigid_motion_costs_nothing(space: int, generator: torch.Generator) -> None:
    x, gradient = drawn(space, generator), drawn(space, generator)
    q, shift = rotation(space, generator), drawn(space, generator, 1)
    jet = jet_of(lambda x: x @ q.T + shift, x)
    assert stretching(jet, gradient).max() < 1e-28
    assert bending(jet, gradient).max() < 1e-28
    assert thickening(jet, gradient).max() < 1e-28
    assert (area_element(jet, gradient) - 1).abs().max() < 1e-14


def test_an_invertible_network_that_moves_rigidly_costs_nothing_in_float32() -> None:
    network = InvertibleResNet(3)
    x = torch.rand(100, 3, generator=torch.Generator().manual_seed(0))
    assert Shell(1.0, 1.0).density(network.push(identity(x, x[:, :0], order=2)), x + 0.1).max() < 1e-12


@pytest.mark.parametrize("space", [2, 3])
@pytest.mark.parametrize("scale", [0.5, 1.5])
def test_a_uniform_scale_stretches_by_the_known_energy(space: int, scale: float, generator: torch.Generator) -> None:
    x, gradient = drawn(space, generator), drawn(space, generator)
    jet = jet_of(lambda x: x / scale, x)
    exact = (space - 1) * (1 - scale**-2) ** 2
    assert (stretching(jet, gradient) - exact).abs().max() < 1e-12
    assert bending(jet, gradient).max() < 1e-28
    assert (area_element(jet, gradient) - scale ** (1 - space)).abs().max() < 1e-12
    # Of a ball of radius 1 that has become one of radius `scale`, the energy in all.
    sphere = 2 * math.pi if space == 2 else 4 * math.pi
    total = Shell(2.0, 3.0, 0.0).density(jet, gradient) * sphere
    assert (total - 2 * exact * sphere * scale ** (space - 1)).abs().max() < 1e-10
    assert (thickening(jet, gradient) - (1 / scale - 1) ** 2).abs().max() < 1e-12


@pytest.mark.parametrize("space", [2, 3])
@pytest.mark.parametrize("r", [0.5, 2.0])
def test_a_plate_rolled_up_to_a_cylinder_bends_by_the_known_energy_and_does_not_stretch(
    space: int, r: float, generator: torch.Generator
) -> None:
    """The plate y = 0, of which f = y is the distance; a rod in the plane."""
    angle = math.pi * (drawn(1, generator)[:, 0] / 2)
    along = drawn(space - 2, generator, len(angle)) if space > 2 else angle.new_zeros(len(angle), 0)
    x = torch.cat([r * torch.stack([angle.sin(), angle.cos()], dim=1), along], dim=1)

    def unrolled(x: Tensor) -> Tensor:
        return torch.cat([torch.stack([r * torch.atan2(x[:, 0], x[:, 1]), x[:, :2].norm(dim=1) - r], 1), x[:, 2:]], 1)

    gradient = torch.eye(space, dtype=torch.float64)[1].expand(len(x), -1)
    jet = jet_of(unrolled, x)
    assert stretching(jet, gradient).max() < 1e-24
    assert (bending(jet, gradient) - r**-2).abs().max() < 1e-10
    assert thickening(jet, gradient).max() < 1e-24
    assert (area_element(jet, gradient) - 1).abs().max() < 1e-12
    assert (Shell(1.0, 0.5).density(jet, gradient) - 0.5 * r**-2).abs().max() < 1e-10


@pytest.mark.parametrize("space", [2, 3])
def test_bending_is_the_change_of_the_hessian_of_the_deformed_field(space: int, generator: torch.Generator) -> None:
    """Eq. 7 as it is written, with both Hessians, and eqs. 5 and 8 with all their matrices."""
    field, network = siren(space), invertible(space)
    x = drawn(space, generator)
    t = x.new_zeros(len(x), 0)
    jet = network.push(identity(x, t, order=2))
    at_rest, deformed = field.jet(jet.value, order=2), Deformed(field, network).jet(x, order=2)
    jacobian = jet.gradient.transpose(1, 2)
    m, n = normal(deformed), normal(at_rest)
    tangent = torch.eye(space, dtype=torch.float64) - m[:, :, None] * m[:, None]
    slope = at_rest.gradient.norm(dim=1)[:, None, None]

    def norm(change: Tensor) -> Tensor:
        return (tangent.mT @ change @ tangent).square().sum((1, 2))

    pulled = jacobian.mT @ at_rest.hessian @ jacobian
    written = norm((deformed.hessian - pulled) / slope)
    assert torch.allclose(bending(jet, at_rest.gradient), written, rtol=1e-9)
    written = norm(torch.eye(space, dtype=torch.float64) - jacobian.mT @ jacobian)
    assert torch.allclose(stretching(jet, at_rest.gradient), written, rtol=1e-9)
    written = (deformed.gradient.norm(dim=1) / at_rest.gradient.norm(dim=1) - 1) ** 2
    assert torch.allclose(thickening(jet, at_rest.gradient), written, rtol=1e-9)
    written = torch.linalg.det(jacobian @ tangent + n[:, :, None] * m[:, None]).abs()
    assert torch.allclose(area_element(jet, at_rest.gradient), written, rtol=1e-9)


@pytest.mark.parametrize("space", [2, 3])
def test_energies_do_not_depend_on_the_length_of_the_gradient(space: int, generator: torch.Generator) -> None:
    x, gradient = drawn(space, generator), drawn(space, generator)
    jet = invertible(space).push(identity(x, x[:, :0], order=2))
    for energy in (stretching, bending, thickening, area_element):
        assert torch.allclose(energy(jet, gradient), energy(jet, 7 * gradient), rtol=1e-9)


def test_a_density_that_resists_nothing_needs_no_derivatives() -> None:
    shells = {0: Shell(0.0, 0.0, 0.0), 1: Shell(1.0, 0.0), 2: Shell(0.0, 1.0)}
    assert {order: shell.order for order, shell in shells.items()} == {0: 0, 1: 1, 2: 2}
    x = torch.ones(3, 2)
    assert shells[0].density(identity(x, x[:, :0], order=0), x).tolist() == [0.0] * 3
    network: Map = invertible(2).float()
    assert torch.isfinite(shells[1].density(network.push(identity(x, x[:, :0], order=1)), x)).all()


@pytest.mark.parametrize("wrong", [{"stretch": -1.0}, {"bend": math.inf}, {"stretch": math.nan}, {"thicken": -0.1}])
def test_coefficients_are_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"`Shell\(.*must be numbers that are not negative"):
        Shell(**wrong)
