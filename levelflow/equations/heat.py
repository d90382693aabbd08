"""The heat equation."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from levelflow.equations.equation import Equation
from levelflow.jets import Jet


@dataclass(frozen=True)
class Heat(Equation):
    r"""The values of f spread like heat, $\partial_t f = \alpha\,\Delta f$.

    Where f is a distance, $|\nabla f| = 1$, this is motion by mean curvature; but f does not stay a distance, and the
    two part at once. From $|x|^2 - r_0^2$ in $\mathbb{R}^d$ heat makes $|x|^2 - r_0^2 + 2 d \alpha t$, a sphere with
    $r^2 = r_0^2 - 2 d \alpha t$; by mean curvature it has $r^2 = r_0^2 - 2 (d - 1) \alpha t$. A wave $\sin k x$ decays
    like $e^{-\alpha k^2 t}$, which flattens f and leaves its zeros where they are.

    All values of f take part, not its zero set alone: it is solved in the whole box, and what is given counts there
    with its values. Give a field, or a solid for its distance. Nothing is said about the sides of the box, so what
    comes from there is the network's guess: choose a box wider than the surface by a few $\sqrt{\alpha t}$. Backwards
    in time waves grow without bound.

    Attributes:
        rate: The coefficient $\alpha > 0$, in length^2 per unit time.

    Raises:
        ValueError: If `rate` is not positive.

    Reference:
        Novello et al., Neural homotopies (2022), Sec. 4.2.2.
    """

    rate: float

    order = 2
    is_rate = True
    sharpens = True

    def __post_init__(self) -> None:
        if not self.rate > 0:
            raise ValueError(
                f"Heat(rate={self.rate:g}): the rate must be positive. "
                "To sharpen, run time backwards: solve(..., until=-0.1)."
            )

    def residual(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, " n"]:
        return self._rate(jet) - self.rate * jet.hessian.diagonal(dim1=1, dim2=2).sum(1)
