"""Invertible networks: their bounds, their inverses, and what they do to fields."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from levelflow.boxes import Box
from levelflow.curvature import mean_curvature
from levelflow.extraction import extract
from levelflow.fields import Deformed, Map
from levelflow.jets import Jet, identity
from levelflow.minimising import Budget, minimise
from levelflow.networks.invertible import Inverse, InvertibleResNet
from tests.fields import Explicit, Wave, differentiated, invertible

KINDS = [(1, 0), (2, 0), (3, 0), (2, 1), (3, 2)]


def drawn(space: int, time: int, generator: torch.Generator, n: int = 200) -> tuple[Tensor, Tensor]:
    """Points and times in [-1, 1]."""
    return tuple(2 * torch.rand(n, m, generator=generator, dtype=torch.float64) - 1 for m in (space, time))  # type: ignore[return-value]


def agree(found: Map, exact, x: Tensor, t: Tensor, tolerance: float = 1e-12) -> bool:
    """Whether the jet of a map is that of automatic differentiation of a function, component by component."""
    jet = found.push(identity(x, t, order=2))
    for i in range(found.space):
        part, truth = jet.component(i), differentiated(lambda x, t, i=i: exact(x, t)[:, i], x, t)
        for a, b in ((part.value, truth.value), (part.first, truth.first), (part.second, truth.second)):
            if (a - b).abs().max() > tolerance * max(1.0, float(b.detach().abs().max())):
                return False
    return True


def by_hand(network: InvertibleResNet, x: Tensor, t: Tensor) -> Tensor:
    """The formula of the documentation, with singular values from a decomposition."""
    encoded = network.space * (1 + 2 * network.frequencies)
    for block in network.blocks:
        octaves = [math.pi * 2**j for j in range(network.frequencies)]
        waves = [torch.sin(a * x) / a for a in octaves] + [torch.cos(a * x) / a for a in octaves]
        h = torch.cat([*(part / math.sqrt(1 + network.frequencies) for part in (x, *waves)), t], dim=1)
        for i, layer in enumerate(block):
            greatest = network.lipschitz if i == network.depth else 1.0
            bounded, free = (layer.weight[:, :encoded], layer.weight[:, encoded:]) if i == 0 else (layer.weight, None)
            bounded = bounded * min(1.0, greatest / float(torch.linalg.svdvals(bounded.detach())[0]))
            h = h @ (bounded if free is None else torch.cat([bounded, free], dim=1)).T + layer.bias
            h = h if i == network.depth else torch.sin(network.omega * h) / network.omega
        x = x + h
    return x


@pytest.mark.parametrize(("space", "time"), KINDS)
def test_the_network_is_the_formula_it_says(space: int, time: int, generator: torch.Generator) -> None:
    network = invertible(space, time)
    x, t = drawn(space, time, generator)
    assert torch.allclose(network(x, t), by_hand(network, x, t), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("space", "time"), KINDS)
def test_the_jet_of_the_map_and_of_its_inverse_is_that_of_automatic_differentiation(
    space: int, time: int, generator: torch.Generator
) -> None:
    network = invertible(space, time, depth=1 + space % 2)
    x, t = drawn(space, time, generator, 20)
    for found in (network, Inverse(network)):
        assert agree(found, found, x, t)


@pytest.mark.parametrize(("space", "time"), KINDS)
@pytest.mark.parametrize("depth", [1, 3])
def test_second_derivatives_along_a_covector_are_those_of_the_jet(
    space: int, time: int, depth: int, generator: torch.Generator
) -> None:
    network = invertible(space, time, depth=depth)
    x, t = drawn(space, time, generator)
    covector = torch.randn(x.shape, generator=generator, dtype=x.dtype)
    whole, (found, bent) = network.push(identity(x, t, order=2)), network.along(x, t, covector)
    assert torch.allclose(found.value, whole.value, rtol=0, atol=1e-12)
    assert torch.allclose(found.first, whole.first, rtol=0, atol=1e-12)
    exact = (whole.second @ covector[:, None, :, None])[..., 0]
    assert (bent - exact).abs().max() < 1e-12 * max(1.0, float(exact.detach().abs().max()))
    weights = list(network.parameters())
    pairs = (torch.autograd.grad(made.square().sum(), weights, materialize_grads=True) for made in (bent, exact))
    for a, b in zip(*pairs, strict=True):
        assert torch.allclose(a, b, rtol=1e-9, atol=1e-9 * float(b.abs().max()))


class AfterWave(Map):
    """A map of the plane and one time after a map that makes both points and times from three coordinates."""

    def __init__(self, outer: Map) -> None:
        super().__init__()
        self.wave, self.outer, self.space, self.times = Wave(3), outer, 3, 0

    def push(self, jet: Jet) -> Jet:
        moved = self.outer.push(self.wave.push(jet))
        return moved.beside(moved.components(0, 1))


def test_jets_whose_times_depend_on_space_are_pushed_as_well(generator: torch.Generator) -> None:
    network = invertible(2, 1)
    x, t = drawn(3, 0, generator, 20)
    for outer in (network, Inverse(network)):
        after = AfterWave(outer)
        assert agree(after, after, x, t)


def test_the_jet_of_the_inverse_after_the_map_is_that_of_the_identity(generator: torch.Generator) -> None:
    network = invertible(3, 1)
    x, t = drawn(3, 1, generator)
    start = identity(x, t, order=2)
    times = start.components(3)
    for one, other in ((network, Inverse(network)), (Inverse(network), network)):
        jet = other.push(one.push(start).beside(times))
        assert torch.allclose(jet.value, x, rtol=0, atol=1e-12)
        assert torch.allclose(jet.first, start.first[..., :3], rtol=0, atol=1e-12)
        assert torch.allclose(jet.second, torch.zeros_like(jet.second), rtol=0, atol=1e-9)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_new_network_is_the_identity(dtype: torch.dtype, generator: torch.Generator) -> None:
    network = InvertibleResNet(2, 1, dtype=dtype)
    x, t = (part.to(dtype) for part in drawn(2, 1, generator))
    assert torch.equal(network(x, t), x)
    assert torch.equal(network.inverse(x, t), x)
    assert network.bounds == (1.0, 1.0)


@pytest.mark.parametrize(("space", "time"), KINDS)
def test_no_distance_changes_by_more_than_the_bounds(space: int, time: int, generator: torch.Generator) -> None:
    network = invertible(space, time)
    least, greatest = network.bounds
    assert math.isclose(least, 0.1**3) and math.isclose(greatest, 1.9**3)
    x, t = drawn(space, time, generator, 5000)
    stretches = torch.linalg.svdvals(network.push(identity(x, t, order=1)).gradient)
    assert least <= stretches.min() and stretches.max() <= greatest
    for size in (1e-2, 1.0):
        other = x + size * torch.randn(x.shape, generator=generator, dtype=x.dtype)
        ratio = (network(other, t) - network(x, t)).norm(dim=1) / (other - x).norm(dim=1)
        assert least <= ratio.min() and ratio.max() <= greatest


def steepest(lipschitz: float, sign: float, blocks: int = 1) -> InvertibleResNet:
    """A map of the line whose blocks all have the slope `sign * lipschitz` at the origin, which they leave in place."""
    network = InvertibleResNet(
        1, blocks=blocks, width=1, depth=1, frequencies=3, lipschitz=lipschitz, dtype=torch.float64
    )
    with torch.no_grad():
        for hidden, last in network.blocks:
            # Along the encoding: the slopes at 0 of x, three sines and three cosines.
            hidden.weight.copy_(torch.tensor([[1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]]))
            hidden.bias.zero_()
            last.weight.fill_(5.0 * sign)
    return network


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_bounds_are_attained(sign: float) -> None:
    network = steepest(0.8, sign, blocks=4)
    slope = network.push(identity(torch.zeros(1, 1).double(), torch.zeros(1, 0).double(), order=1)).first.item()
    assert math.isclose(slope, network.bounds[0 if sign < 0 else 1], rel_tol=1e-12)
    assert math.isclose(slope, (1 + 0.8 * sign) ** 4, rel_tol=1e-12)


@pytest.mark.parametrize(("space", "time"), KINDS)
@pytest.mark.parametrize(("dtype", "error"), [(torch.float64, 1e-12), (torch.float32, 1e-6)])
def test_the_inverse_gives_the_points_back(
    space: int, time: int, dtype: torch.dtype, error: float, generator: torch.Generator
) -> None:
    network = invertible(space, time).to(dtype)
    x, t = (part.to(dtype) for part in drawn(space, time, generator, 2000))
    with torch.no_grad():
        assert (network.inverse(network(x, t), t) - x).norm(dim=1).max() < error
        assert torch.equal(Inverse(network)(network(x, t), t), network.inverse(network(x, t), t))
    assert (Inverse(network)(network(x, t), t) - x).norm(dim=1).max() < error


@pytest.mark.parametrize("tolerance", [1e-2, 1e-6, 1e-13])
@pytest.mark.parametrize("lipschitz", [0.3, 0.99])
def test_the_tolerance_is_met_where_the_map_contracts_as_much_as_it_may(tolerance: float, lipschitz: float) -> None:
    network = steepest(lipschitz, -1.0, blocks=2)
    y = torch.linspace(-0.1, 0.1, 201, dtype=torch.float64)[:, None]
    assert (network(network.inverse(y, tolerance=tolerance)) - y).abs().max() <= tolerance


def test_far_from_the_box_the_inverse_is_as_good_as_numbers_are(generator: torch.Generator) -> None:
    network = invertible(2)
    y = 1e6 * torch.randn(100, 2, generator=generator, dtype=torch.float64)
    assert (network(network.inverse(y)) - y).abs().max() < 1e-8
    assert network.inverse(y[:0]).shape == (0, 2)
    with pytest.raises(ValueError, match=r"inverse\(tolerance=1e-15\): the points found miss by .* torch.float64 as"):
        network.inverse(y, tolerance=1e-15)
    with pytest.raises(ValueError, match=r"numbers of torch.float32 .* allow no better. Ask for less, .*double\(\)"):
        network.float().inverse(y / 1e6, tolerance=1e-9)


def test_points_that_are_not_finite_have_no_inverse() -> None:
    network = invertible(2, 1)
    y, t = torch.zeros(3, 2, dtype=torch.float64), torch.zeros(3, 1, dtype=torch.float64)
    for value in (math.nan, math.inf):
        bad = torch.full((3, 1), value, dtype=torch.float64)
        for points, times in ((y + bad, t), (y, bad)):
            with pytest.raises(ValueError, match="some points or times are not finite; leave them out"):
                network.inverse(points, times)


def test_the_inverse_is_differentiable_in_the_weights(generator: torch.Generator) -> None:
    network = invertible(2, 1)
    y, t = drawn(2, 1, generator, 20)
    ways = torch.randn(20, 2, generator=generator, dtype=torch.float64)
    parameters = list(network.parameters())

    def change(weights: list[Tensor]) -> Tensor:
        """The image under the network with these weights of the inverse under the network with the same."""
        moved = torch.func.functional_call(network, dict(zip(names, weights, strict=True)), (Inverse(network)(y, t), t))
        return (moved * ways).sum()

    names = [name for name, _ in network.named_parameters()]
    gradients = torch.autograd.grad(change(parameters), parameters)
    alone = torch.autograd.grad((network(network.inverse(y, t), t) * ways).sum(), parameters)
    # D(D^-1(y)) = y whatever the weights are.
    scale = max(float(gradient.abs().max()) for gradient in alone)
    assert scale > 0.01
    assert all(gradient.abs().max() < 1e-12 * max(1.0, scale) for gradient in gradients)


def circle(x: Tensor, t: Tensor) -> Tensor:
    return x.norm(dim=1) - 0.5


def round_points(angle: Tensor) -> Tensor:
    """The points of that circle."""
    return torch.stack([angle.cos(), angle.sin()], dim=1) / 2


def test_a_carried_circle_has_the_curvature_of_the_carried_curve() -> None:
    network = invertible(2, 1)
    field = Deformed(Explicit(circle, 2), Inverse(network)).at(0.4)
    angle = torch.linspace(0, 6, 60, dtype=torch.float64, requires_grad=True)
    curve = network(round_points(angle), torch.full((60, 1), 0.4, dtype=torch.float64))
    along, bend = curve, curve
    for order in (1, 2):
        rows = [torch.autograd.grad(bend[:, i].sum(), angle, create_graph=True)[0] for i in range(2)]
        along, bend = (bend if order == 2 else along), torch.stack(rows, dim=1)
    exact = (along[:, 0] * bend[:, 1] - along[:, 1] * bend[:, 0]) / along.norm(dim=1) ** 3
    jet = field.jet(curve.detach(), order=2)
    assert jet.value.detach().abs().max() < 1e-12
    assert torch.allclose(mean_curvature(jet), exact, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("carried", [True, False], ids=["image", "preimage"])
def test_the_surface_of_a_deformed_field_is_the_image_of_the_surface_or_the_preimage(carried: bool) -> None:
    network = invertible(2, blocks=2, lipschitz=0.5)
    there, back = (network, Inverse(network)) if carried else (Inverse(network), network)
    surface = there(round_points(torch.linspace(0, 2 * math.pi, 2000, dtype=torch.float64))).detach()
    mesh = extract(Deformed(Explicit(circle, 2), back), box=Box.around(surface).expanded(0.1), resolution=64, refine=8)
    with torch.no_grad():
        assert circle(back(torch.tensor(mesh.vertices)), surface).abs().max() < 1e-9
    assert len(mesh.vertices) > 50


@dataclass
class Follow:
    """The squared distance of the image of a point to where it belongs, by a twist of a box."""

    network: InvertibleResNet
    name: str = "twist"
    weight: float = 1.0

    def sample(self, generator: torch.Generator) -> tuple[Tensor, ...]:
        return (2 * torch.rand(512, 2, generator=generator) - 1,)

    def loss(self, x: Tensor) -> Tensor:
        return (self.network(x) - twisted(x)).square().sum(1)


def twisted(x: Tensor) -> Tensor:
    """Points turned about the origin, by 1.5 there and hardly at the sides of the box."""
    angle = 1.5 * torch.exp(-4 * x.square().sum(1))
    c, s = angle.cos(), angle.sin()
    return torch.stack([c * x[:, 0] - s * x[:, 1], s * x[:, 0] + c * x[:, 1]], dim=1)


def test_a_twist_is_learnt_and_the_inverse_stays_exact() -> None:
    network = InvertibleResNet(2, width=32, blocks=4)
    generator = torch.Generator().manual_seed(0)
    minimise(network.parameters(), [Follow(network)], budget=Budget(steps=150), generator=generator, rate=1e-2)
    x = 2 * torch.rand(4000, 2, generator=generator) - 1
    with torch.no_grad():
        missed = (network(x) - twisted(x)).norm(dim=1)
        assert missed.max() < 0.05 and missed.square().mean().sqrt() < 0.015
        assert (twisted(x) - x).norm(dim=1).max() > 0.3
        least, greatest = network.bounds
        stretches = torch.linalg.svdvals(network.push(identity(x, x[:, :0], order=1)).gradient)
        assert least <= stretches.min() < 0.8 and 1.2 < stretches.max() <= greatest
        assert (network.inverse(network(x)) - x).norm(dim=1).max() < 1e-6
        exact = network.double()
        assert (exact.inverse(exact(x.double())) - x.double()).norm(dim=1).max() < 1e-12


def test_points_in_float64_are_taken_by_a_network_in_float32(generator: torch.Generator) -> None:
    network = invertible(2).float()
    x, _ = drawn(2, 0, generator)
    for found in (network, Inverse(network)):
        assert found(x).dtype == torch.float32
        assert torch.equal(found(x), found(x.float()))


def test_the_same_generator_gives_the_same_weights_and_the_global_one_is_left_alone() -> None:
    before = torch.get_rng_state()
    one, other, again = (
        InvertibleResNet(2, generator=torch.Generator().manual_seed(i), width=8, blocks=2) for i in (1, 2, 1)
    )
    assert torch.equal(before, torch.get_rng_state())
    assert torch.equal(one.blocks[1][0].weight, again.blocks[1][0].weight)
    assert not torch.equal(one.blocks[1][0].weight, other.blocks[1][0].weight)
    assert not torch.equal(one.blocks[0][1].weight, one.blocks[1][1].weight)


@pytest.mark.parametrize(
    "sizes",
    [
        {"space": 0}, {"time": -1}, {"blocks": 0}, {"width": 0}, {"depth": 0}, {"frequencies": -1}, {"omega": 0.0},
        {"omega": math.nan},
    ],
)  # fmt: skip
def test_sizes_that_make_no_network_are_refused(sizes: dict) -> None:
    ((name, value),) = sizes.items()
    with pytest.raises(ValueError, match=rf"InvertibleResNet\(.*{name}={value}.*frequencies at least 0"):
        InvertibleResNet(**sizes)


@pytest.mark.parametrize("lipschitz", [0.0, 0.995, 1.0, math.nan])
def test_a_bound_with_which_the_map_may_fold_is_refused(lipschitz: float) -> None:
    with pytest.raises(ValueError, match=rf"lipschitz={lipschitz}\): .* give a bound between 0 and 0.99"):
        InvertibleResNet(lipschitz=lipschitz)
