"""Motion by mean curvature."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from levelflow.curvature import total_curvature
from levelflow.equations.equation import LevelSetEquation
from levelflow.jets import Jet


@dataclass(frozen=True)
class MeanCurvature(LevelSetEquation):
    r"""Motion by mean curvature, $\partial_t f = \alpha\,|\nabla f|\,\operatorname{div} n$.

    Each point moves along its normal with speed $-\alpha\,(k_1 + k_2)$: bumps sink, dents rise. Backwards in time the
    motion sharpens and is ill-posed; keep such intervals short. A sphere stays a sphere, $r(t)^2 = r_0^2 - 4\alpha t$,
    and a circle in the plane a circle, $r(t)^2 = r_0^2 - 2\alpha t$.

    Attributes:
        rate: The coefficient $\alpha > 0$, in length^2 per unit time.

    Raises:
        ValueError: If `rate` is not positive.

    Reference:
        Novello et al., Neural Implicit Surface Evolution, ICCV 2023, Sec. 5.2, eq. 8.
    """

    rate: float

    order = 2
    sharpens = True
    contracts = True

    def __post_init__(self) -> None:
        if not self.rate > 0:
            raise ValueError(
                f"MeanCurvature(rate={self.rate:g}): the rate must be positive. "
                "To sharpen, run time backwards: solve(..., until=-0.1)."
            )

    def speed(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, " n"]:
        return -self.rate * total_curvature(jet)
