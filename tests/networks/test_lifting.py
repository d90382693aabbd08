"""A lifted network is the network it came from, at every time, and can be trained on."""

from __future__ import annotations

import pytest
import torch

from levelflow.boxes import Box
from levelflow.fields import Placed
from levelflow.networks.lifting import lift, replaced
from levelflow.networks.siren import SIREN
from tests.fields import siren


@pytest.mark.parametrize("depth", [1, 2, 3])
@pytest.mark.parametrize("width", [None, 16, 25])
@pytest.mark.parametrize("time", [1, 2])
def test_a_lifted_network_has_the_values_of_the_static_one_at_every_time(
    depth: int, width: int | None, time: int, generator: torch.Generator
) -> None:
    network = siren(2, depth=depth, omega=30.0)
    lifted = lift(network, time=time, width=width, generator=generator)
    assert (lifted.space, lifted.times, lifted.width, lifted.depth) == (2, time, width or 16, depth)
    x = 2 * torch.rand(200, 2, generator=generator, dtype=torch.float64) - 1
    t = 20 * torch.rand(200, time, generator=generator, dtype=torch.float64) - 10
    jet, still = lifted.jet(x, t, order=2), network.jet(x, order=2)
    assert torch.allclose(jet.value, still.value, rtol=0, atol=1e-12)
    assert torch.allclose(jet.gradient, still.gradient, rtol=1e-12, atol=1e-12)
    assert torch.allclose(jet.hessian, still.hessian, rtol=1e-12, atol=1e-10)
    assert (jet.dt == 0).all()


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_training_puts_time_and_every_added_neuron_to_use(depth: int, generator: torch.Generator) -> None:
    lifted = lift(siren(2, depth=depth), width=24, generator=generator)
    x = torch.rand(50, 2, generator=generator, dtype=torch.float64)
    t = torch.rand(50, 1, generator=generator, dtype=torch.float64)
    descent = torch.optim.SGD(lifted.parameters(), lr=1e-3)
    for _ in range(2):
        descent.zero_grad()
        (lifted(x, t) - t[:, 0]).square().sum().backward()
        descent.step()
    for parameter in lifted.parameters():
        assert parameter.grad is not None and (parameter.grad != 0).all()


def test_lifting_leaves_the_network_as_it_was_and_keeps_its_dtype() -> None:
    network = SIREN(2, width=8)
    before = {name: value.clone() for name, value in network.state_dict().items()}
    lifted = lift(network, width=12)
    with torch.no_grad():
        lifted.hidden[0].weight.zero_()
    assert lifted.last.weight.dtype == torch.float32
    assert all(torch.equal(value, before[name]) for name, value in network.state_dict().items())


def test_a_lifted_network_sliced_is_the_network(generator: torch.Generator) -> None:
    network = siren(3)
    x = torch.rand(50, 3, generator=generator, dtype=torch.float64)
    assert torch.allclose(lift(network).at(0.7)(x), network(x), rtol=0, atol=1e-12)


def test_a_network_of_space_time_is_not_lifted_again() -> None:
    with pytest.raises(ValueError, match=r"already depends on 1 time\(s\); lift a slice, network.at\(t\)"):
        lift(siren(2, 1))


def test_lifting_does_not_make_narrower() -> None:
    with pytest.raises(ValueError, match=r"lift\(width=8\): the network has width 16; lifting cannot make it narrower"):
        lift(siren(2), width=8)


def test_a_network_stands_for_the_same_field_in_another_frame(generator: torch.Generator) -> None:
    old, new = Box((1.0, -2.0), (4.0, 3.0)), Box((-5.0, -5.0), (9.0, 6.0))
    network = SIREN(2, width=8, depth=2, dtype=torch.float64)
    moved = Placed(replaced(network, old.frame, new.frame), new)
    x = old.uniform(50, generator=generator)
    assert torch.allclose(moved(x), Placed(network, old)(x), atol=1e-12)


def test_making_a_network_leaves_the_global_generator_alone() -> None:
    before = torch.get_rng_state()
    SIREN(2, 1, width=8).at(0.5)
    assert torch.equal(torch.get_rng_state(), before)
