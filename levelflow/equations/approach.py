"""Inflating and deflating towards a shape, without a time of arrival."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.equations.equation import LevelSetEquation
from levelflow.equations.morph import box_of, goal_of
from levelflow.fields import Field
from levelflow.jets import Jet
from levelflow.shapes.shape import Solid


class Approach(LevelSetEquation):
    r"""Motion towards a target g by its own distance, $\partial_t f = \alpha\,|\nabla f|\,g$.

    The surface moves along its normal with speed $-\alpha g$: out where it is inside the target, in where it is
    outside. It starts from one given shape and never quite arrives: what separates it from a target around the same
    centre falls by a factor e in every time of length $1 / \alpha$, $r(t) = r_1 + (r_0 - r_1)\, e^{-\alpha t}$ for
    spheres. A part of the target that the start does not touch is never born. `Morph` arrives at a given time, and may
    go on from there.

    A distance to a mesh is tabulated on a grid once, because the speed is needed at new points in every step.

    Args:
        target: The shape or field to tend to.
        rate: The coefficient $\alpha > 0$, per unit time; 1 in the paper.

    Raises:
        TypeError: If the target has no distance.
        ValueError: If `rate` is not positive.

    Reference:
        Novello et al., Neural homotopies (2022), Sec. 4.3.1, eqs. 8 and 9.
    """

    def __init__(self, target: Solid | Field, *, rate: float = 1.0) -> None:
        if not rate > 0:
            raise ValueError(
                f"Approach(rate={rate:g}): the rate must be positive. To go from a target to a shape, start there: "
                "solve(Approach(shape), at={0.0: target})."
            )
        self.target, self.rate = target, rate
        self._value = goal_of(target, call="Approach")

    def __repr__(self) -> str:
        return f"Approach(towards a {type(self.target).__name__}, rate={self.rate:g})"

    @property
    def leads_to(self) -> tuple[Box, ...]:
        return box_of(self.target)

    def speed(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, " n"]:
        with torch.no_grad():
            return -self.rate * self._value(x).to(jet.value)
