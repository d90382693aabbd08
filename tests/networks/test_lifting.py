"""A lifted network is the network it came from, at every time, and can be trained on."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
import torch
from torch import Tensor

from levelflow.boxes import Box
from levelflow.fields import Placed
from levelflow.jets import Jet
from levelflow.networks.lifting import lift, lifting_error, replaced
from levelflow.networks.siren import SIREN
from tests.fields import points, siren


def apart(lifted: SIREN, network: SIREN, t: float) -> dict[str, float]:
    """How far the parts of the jets of two networks are apart, at most, at some points of their box."""
    x, times = points(network, 200)
    now = torch.cat([times, times.new_full((200, lifted.times - network.times), t)], dim=1)
    jet, exact = lifted.jet(x, now, order=2), network.jet(x, times, order=2)
    return {
        "value": float((jet.value - exact.value).detach().abs().max()),
        "gradient": float((jet.gradient - exact.gradient).detach().norm(dim=1).max()),
        "hessian": float(torch.linalg.matrix_norm((jet.hessian - exact.hessian).detach(), 2).max()),
    }


@torch.no_grad()
def neurons(network: SIREN, x: torch.Tensor, t: torch.Tensor) -> list[Jet]:
    """The jets of the neurons of the last hidden layer: networks whose output is one of them."""
    one = lift(network, time=0)
    found = []
    for i in range(network.width):
        one.last.weight.zero_()[0, i] = 1.0
        one.last.bias.zero_()
        found.append(one.jet(x, t, order=2))
    return found


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


def require_use(lifted: SIREN, x: Tensor, t: Tensor, *, rate: float) -> None:
    """After a step of training every parameter has a slope."""
    descent = torch.optim.SGD(lifted.parameters(), lr=rate)
    for _ in range(2):
        descent.zero_grad()
        (lifted(x, t) - t[:, 0]).square().sum().backward()
        descent.step()
    for parameter in lifted.parameters():
        assert parameter.grad is not None and (parameter.grad != 0).all()


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_training_puts_time_and_every_added_neuron_to_use(depth: int, generator: torch.Generator) -> None:
    lifted = lift(siren(2, depth=depth), width=24, generator=generator)
    x = torch.rand(50, 2, generator=generator, dtype=torch.float64)
    t = torch.rand(50, 1, generator=generator, dtype=torch.float64)
    require_use(lifted, x, t, rate=1e-3)


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


def test_a_network_of_space_time_becomes_wider_and_the_same_to_rounding(generator: torch.Generator) -> None:
    network = siren(2, 2, omega=30.0)
    lifted = lift(network, time=0, width=25, generator=generator)
    assert (lifted.times, lifted.width, lifted.depth, lifted.omega) == (2, 25, 2, 30.0)
    assert apart(lifted, network, 0.0)["value"] < 1e-12


@pytest.mark.parametrize(("times", "time"), [(0, 0), (0, 1), (1, 0)])
@pytest.mark.parametrize("width", [None, 25])
@pytest.mark.parametrize("added", [1, 2, 4])
def test_a_deeper_network_differs_by_the_square_of_the_slope_within_the_bounds(
    times: int, added: int, width: int | None, time: int, generator: torch.Generator
) -> None:
    network = siren(2, times, depth=2)
    weights = network.last.weight.detach()[0].abs()
    jets = neurons(network, *points(network, 200))
    steep = torch.stack([jet.gradient.norm(dim=1) for jet in jets], dim=1)
    bent = torch.stack([torch.linalg.matrix_norm(jet.hessian, 2) for jet in jets], dim=1)
    slopes, errors = (0.2, 0.1, 0.05, 0.025), []
    for slope in slopes:
        lifted = lift(network, time=time, width=width, depth=2 + added, slope=slope, generator=generator)
        assert (lifted.times, lifted.depth, lifted.width) == (times + time, 2 + added, width or 16)
        errors.append(apart(lifted, network, 0.7))
        square = added * slope**2
        assert errors[-1]["value"] <= lifting_error(network, depth=2 + added, slope=slope)
        assert lifting_error(network, depth=2 + added, slope=slope) == pytest.approx(float(square / 6 * weights.sum()))
        assert errors[-1]["gradient"] <= float(square / 2 * (steep @ weights).max())
        assert errors[-1]["hessian"] <= float(square * ((bent / 2 + steep**2) @ weights).max())
    for part in ("value", "gradient", "hessian"):
        order = [math.log2(a[part] / b[part]) for a, b in pairwise(errors)]
        assert order == pytest.approx([2, 2, 2], abs=0.06), part


def test_a_deeper_network_stands_still(generator: torch.Generator) -> None:
    lifted = lift(siren(3), time=2, depth=4, generator=generator)
    x, t = points(lifted)
    assert (lifted.jet(x, t).dt == 0).all()


def test_rounding_sets_no_lower_limit_to_the_slope() -> None:
    """Nothing is subtracted and biases are zero: in float32 a lifted network is as exact as the one it came from."""
    exact = siren(2, depth=2)
    network = SIREN(2, width=16, depth=2, omega=5.0)
    network.load_state_dict(exact.state_dict())
    x, _ = points(exact, 200)
    own = (network(x) - exact(x)).abs().max()
    for slope in (1e-3, 1e-6, 1e-12, 1e-24, 1e-36):
        lifted = lift(network, time=0, depth=4, slope=slope)
        assert lifted.last.weight.dtype == torch.float32
        assert (lifted(x) - exact(x)).abs().max() < 3 * own + 2 * slope**2


def test_what_training_does_to_an_added_layer_grows_with_one_over_the_slope() -> None:
    """Why the slope is not as small as rounding allows."""
    network = siren(2, depth=2)
    x, _ = points(network)
    moves = []
    for slope in (0.1, 0.01, 0.001):
        lifted = lift(network, time=0, depth=3, slope=slope)
        with torch.no_grad():
            before = lifted(x)
            lifted.hidden[2].weight += 1e-6
            moves.append(float((lifted(x) - before).abs().max()))
    assert moves[1] / moves[0] == pytest.approx(10, rel=0.02)
    assert moves[2] / moves[1] == pytest.approx(10, rel=0.02)


def test_training_puts_every_neuron_of_added_layers_to_use(generator: torch.Generator) -> None:
    lifted = lift(siren(2), width=24, depth=4, generator=generator)
    x, t = points(lifted)
    require_use(lifted, x, t, rate=1e-6)


def test_a_network_of_space_time_gets_no_other_time() -> None:
    with pytest.raises(ValueError, match=r"lift\(time=1\): the network depends on 1 time\(s\); give time=0 .* sliced"):
        lift(siren(2, 1))
    with pytest.raises(ValueError, match=r"lift\(time=-1\): the network depends on 1 time\(s\)"):
        lift(siren(2, 1), time=-1)


def test_lifting_does_not_make_narrower_or_shallower() -> None:
    with pytest.raises(ValueError, match=r"lift\(width=8\): the network has width 16; lifting cannot make it narrower"):
        lift(siren(2), width=8)
    with pytest.raises(ValueError, match=r"lift\(depth=1\): the network has depth 2; lifting cannot make it shallower"):
        lift(siren(2), depth=1)


@pytest.mark.parametrize("slope", [0.0, -0.1, 1.1, math.nan, math.inf])
def test_a_slope_that_is_no_part_of_one_is_refused(slope: float) -> None:
    with pytest.raises(ValueError, match=rf"lift\(slope={slope:g}\): give a number above 0 and at most 1, such as 0.1"):
        lift(siren(2), depth=3, slope=slope)


def test_a_network_stands_for_the_same_field_in_another_box(generator: torch.Generator) -> None:
    old, new = Box((1.0, -2.0), (4.0, 3.0)), Box((-5.0, -5.0), (9.0, 6.0))
    network = SIREN(2, width=8, depth=2, dtype=torch.float64)
    x = old.uniform(50, generator=generator)
    assert torch.allclose(Placed(replaced(network, old, new), new)(x), Placed(network, old)(x), atol=1e-12)
    network = SIREN(2, 2, width=8, depth=2, dtype=torch.float64)
    old, new = old.during((0.0, 1.0), (3.0, 3.0)), new.during((-2.0, 5.0), (2.0, 4.0))
    t = old.uniform_times(50, generator=generator)
    moved = Placed(replaced(network, old, new), new)
    assert torch.allclose(moved(x, t), Placed(network, old)(x, t), atol=1e-12)


def test_making_a_network_leaves_the_global_generator_alone() -> None:
    before = torch.get_rng_state()
    SIREN(2, 1, width=8).at(0.5)
    assert torch.equal(torch.get_rng_state(), before)
