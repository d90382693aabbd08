"""Fields between fields at given times."""

from __future__ import annotations

import pytest
import torch

from levelflow.fields import Slice
from levelflow.keyframed import Keyframed
from tests.fields import differentiated, siren

TIMES = (-1.0, 0.2, 1.0)


def keyframed(space: int = 2) -> Keyframed:
    return Keyframed([siren(space, seed=i) for i in range(3)], TIMES)


def batch(n: int = 40) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(3)
    x = 2 * torch.rand(n, 2, generator=generator, dtype=torch.float64) - 1
    return x, 2 * torch.rand(n, 1, generator=generator, dtype=torch.float64) - 1


def test_at_its_times_it_is_the_given_field_and_half_way_the_mean() -> None:
    field, (x, _) = keyframed(), batch()
    for network, t in zip(field.fields, TIMES, strict=True):
        assert torch.allclose(field(x, torch.full((len(x), 1), t, dtype=torch.float64)), network(x))
        assert field.at(t) is network
    middle = field.at(0.6)
    assert isinstance(middle, Slice)
    assert torch.allclose(middle(x), (field.fields[1](x) + field.fields[2](x)) / 2)


@pytest.mark.parametrize("way", ["jet", "push"])
def test_its_jets_are_those_of_automatic_differentiation(way: str) -> None:
    field, (x, t) = keyframed(), batch()
    truth = differentiated(lambda x, t: field.jet(x, t, order=0).value, x, t)
    jet = field.jet(x, t, order=2) if way == "jet" else super(Keyframed, field).jet(x, t, order=2)
    assert torch.allclose(jet.value, truth.value, atol=1e-12)
    assert torch.allclose(jet.first, truth.first, atol=1e-12)
    assert torch.allclose(jet.second, truth.second, atol=1e-12)


def test_before_and_after_its_times_it_stands_still() -> None:
    field, (x, _) = keyframed(), batch()
    for t, network in ((-3.0, field.fields[0]), (2.0, field.fields[2])):
        jet = field.jet(x, torch.full((len(x), 1), t, dtype=torch.float64), order=1)
        assert torch.allclose(jet.value, network(x))
        assert not jet.dt.any()


def test_no_points_give_no_values() -> None:
    x = torch.zeros(0, 2, dtype=torch.float64)
    assert keyframed()(x, x[:, :1]).shape == (0,)


@pytest.mark.parametrize(
    ("fields", "times", "message"),
    [
        ([siren(2)], [0.0], "1 fields and 1 times"),
        ([siren(2), siren(2)], [0.0], "2 fields and 1 times"),
        ([siren(2), siren(2)], [0.0, 0.0], "in ascending order"),
        ([siren(2), siren(3)], [0.0, 1.0], r"fields of \(space, times\) \[\(3, 0\)\]"),
        ([siren(2, 1), siren(2, 1)], [0.0, 1.0], "give static fields"),
    ],
    ids=["one", "times", "order", "spaces", "moving"],
)
def test_what_does_not_fit_together_is_refused(fields: list, times: list, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Keyframed(fields, times)
