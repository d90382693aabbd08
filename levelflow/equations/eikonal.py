"""The eikonal equation."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from levelflow.curvature import gradient_norm
from levelflow.equations.equation import Equation
from levelflow.jets import Jet


@dataclass(frozen=True)
class Eikonal(Equation):
    r"""The field is a distance at every time, $|\nabla f| = 1$.

    It says nothing about motion: with shapes given at two times it morphs one into the other through distance fields.
    Together with motion by mean curvature it is a contradiction, since that motion flattens f.

    Reference:
        Novello et al., Neural Implicit Surface Evolution, ICCV 2023, eq. 1; Neural homotopies (2022), eq. 11.
    """

    def residual(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, " n"]:
        return gradient_norm(jet) - 1
