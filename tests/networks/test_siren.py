"""Sinusoidal networks: how they start, and their slices. Their jets are tested in test_jets."""

from __future__ import annotations

import math

import pytest
import torch

from levelflow.networks.siren import SIREN, sine, sliced
from tests.fields import points, siren


def test_the_network_is_the_formula_it_says(generator: torch.Generator) -> None:
    network = siren(2, 1, depth=2, omega=7.0)
    x, t = points(network)
    h = torch.cat([x, t], dim=1)
    for layer in network.hidden:
        h = torch.sin(7.0 * layer(h))
    assert torch.allclose(network(x, t), network.last(h)[:, 0], rtol=0, atol=1e-13)


@pytest.mark.parametrize("times", [(0.3,), (-1.0, 0.7)])
def test_the_network_at_a_time_is_a_network_of_space_with_the_same_values(times: tuple[float, ...]) -> None:
    network = siren(3, len(times), depth=3, omega=30.0)
    x, t = points(network)
    sliced = network.at(*times)
    assert (sliced.space, sliced.times, sliced.width, sliced.depth, sliced.omega) == (3, 0, 16, 3, 30.0)
    assert sliced.last.weight.dtype == torch.float64
    assert torch.allclose(sliced(x), network(x, t.new_tensor(times).expand_as(t)), rtol=0, atol=1e-12)


@pytest.mark.parametrize("t", [(0.3, -0.6), (0.3, None), (None, -0.6), (None, None)])
def test_a_slice_is_a_network_with_the_jets_of_the_whole(t: tuple[float | None, ...]) -> None:
    network = siren(3, 2, depth=3, omega=30.0)
    found = sliced(network, *t)
    free = [i for i, value in enumerate(t) if value is None]
    assert (found.space, found.times, found.width, found.depth, found.omega) == (3, len(free), 16, 3, 30.0)
    x, times = points(network)
    for i, value in enumerate(t):
        times[:, i] = times[:, i] if value is None else value
    jet, whole = found.jet(x, times[:, free], order=2), network.jet(x, times, order=2)
    assert torch.allclose(jet.value, whole.value, rtol=0, atol=1e-12)
    assert torch.allclose(jet.gradient, whole.gradient, rtol=1e-12, atol=1e-11)
    assert torch.allclose(jet.dt, whole.dt[:, free], rtol=1e-12, atol=1e-11)
    assert torch.allclose(jet.hessian, whole.hessian, rtol=1e-11, atol=1e-9)


def test_a_slice_of_a_network_of_space_is_a_copy() -> None:
    network = siren(2)
    x, _ = points(network)
    assert torch.equal(sliced(network)(x), network(x))


def test_slicing_wants_a_number_or_none_for_each_time() -> None:
    with pytest.raises(
        ValueError, match=r"sliced: 1 value\(s\) are given and the network depends on 2 time\(s\); give one"
    ):
        sliced(siren(2, 2), 0.3)
    with pytest.raises(ValueError, match=r"sliced: the times \[nan, None\] must be finite numbers"):
        sliced(siren(2, 2), math.nan, None)


def test_a_slice_shares_no_weights_with_the_network() -> None:
    network = siren(2, 1)
    before = [p.detach().clone() for p in network.parameters()]
    with torch.no_grad():
        for p in network.at(0.3).parameters():
            p.zero_()
    assert all(torch.equal(p, q) for p, q in zip(network.parameters(), before, strict=True))


def test_weights_start_within_their_bounds_and_fill_them() -> None:
    network = SIREN(2, 1, width=64, depth=3, omega=20.0)
    for i, layer in enumerate([*network.hidden, network.last]):
        n = layer.in_features
        bound = 1 / n if i == 0 else math.sqrt(6 / n) / 20.0
        assert 0.9 * bound < layer.weight.abs().max() <= bound
        assert layer.bias.abs().max() <= 1 / math.sqrt(n)


def test_the_values_of_a_new_network_are_spread_alike_at_every_depth(generator: torch.Generator) -> None:
    spreads = []
    for depth in (2, 4, 8):
        network = SIREN(2, width=128, depth=depth, generator=generator)
        x = 2 * torch.rand(2000, 2, generator=generator) - 1
        spreads.append(float((network(x) - network.last.bias).detach().std()))
    assert max(spreads) < 2 * min(spreads)


def test_the_same_generator_gives_the_same_weights_and_nothing_depends_on_the_global_seed() -> None:
    def weights(seed: int, other: int) -> torch.Tensor:
        torch.manual_seed(other)
        return SIREN(2, generator=torch.Generator().manual_seed(seed), width=8).hidden[1].weight

    assert torch.equal(weights(1, 0), weights(1, 5))
    assert not torch.equal(weights(1, 0), weights(2, 0))
    assert torch.equal(SIREN(2).last.weight, SIREN(2).last.weight)


def test_derivatives_of_the_sine() -> None:
    u = torch.linspace(-3, 3, 20, dtype=torch.float64)
    s = (u.sin(), u.cos(), -u.sin())
    for order in (0, 1, 2):
        assert all(torch.equal(a, b) for a, b in zip(sine(u, order), s[: order + 1], strict=True))


@pytest.mark.parametrize(
    "sizes", [{"space": 0}, {"time": -1}, {"width": 0}, {"depth": 0}, {"omega": 0.0}, {"omega": math.nan}]
)
def test_sizes_that_make_no_network_are_refused(sizes: dict) -> None:
    ((name, value),) = sizes.items()
    with pytest.raises(ValueError, match=rf"SIREN\(.*{name}={value}.*must be positive, and time at least 0"):
        SIREN(**sizes)
