"""Fields made of other fields, and the units they are in."""

from __future__ import annotations

import copy

import pytest
import torch

from levelflow.boxes import Box
from levelflow.equations import Family, Transport
from levelflow.fields import Deformed, Placed, Slice, Sum, Walk
from levelflow.networks.siren import SIREN
from levelflow.shapes import Circle
from levelflow.shapes.implicit import Implicit
from levelflow.transported import Transported
from tests.fields import FIELDS, Explicit, Product, Wave, invertible, lipschitz, placed, points, round_field, siren


def test_a_slice_has_the_values_of_the_field_at_that_time() -> None:
    for field, t in ((siren(2, 1), (0.3,)), (siren(3, 2), (0.3, -0.5)), (placed(2, 1), (4.0,)), (placed(3, 2), (3, 0))):
        x, times = points(field)
        exact = field(x, times.new_tensor(t).expand_as(times))
        assert torch.allclose(Slice(field, t)(x), exact, rtol=0, atol=1e-12)
        assert torch.allclose(field.at(*t)(x), exact, rtol=0, atol=1e-12)


def test_a_field_at_a_time_is_static_and_has_the_box_in_space() -> None:
    field = placed(2, 1)
    formula = Explicit(round_field, 2, 1, box=field.box)
    for sliced in (field.at(3.0), formula.at(3.0), Slice(field, (3.0,))):
        assert sliced.times == 0
        assert sliced.box == field.box.during()
    assert isinstance(formula.at(3.0), Slice)


@pytest.mark.parametrize("t", [(3.0, None), (None, -0.5)])
def test_a_time_that_is_not_given_stays_free(t: tuple[float | None, ...]) -> None:
    field = placed(3, 2)
    formula = Explicit(round_field, 3, 2, box=field.box)
    free = t.index(None)
    x, times = points(field)
    times[:, 1 - free] = t[1 - free]
    for whole in (field, formula):
        for part in (whole.at(*t), Slice(whole, t)):
            assert part.times == 1 and part.box == field.box.during(field.box.times[free])
            assert torch.allclose(part(x, times[:, [free]]), whole(x, times), rtol=0, atol=1e-12)
            rest = part.at(times[0, free].item())
            assert rest.times == 0 and torch.allclose(rest(x[:1]), whole(x[:1], times[:1]), rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match=r"at\(9\): the field was solved for times"):
        field.at(*(None if value is None else 9.0 for value in t))


def test_a_walk_goes_along_its_way_at_constant_speed() -> None:
    """In units of the intervals, 3 and 1.5 long: the legs are 1, 1 and 0.5 long."""
    corners = [(2.0, -1.0), (5.0, -1.0), (5.0, -1.0), (5.0, 0.5), (3.5, 0.5)]
    for field in (placed(3, 2), Explicit(round_field, 3, 2, box=placed(3, 2).box)):
        walk = Walk(field, corners)
        assert walk.times == 1 and walk.box == field.box.during((0.0, 1.0))
        for s, place in ((0.0, (2, -1)), (0.2, (3.5, -1)), (0.4, (5, -1)), (0.6, (5, -0.25)), (1.0, (3.5, 0.5))):
            assert walk.place(s) == pytest.approx(place, abs=1e-12)
            x, t = points(walk)
            exact = field.at(*walk.place(s))(x)
            assert torch.allclose(walk.at(s)(x), exact, rtol=0, atol=1e-12)
            assert torch.allclose(walk(x, torch.full_like(t, s)), exact, rtol=0, atol=1e-12)
        assert walk.at(None) is walk
    back = Walk(placed(2, 1), [(2.0,), (5.0,), (2.0,)])
    assert back.place(0.25) == back.place(0.75) == (3.5,)
    free = Walk(siren(2, 2), [(0.0, 0.0), (3.0, 4.0)])
    assert free.box is None and free.place(0.5) == (1.5, 2.0)


def test_points_that_are_carried_through_parameters_are_carried_along_a_walk(generator: torch.Generator) -> None:
    pushes = Family(Transport((1.0, 0.0)), Transport((0.0, 2.0)))
    walk = Walk(Transported(pushes, Circle(0.5), until=(1.0, 1.0)), [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)])
    x, s = torch.rand(5, 2, generator=generator), torch.zeros(5, 1)
    assert torch.allclose(walk.carry(x, s, s + 0.75), x + x.new_tensor([1.0, 1.0]))
    assert Walk(siren(2, 1), [(0.0,), (1.0,)]).carry(x, s, s + 1) is None


