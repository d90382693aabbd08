"""Networks that repeat themselves. Their jets are tested in test_jets."""

from __future__ import annotations

import math

import pytest
import torch

from levelflow import Box, Periodic, Placed, Transported, extract
from levelflow.equations import Constant, Transport
from levelflow.extraction import ExtractionWarning
from levelflow.networks.periodic import check_cell
from tests.fields import differentiated, periodic, points, siren


def test_the_network_is_the_formula_it_says() -> None:
    network = periodic(2, 1, axes=(1,), loop=True)
    (x, y), t = (points(network)[0].unbind(1)), points(network)[1]
    circle = lambda u: [torch.cos(math.pi * u) / math.pi, torch.sin(math.pi * u) / math.pi]  # noqa: E731
    exact = network.network(torch.stack([x, *circle(y)], dim=1), torch.cat(circle(t), dim=1))
    assert torch.allclose(network(torch.stack([x, y], dim=1), t), exact, rtol=0, atol=1e-13)
    assert (network.space, network.times, network.periodic, network.loops) == (2, 1, (1,), True)


def test_lengths_along_a_periodic_axis_stay_what_they_are() -> None:
    u = torch.linspace(-1, 1, 9, dtype=torch.float64)[:, None]
    _, slopes, bends, place = periodic(1, axes=(0,))._embedded(u)
    assert torch.allclose(slopes.norm(dim=1), torch.ones(9, dtype=torch.float64), rtol=0, atol=1e-14)
    assert torch.allclose((slopes * bends).sum(1), torch.zeros(9, dtype=torch.float64), rtol=0, atol=1e-14)
    assert place.tolist() == [[1.0], [1.0]]


@pytest.mark.parametrize("shift", [2.0, -4.0])
def test_after_a_period_all_derivatives_are_the_same(shift: float) -> None:
    network = periodic(2, 1, axes=(0,), loop=True)
    x, t = points(network)
    here = network.jet(x, t, order=2)
    for there in (
        network.jet(x + x.new_tensor([shift, 0.0]), t, order=2),
        network.jet(x, t + shift, order=2),
    ):
        for part in ("value", "first", "second"):
            assert torch.allclose(getattr(there, part), getattr(here, part), rtol=0, atol=1e-11)


def test_a_loop_closes_with_every_derivative_in_time() -> None:
    """f(x, -1) = f(x, 1), and so the first three derivatives in t, by automatic differentiation."""
    network = periodic(2, 1, loop=True)
    x, _ = points(network)
    ends = []
    for t in (-1.0, 1.0):
        time = torch.full((len(x), 1), t, dtype=torch.float64, requires_grad=True)
        values = [network(x, time)]
        for _ in range(3):
            values.append(torch.autograd.grad(values[-1].sum(), time, create_graph=True)[0])
        ends.append(values)
    for first, last in zip(*ends, strict=True):
        assert torch.allclose(first, last, rtol=1e-10, atol=1e-10)


def test_at_a_time_a_loop_is_the_network_inside_at_a_place_of_the_circle() -> None:
    loop = periodic(2, 1, loop=True)
    x, t = points(loop)
    still = loop.at(0.3)
    assert type(still) is type(loop.network) and still.times == 0 and loop.at(None) is loop
    assert torch.allclose(still(x), loop(x, torch.full_like(t, 0.3)), rtol=0, atol=1e-12)
    cell = periodic(2, 2, axes=(1,))
    x, t = points(cell)
    half = cell.at(None, -0.5)
    assert isinstance(half, Periodic) and (half.times, half.periodic, half.loops) == (1, (1,), False)
    exact = cell(x, torch.stack([t[:, 0], torch.full_like(t[:, 0], -0.5)], dim=1))
    assert torch.allclose(half(x, t[:, :1]), exact, rtol=0, atol=1e-12)


