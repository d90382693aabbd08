import math

import numpy as np
import pytest

from levelflow import Sphere
from levelflow.equations import (
    BoxMask,
    Constant,
    Eikonal,
    Family,
    FeaturePreserving,
    Heat,
    MeanCurvature,
    Morph,
    PaintedMask,
    ProductOfMasks,
    Regional,
    Rotation,
    Source,
    SphereMask,
    Stationary,
    Transport,
    Twist,
)
from levelflow.equations.described import equation_of

TURN, PUSH = Rotation(-1.5, center=(0.0, 1e-3, 2.0)), Constant((1.0, -2.0, 0.5))
BALL, HALF = SphereMask((0.0, -1.0), 2.0, 0.1), BoxMask((-math.inf, 0.0), (1.0, math.inf), 0.1, inside=0.2)


@pytest.mark.parametrize(
    "equation",
    [
        MeanCurvature(1.5e-5),
        Heat(1.5e-5),
        FeaturePreserving(1.5e-5, 40.0),
        Stationary(),
        Transport(TURN),
        Transport(Source((0.0, 0.0, 0.0), -1.0, 0.2) + Twist(2.0)),
        MeanCurvature(0.1) + Transport(PUSH) + Eikonal(),
        Family(MeanCurvature(0.1) + Transport(PUSH), Stationary()),
        Regional(MeanCurvature(0.1), HALF),
        Regional(Transport(TURN), ProductOfMasks((BALL, HALF))),
    ],
)
def test_an_equation_of_numbers_is_told_by_its_text(equation):
    assert repr(equation_of({"equation": repr(equation)})) == repr(equation)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "MeanCurvature(rate=0)",
        "MeanCurvature(rate=__import__('os'))",
        "MeanCurvature(speed=1)",
        "MeanCurvature(rate=0.01) + Transport(velocity=V)",
        "Transport(open('x', 'w'))",
        "Family(MeanCurvature(rate=0.01), Eikonal())",
        f"Regional(MeanCurvature(rate=0.01), {PUSH!r})",
        f"Regional(MeanCurvature(rate=0.01), ProductOfMasks(masks=({PUSH!r},)))",
        repr(Regional(MeanCurvature(0.01), PaintedMask.of(np.eye(2), np.zeros(2), name="inf"))),
        "1 + 2",
        "Eikonal() + 1",
        pytest.param("-" * 100_000 + "1", id="too many signs"),
        "Transport(SumOfVelocities((1, 2)))",
        "MeanCurvature(rate=",
        pytest.param("(" * 5000, id="too deep"),
        repr(Morph(Sphere(1.0))),
        pytest.param(repr(Transport(lambda x, t: x)), id="a function"),
    ],
)
def test_any_other_text_tells_none(text):
    assert equation_of({"equation": text}) is None


def test_no_text_tells_none():
    assert equation_of({}) is None
