"""No equation: nothing is asked, alone or in a sum."""

from __future__ import annotations

import pytest
import torch

from levelflow.equations.approach import Approach
from levelflow.equations.curvature import MeanCurvature
from levelflow.equations.described import equation_of
from levelflow.equations.eikonal import Eikonal
from levelflow.equations.equation import Equation
from levelflow.equations.transport import Transport
from levelflow.equations.unconstrained import Unconstrained
from levelflow.shapes.analytic import Circle
from tests.fields import points, siren


def test_every_field_solves_it() -> None:
    field = siren(2, 1)
    x, t = points(field)
    jet = field.jet(x, t, order=1)
    assert Unconstrained().residual(x, t, jet).shape == Unconstrained().error(x, t, jet).shape == (len(x), 0)
    assert Unconstrained().columns == () and not Unconstrained().drives(3)


@pytest.mark.parametrize(
    "equation",
    [Eikonal(), MeanCurvature(0.1), Transport((1.0, 0.0)), Transport((1.0, 0.0)) + Eikonal(), Approach(Circle(1.0))],
    ids=repr,
)
def test_in_a_sum_it_changes_nothing(equation: Equation) -> None:
    field = siren(2, 1)
    x, t = points(field)
    jet = field.jet(x, t, order=2)
    for total in (equation + Unconstrained(), Unconstrained() + equation):
        assert repr(total) == repr(equation)
        assert total.has_characteristics(2) == equation.has_characteristics(2)
        assert torch.equal(total.residual(x, t, jet), equation.residual(x, t, jet))
    assert (Unconstrained() + Unconstrained()).columns == ()


def test_it_is_told_by_its_text() -> None:
    assert equation_of({"equation": repr(Unconstrained())}) == Unconstrained()