def test_what_is_made_of_it_knows_that_it_repeats_itself() -> None:
    box = Box((-1, -1), (1, 1), ((0, 3),))
    field = Placed(periodic(2, 1, axes=(1,), loop=True), box)
    assert (field.periodic, field.loops) == ((1,), True)
    assert (field.at(1.0).periodic, field.at(1.0).loops) == ((1,), False)
    assert not Placed(siren(2, 1), box).loops


def test_the_level_set_of_a_cell_closes_up() -> None:
    """The curve leaves on the right at the heights and with the slopes at which it comes in on the left."""
    field = Placed(periodic(2, axes=(0,)), Box((2.0, -1.5), (5.0, 1.5)))
    with torch.no_grad():
        field.field.network.last.bias -= field(torch.tensor([[2.0, 0.4]], dtype=torch.float64)) / 1.5
    with pytest.warns(ExtractionWarning, match=r"meets the box at x = 2, x = 5"):
        curve = extract(field, resolution=48, refine=8)
    left, right = (curve.vertices[abs(curve.vertices[:, 0] - end) < 1e-9] for end in (2.0, 5.0))
    heights = [torch.tensor(side[:, 1]).sort().values for side in (left, right)]
    assert len(heights[0]) > 0 and torch.allclose(*heights, rtol=0, atol=1e-6)
    on_left, on_right = (torch.stack([torch.full_like(heights[0], x), heights[0]], dim=1) for x in (2.0, 5.0))
    assert torch.allclose(field.jet(on_left).gradient, field.jet(on_right).gradient, rtol=0, atol=1e-11)


def test_carried_by_whole_periods_it_comes_back(generator: torch.Generator) -> None:
    """The exact solution needs no training: beyond its cell the field goes on as it repeats itself."""
    field = Placed(periodic(2, axes=(0,)), Box((2.0, -1.5), (5.0, 1.5)))
    carried = Transported(Transport(Constant((3.0, 0.0))), field, box=field.box.during((0.0, 2.0)))
    x = field.box.uniform(100, generator=generator)
    for t in (1.0, 2.0):
        assert torch.allclose(carried.at(t)(x), field(x), rtol=0, atol=1e-11)
    shifted = field(x - x.new_tensor([1.5, 0.0]))
    assert torch.allclose(carried.at(0.5)(x), shifted, rtol=0, atol=1e-11)
    found, exact = carried.jet(x, x.new_full((100, 1), 0.9)), differentiated(carried, x, x.new_full((100, 1), 0.9))
    assert torch.allclose(found.first, exact.first, rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    ("network", "arguments", "message"),
    [
        (siren(2, 1), {}, r"nothing is periodic; give axes=\(0, 1, 2\), or time=True for a loop"),
        (siren(3, 1), {"axes": (1,), "time": True}, r"has 1 time\(s\), and a circle of times takes two: .*SIREN\(3, 2"),
        (siren(3, 1), {"axes": (2,)}, r"axes=\(2,\)\).*3 space coordinates.*leaves 2, numbered from 0"),
        (siren(3, 1), {"axes": (-1,)}, r"axes=\(-1,\)"),
        (siren(4, 1), {"axes": (0, 0)}, "name each axis once"),
    ],
)
def test_what_cannot_be_periodic_is_explained(network, arguments, message) -> None:
    with pytest.raises(ValueError, match=f"^Periodic.*{message}"):
        Periodic(network, **arguments)


def test_a_cell_has_equal_sides_along_its_periodic_axes() -> None:
    network = periodic(3, 1, axes=(0, 2))
    check_cell(network, Box((0, 0, 0), (2, 1, 2)), call="solve")
    check_cell(siren(3), None, call="fit")
    with pytest.raises(
        ValueError, match=r"solve: the network is periodic along x, z; say what its cell is: solve\(..."
    ):
        check_cell(network, None, call="solve")
    for upper in ((2, 1, 1), (1, 2, 1)):
        with pytest.raises(ValueError, match=r"fit: .* along x, z with the longest side .*; make these equal"):
            check_cell(network, Box((0, 0, 0), upper), call="fit")
