"""No equation at all."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from levelflow.equations.equation import Equation
from levelflow.jets import Jet


@dataclass(frozen=True)
class Unconstrained(Equation):
    """Nothing is asked of the field between the given shapes; added to another equation it changes nothing.

    What lies between two shapes is then left to the network: to the bounds of a `LipschitzMLP`, which are there for
    that, or to the habits of a `SIREN`, which are a control for what an equation adds.

    Reference:
        Liu et al., Learning Smooth Neural Functions via Lipschitz Regularization, SIGGRAPH 2022, Sec. 4.
    """

    @property
    def columns(self) -> tuple[Equation, ...]:
        return ()

    def residual(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, "n 0"]:
        return jet.value.new_zeros(len(x), 0)

    def __add__(self, other: Equation) -> Equation:
        return other