def test_a_walk_needs_a_way_within_the_parameters() -> None:
    for corners, message in (
        ([(2.0, 0.0)], "the way has no length; give two different corners"),
        ([], "the way has no length"),
        ([(2.0, 0.0), (2.0, 0.0)], "the way has no length"),
        ([(2.0, 0.0), (2.0,)], r"depends on 2 time\(s\)"),
        ([(2.0, 0.0), (6.0, 0.0)], r"at\(6\): the field was solved for times from 2 to 5"),
    ):
        with pytest.raises(ValueError, match=message):
            Walk(placed(2, 2), corners)


def test_deforming_composes_with_the_map(generator: torch.Generator) -> None:
    x = torch.rand(20, 2, generator=generator, dtype=torch.float64)
    t = torch.rand(20, 1, generator=generator, dtype=torch.float64)
    field, still, moving = placed(2), Wave(2), Wave(2, 1)
    assert torch.allclose(Deformed(field, still)(x), field(still(x)), rtol=0, atol=1e-12)
    assert torch.allclose(Deformed(field, moving)(x, t), field(moving(x, t)), rtol=0, atol=1e-12)


def test_a_deformed_field_can_be_taken_at_any_time(generator: torch.Generator) -> None:
    x = torch.rand(20, 2, generator=generator, dtype=torch.float64)
    field = Deformed(placed(2), Wave(2, 1))
    assert torch.equal(field.at(0.3)(x), field(x, torch.full((20, 1), 0.3, dtype=torch.float64)))


def test_a_sum_adds_values() -> None:
    parts = siren(2, 1), siren(2, 1, seed=1), placed(2, 1)
    x, t = points(parts[0])
    assert torch.allclose(Sum(*parts)(x, t), sum(part(x, t) for part in parts), rtol=0, atol=1e-12)


def test_placing_keeps_a_distance_a_distance(generator: torch.Generator) -> None:
    circle = Explicit(lambda x, t: x.norm(dim=1) - 0.5, 2)
    field = Placed(circle, Box((8, 9), (12, 11)))
    x = field.box.uniform(50, generator=generator)
    exact = (x - torch.tensor([10.0, 10.0])).norm(dim=1) - 1.0
    assert torch.allclose(field(x), exact, rtol=0, atol=1e-12)
    assert torch.allclose(field.jet(x).gradient.norm(dim=1), torch.ones(50, dtype=x.dtype), rtol=0, atol=1e-12)


def test_times_are_brought_to_the_interval_from_minus_one_to_one() -> None:
    field = placed(2, 2)
    t = torch.tensor([[2.0, -1.0], [3.5, -0.25], [5.0, 0.5]], dtype=torch.float64)
    assert field.unit_times(t).tolist() == [[-1, -1], [0, 0], [1, 1]]
    assert torch.allclose(field.times_in_units(field.unit_times(t)), t)
    instant = Placed(siren(2, 1), Box((0, 0), (1, 1), ((3, 3),)))
    assert instant.unit_times(torch.tensor([[3.0]])).tolist() == [[0.0]]


def test_a_field_far_from_the_origin_has_the_same_bits_as_at_the_origin() -> None:
    network = SIREN(2, 1, width=16)
    here = Placed(network, Box((-1, -2), (1, 2), ((0, 4),)))
    there = Placed(network, Box((1e6 - 1, -3e6 - 2), (1e6 + 1, -3e6 + 2), ((0, 4),)))
    grid = torch.linspace(-1, 1, 129, dtype=torch.float64)
    x = torch.stack([grid, grid.flip(0)], dim=1)
    far = x + torch.tensor([1e6, -3e6], dtype=torch.float64)
    t = torch.full((129, 1), 1.5, dtype=torch.float64)
    near, away = here.jet(x, t, order=2), there.jet(far, t, order=2)
    assert near.value.dtype == torch.float32
    for part in ("value", "first", "second"):
        assert torch.equal(getattr(near, part), getattr(away, part))
    assert torch.equal(here(x, t), there(far, t))
    assert torch.equal(here.at(1.5)(x), there.at(1.5)(far))


