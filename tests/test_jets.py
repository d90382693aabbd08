"""Jets against nested automatic differentiation, for every field there is."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from levelflow.equations.curvature import MeanCurvature
from levelflow.fields import Deformed, Field
from levelflow.jets import Jet, identity
from levelflow.networks.invertible import Inverse
from tests.fields import FIELDS, differentiated, invertible, lipschitz, placed, points, siren

ORDERS = (0, 1, 2)


@pytest.fixture(params=FIELDS, name="field")
def _field(request: pytest.FixtureRequest) -> Field:
    return FIELDS[request.param]


def close(found: Tensor | None, exact: Tensor | None, tolerance: float = 1e-12) -> bool:
    """Whether two tensors agree relative to the greatest entry, but at least to 1."""
    if found is None or exact is None:
        return found is exact
    scale = max(1.0, float(exact.detach().abs().max())) if exact.numel() else 1.0
    return found.shape == exact.shape and bool(((found - exact).abs() <= tolerance * scale).all())


def agree(found: Jet, exact: Jet) -> bool:
    parts = ("value", "first", "second")
    return found.space == exact.space and all(close(getattr(found, part), getattr(exact, part)) for part in parts)


def test_the_jet_of_every_field_is_that_of_automatic_differentiation(field: Field) -> None:
    x, t = points(field)
    jet, exact = field.jet(x, t, order=2), differentiated(field, x, t)
    assert close(jet.value, exact.value)
    assert close(jet.gradient, exact.gradient)
    assert close(jet.dt, exact.dt)
    assert close(jet.hessian, exact.hessian)


def test_the_fast_jet_of_every_field_is_the_one_pushed_through_it(field: Field) -> None:
    x, t = points(field)
    for order in ORDERS:
        assert agree(field.jet(x, t, order=order), field.push(identity(x, t, order=order)))


def test_a_jet_of_lower_order_is_the_beginning_of_the_higher(field: Field) -> None:
    x, t = points(field)
    full = field.jet(x, t, order=2)
    assert agree(field.jet(x, t, order=1), Jet(full.value, full.first, None, full.space))
    assert agree(field.jet(x, t, order=0), Jet(full.value, None, None, full.space))
    assert [field.jet(x, t, order=order).order for order in ORDERS] == [0, 1, 2]


def test_a_field_is_called_for_its_value(field: Field) -> None:
    x, t = points(field)
    assert close(field(x, t), field.jet(x, t, order=0).value)


@pytest.mark.parametrize(
    "field",
    [
        siren(2, 1),
        siren(3, 1, depth=3),
        placed(2, 1),
        lipschitz(2, 1),
        Deformed(siren(2), invertible(2, 1)),
        Deformed(siren(2), Inverse(invertible(2, 1))),
    ],
    ids=["plane", "space", "placed", "Lipschitz", "deformed", "carried"],
)
def test_the_gradient_of_a_curvature_residual_in_the_weights_is_that_of_nested_differentiation(field: Field) -> None:
    x, t = points(field)
    equation = MeanCurvature(rate=0.3)

    def gradients(jet: Jet) -> list[Tensor]:
        field.zero_grad()
        equation.residual(x, t, jet).square().sum().backward()
        # The bias of the last layer does not enter the residual.
        return [torch.zeros_like(p) if p.grad is None else p.grad.clone() for p in field.parameters()]

    found, exact = gradients(field.jet(x, t, order=2)), gradients(differentiated(field, x, t))
    pushed = gradients(field.push(identity(x, t, order=2)))
    scale = max(g.abs().max() for g in exact)
    assert scale > 0
    for one, other, truth in zip(found, pushed, exact, strict=True):
        assert (one - truth).abs().max() <= 1e-9 * truth.abs().max() + 1e-15 * scale
        assert (other - truth).abs().max() <= 1e-9 * truth.abs().max() + 1e-15 * scale


def test_sums_and_products_have_the_order_of_the_lower_jet() -> None:
    x, t = points(siren(2))
    full, slope = siren(2).jet(x, t, order=2), siren(2, seed=1).jet(x, t, order=1)
    for jet in (full + slope, slope + full, full * slope, slope * full):
        assert jet.order == 1 and jet.second is None
    assert (full + siren(2).jet(x, order=0)).order == 0


def test_components_of_a_map_have_the_jets_of_its_parts() -> None:
    x = torch.rand(5, 3, dtype=torch.float64)
    jet = identity(x, x.new_zeros(5, 0), order=2).component(1)
    assert agree(jet, Jet(x[:, 1], torch.eye(3, dtype=x.dtype)[1].expand(5, 3), x.new_zeros(5, 3, 3), 3))


def test_vectors_are_taken_apart_and_put_together_again() -> None:
    x, t = points(siren(2, 2))
    for order in ORDERS:
        jet = identity(x, t, order=order)
        places, times = jet.components(0, 2), jet.components(2)
        assert agree(places.component(1), jet.component(1)) and agree(times.component(1), jet.component(3))
        assert agree(places.beside(times), jet)
    with pytest.raises(ValueError, match="order 0 and no derivatives"):
        jet.beside(identity(x, t, order=0))


def test_a_jet_takes_the_dtype_of_a_tensor() -> None:
    x, t = points(siren(2, 1))
    for order in ORDERS:
        jet = identity(x, t, order=order).to(torch.zeros(1))
        assert {part.dtype for part in (jet.value, jet.first, jet.second) if part is not None} == {torch.float32}
        assert (jet.order, jet.space) == (order, 2)


def test_derivatives_that_a_jet_does_not_have_are_asked_for_with_a_higher_order() -> None:
    x, _ = points(siren(2))
    with pytest.raises(ValueError, match=r"order 1 and no Hessian; ask for it with jet\(x, t, order=2\)"):
        _ = siren(2).jet(x, order=1).hessian
    with pytest.raises(ValueError, match=r"order 0 and no derivatives; ask for them with jet\(x, t, order=1\)"):
        _ = siren(2).jet(x, order=0).gradient


@pytest.mark.parametrize("order", [-1, 3])
def test_an_order_that_is_not_0_1_or_2_is_refused_by_every_field(field: Field, order: int) -> None:
    x, t = points(field)
    with pytest.raises(ValueError, match=rf"jet\(order={order}\): the order must be 0 \(value\)"):
        field.jet(x, t, order=order)
