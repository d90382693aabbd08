"""Lipschitz networks: their slopes stay within bounds that training can lower. Their jets are tested in test_jets."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from levelflow.minimising import Budget, minimise
from levelflow.networks.lipschitz import LipschitzMLP, tanh
from tests.fields import lipschitz, points

KINDS = [(2, 0), (3, 0), (2, 1), (3, 2)]


def test_the_network_is_the_formula_it_says() -> None:
    network = lipschitz(2, 1, depth=2)
    x, t = points(network)
    h = torch.cat([x, t], dim=1)
    for layer, c in zip(network.layers, network.c, strict=True):
        rows = layer.weight.abs().sum(1, keepdim=True)
        weight = layer.weight * torch.clamp(c.exp() / rows, max=1.0)
        h = torch.tanh(h @ weight.T + layer.bias) if layer is not network.layers[-1] else h @ weight.T + layer.bias
    assert torch.allclose(network(x, t), h[:, 0], rtol=0, atol=1e-13)


def test_at_the_start_no_row_is_scaled() -> None:
    network = LipschitzMLP(2, 1, width=16, dtype=torch.float64)
    for (weight, _), layer in zip(network._bounded(), network.layers, strict=True):
        assert torch.allclose(weight, layer.weight, rtol=1e-14, atol=0)


@pytest.mark.parametrize(("space", "time"), KINDS)
def test_no_slope_exceeds_the_bounds(space: int, time: int, generator: torch.Generator) -> None:
    network = lipschitz(space, time, depth=3)
    x, t = (4 * torch.rand(5000, m, generator=generator, dtype=torch.float64) - 2 for m in (space, time))
    found = network.jet(x, t).first.abs()
    assert (found.amax(0) <= network.slopes).all()
    assert found.sum(1).max() <= network.slopes.sum() <= network.lipschitz
    other = torch.cat([x, t], dim=1) + 0.1 * torch.randn(5000, space + time, generator=generator, dtype=torch.float64)
    change = (network(other[:, :space], other[:, space:]) - network(x, t)).abs()
    assert (change <= network.lipschitz * (other - torch.cat([x, t], dim=1)).abs().amax(1)).all()


def test_the_bounds_are_attained_where_nothing_cancels() -> None:
    network = LipschitzMLP(2, 1, width=8, depth=3, dtype=torch.float64)
    with torch.no_grad():
        for layer in network.layers:
            layer.weight.abs_()
            layer.bias.zero_()
        network.c.fill_(-0.75)
    origin = torch.zeros(1, 2, dtype=torch.float64), torch.zeros(1, 1, dtype=torch.float64)
    slopes = network.jet(*origin).first[0]
    assert torch.allclose(slopes, network.slopes, rtol=1e-12, atol=0)
    assert torch.allclose(slopes.sum(), network.lipschitz, rtol=1e-12, atol=0)


@dataclass
class Given:
    """Concentric circles of radius 0.3 and 0.7 at the times -1 and 1."""

    network: LipschitzMLP
    name: str = "given"
    weight: float = 1.0

    def sample(self, generator: torch.Generator) -> tuple[Tensor, ...]:
        return 2 * torch.rand(256, 2, generator=generator) - 1, 2.0 * torch.randint(
            2, (256, 1), generator=generator
        ) - 1

    def loss(self, x: Tensor, t: Tensor) -> Tensor:
        return (self.network(x, t) - distance(x, t)).square()


@dataclass
class Smooth:
    """The regulariser."""

    network: LipschitzMLP
    weight: float
    name: str = "smooth"

    def sample(self, generator: torch.Generator) -> tuple[Tensor, ...]:
        return (torch.zeros(1),)

    def loss(self, one: Tensor) -> Tensor:
        return one + self.network.lipschitz


def distance(x: Tensor, t: Tensor) -> Tensor:
    return x.norm(dim=1) - 0.5 - 0.2 * t[:, 0]


def test_the_regulariser_lowers_the_bounds_and_smooths_what_lies_between_the_given_times() -> None:
    missed, bounds, rates = {}, {}, {}
    for weight in (0.0, 1e-3):
        network = LipschitzMLP(2, 1, width=16, depth=2)
        start = float(network.lipschitz.detach())
        generator = torch.Generator().manual_seed(0)
        terms = [Given(network), Smooth(network, weight)]
        minimise(network.parameters(), terms, budget=Budget(steps=400), generator=generator, rate=2e-2)
        x, middle = 2 * torch.rand(2000, 2, generator=generator) - 1, torch.zeros(2000, 1)
        with torch.no_grad():
            jet = network.jet(x, middle)
            assert Given(network).loss(*Given(network).sample(generator)).mean().sqrt() < 0.05
            assert jet.first.abs().sum(1).max() <= network.lipschitz
            missed[weight] = float((jet.value - distance(x, middle)).square().mean().sqrt())
            bounds[weight], rates[weight] = float(network.lipschitz), float(network.slopes[2])
    # The steepest slopes of the truth are sqrt(2) + 0.2 in all and 0.2 in time.
    assert bounds[1e-3] < 10 < bounds[0.0]
    assert bounds[1e-3] < start / 3
    assert rates[1e-3] < 1.5 < 5 < rates[0.0]
    assert missed[1e-3] < missed[0.0] / 2


def test_the_network_at_a_time_is_a_network_of_space_with_the_same_values_and_no_greater_bounds() -> None:
    network = lipschitz(3, 2, depth=3)
    x, t = points(network)
    sliced = network.at(0.3, -0.7)
    assert (sliced.space, sliced.times, sliced.width, sliced.depth) == (3, 0, 16, 3)
    assert torch.allclose(sliced(x), network(x, t.new_tensor((0.3, -0.7)).expand_as(t)), rtol=0, atol=1e-12)
    still = network.at(None, -0.7)
    assert still.times == 1 and torch.allclose(still.at(0.3)(x), sliced(x), rtol=0, atol=1e-12)
    assert sliced.lipschitz == network.lipschitz
    assert torch.allclose(sliced.slopes, network.slopes[:3], rtol=1e-12, atol=0)
    with torch.no_grad():
        before = network(x, t)
        for parameter in sliced.parameters():
            parameter.zero_()
        assert torch.equal(network(x, t), before)


def test_the_same_generator_gives_the_same_weights_and_the_global_one_is_left_alone() -> None:
    before = torch.get_rng_state()
    one, other = (LipschitzMLP(2, generator=torch.Generator().manual_seed(i), width=8) for i in (1, 2))
    again = LipschitzMLP(2, generator=torch.Generator().manual_seed(1), width=8)
    assert torch.equal(before, torch.get_rng_state())
    assert torch.equal(one.layers[1].weight, again.layers[1].weight)
    assert not torch.equal(one.layers[1].weight, other.layers[1].weight)


def test_derivatives_of_the_hyperbolic_tangent() -> None:
    u = torch.linspace(-3, 3, 20, dtype=torch.float64)
    s = (u.tanh(), u.cosh() ** -2, -2 * u.tanh() * u.cosh() ** -2)
    for order in (0, 1, 2):
        found = tanh(u, order)
        assert len(found) == order + 1
        assert all(torch.allclose(a, b, rtol=0, atol=1e-15) for a, b in zip(found, s, strict=False))


@pytest.mark.parametrize("sizes", [{"space": 0}, {"time": -1}, {"width": 0}, {"depth": 0}])
def test_sizes_that_make_no_network_are_refused(sizes: dict) -> None:
    ((name, value),) = sizes.items()
    with pytest.raises(ValueError, match=rf"LipschitzMLP\(.*{name}={value}.*must be positive, and time at least 0"):
        LipschitzMLP(**sizes)