def test_fields_made_of_placed_float32_networks_take_points_in_float64(generator: torch.Generator) -> None:
    box = Box((1e6, 0), (1e6 + 2, 2))
    one, other = (Placed(SIREN(2, width=16, generator=torch.Generator().manual_seed(i)), box) for i in range(2))
    x = box.uniform(50, generator=generator)
    assert torch.allclose(Sum(one, other)(x), one(x) + other(x), rtol=0, atol=1e-6)
    assert torch.allclose(Sum(one, other).jet(x).gradient, one.jet(x).gradient + other.jet(x).gradient, atol=1e-5)
    assert Implicit(Sum(one, other), box=box).gap(x).shape == (50,)


def test_maps_and_fields_of_different_dtypes_compose(generator: torch.Generator) -> None:
    x = 2 * torch.rand(50, 2, generator=generator, dtype=torch.float64) - 1
    for field in (siren(2), lipschitz(2)):
        exact = Deformed(field, invertible(2)).jet(x, order=2)
        for inner, outer in ((torch.float32, torch.float64), (torch.float64, torch.float32)):
            jet = Deformed(copy.deepcopy(field).to(outer), invertible(2).to(inner)).jet(x, order=2)
            assert {jet.value.dtype, jet.first.dtype, jet.second.dtype} == {outer}
            assert torch.allclose(jet.second.double(), exact.second, rtol=1e-3, atol=1e-3)


def test_the_end_of_the_interval_is_in_it_though_rounding_moves_it() -> None:
    field = placed(2, 1)
    field.at(5.0 + 1e-10)
    field.at(2.0 - 1e-10)


@pytest.mark.parametrize("t", [1.9, 5.1, float("nan")])
def test_a_time_outside_the_interval_is_refused(t: float) -> None:
    for field in (placed(2, 1), Explicit(round_field, 2, 1, box=placed(2, 1).box)):
        with pytest.raises(
            ValueError, match=rf"at\({t:g}\): the field was solved for times from 2 to 5; ask for a time"
        ):
            field.at(t)


def test_as_many_times_are_given_as_the_field_has() -> None:
    for field in (siren(2, 1), placed(2, 1), Explicit(round_field, 2, 1)):
        with pytest.raises(ValueError, match=r"at\(0.1, 0.2\): this field depends on 1 time\(s\)"):
            field.at(0.1, 0.2)
    with pytest.raises(ValueError, match=r"at\(0.1,\): this field depends on 0 time\(s\)"):
        siren(2).at(0.1)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("name", FIELDS)
def test_points_and_times_of_another_shape_are_refused_by_every_field(name: str) -> None:
    field = FIELDS[name]
    x, t = points(field, 5)
    for call in (field, field.jet):
        with pytest.raises(ValueError, match=rf"points have shape \(5, {field.space + 1}\); give \(n, {field.space}\)"):
            call(torch.cat([x, x[:, :1]], dim=1), t)
        with pytest.raises(ValueError, match=rf"points have shape \({field.space},\); give \(n, {field.space}\)"):
            call(x[0], t)
        with pytest.raises(ValueError, match=rf"times have shape \(4, {field.times}\); give \(5, {field.times}\)"):
            call(x, t[:4])
        if field.times:
            with pytest.raises(
                ValueError, match=rf"depends on {field.times} .* give t with shape \(5, {field.times}\)"
            ):
                call(x)


def test_a_map_and_a_field_of_different_spaces_do_not_compose() -> None:
    with pytest.raises(ValueError, match=r"a field on R\^2 with 0 times cannot follow a map on R\^3"):
        Deformed(siren(2), Wave(3))
    with pytest.raises(ValueError, match=r"a field on R\^2 with 1 times cannot follow a map on R\^2"):
        Deformed(siren(2, 1), Wave(2))


def test_fields_of_different_kinds_do_not_add() -> None:
    with pytest.raises(
        ValueError, match=r"different \(space, times\): \[\(2, 0\), \(2, 1\)\]; give fields of one kind"
    ):
        Sum(siren(2), siren(2, 1))


def test_a_field_and_its_box_have_the_same_coordinates() -> None:
    with pytest.raises(
        ValueError, match="the field has 2 space and 1 time coordinates, the box 2 and 0; they must agree"
    ):
        Placed(siren(2, 1), Box((0, 0), (1, 1)))


def test_the_dtype_and_device_of_a_placed_field_are_those_of_its_weights() -> None:
    field = placed(2)
    assert (field.dtype, field.device) == (torch.float64, torch.device("cpu"))
    assert field.provenance == {}
    assert Placed(Product(siren(2), siren(2)), Box((0, 0), (1, 1))).dtype == torch.float64
