"""Willmore flow: motion that lowers the bending energy."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from levelflow.curvature import squared_curvature, surface_laplacian, total_curvature
from levelflow.equations.equation import LevelSetEquation
from levelflow.jets import Jet


@dataclass(frozen=True)
class Willmore(LevelSetEquation):
    r"""Willmore flow, the steepest descent of the bending energy $\int H^2$, $H = (k_1 + k_2)/2$.

    Each point moves along its normal with the speed

    $$v = \tfrac{\alpha}{2}\bigl(\Delta_\Gamma \kappa + \kappa\,(k_1^2 + k_2^2) - \tfrac12 \kappa^3\bigr)
        = \alpha\,\bigl(\Delta_\Gamma H + 2 H (H^2 - K)\bigr), \qquad \kappa = k_1 + k_2 .$$

    Spheres, of energy $4\pi$ whatever their size, and tori with $R = \sqrt2\,r$, of energy $2\pi^2$, stand still; what
    is nearly one of them becomes one. In the plane it is the descent of $\frac14 \int \kappa^2$, and a circle grows:
    $r(t)^4 = r_0^4 + \alpha t$.

    The speed has fourth derivatives of f. `solve` trains a second network for the curvature and asks the two to agree,
    so that jets stay of second order; a jet given to this equation by hand needs `Jet.curvature`. Backwards in time the
    flow is ill-posed. Narrow holes and thin parts are followed best in a box that is little larger than the surface:
    `solve(..., box=...)`.

    Attributes:
        rate: The coefficient $\alpha > 0$, in length^4 per unit time.

    Raises:
        ValueError: If `rate` is not positive.

    Reference:
        Droske and Rumpf, A level set formulation for Willmore flow, Interfaces and Free Boundaries 6 (2004); Novello et
        al., Neural homotopies (2022), Sec. 8.
    """

    rate: float

    order = 2
    sharpens = True
    bends = True

    def __post_init__(self) -> None:
        if not self.rate > 0:
            raise ValueError(f"Willmore(rate={self.rate:g}): the rate must be positive.")

    def speed(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, " n"]:
        if jet.curvature is None:
            raise ValueError(
                f"{self!r}: the jet says nothing of the derivatives of the curvature; give it the jet of a field of "
                "the curvature, Jet(..., curvature=...)."
            )
        kappa = total_curvature(jet)
        bending = surface_laplacian(jet, jet.curvature) + kappa * squared_curvature(jet) - kappa**3 / 2
        return self.rate / 2 * bending
