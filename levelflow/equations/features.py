"""Smoothing that keeps features: motion by curvature that slows down where the surface is sharply bent."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from levelflow.curvature import principal_curvatures
from levelflow.equations.equation import LevelSetEquation
from levelflow.jets import Jet


@dataclass(frozen=True)
class FeaturePreserving(LevelSetEquation):
    r"""Motion by the principal curvatures, each weighed by its size: noise sinks, edges and corners stay.

    The speed along the normal is $-\alpha\,(w(k_1)\,k_1 + w(k_2)\,k_2)$. The weight is 1 up to the threshold, $|k| \le
    \lambda$, where this is motion by mean curvature, and $(\lambda / k)^2$ beyond it. Across an edge one curvature is
    large and hardly counts; along it the other smooths the edge as a curve. Ripples of amplitude a and wavelength l
    bend by $4 \pi^2 a / l^2$, and the threshold is best a little above that.

    A circle of radius r below $1 / \lambda$ shrinks like $r = r_0 e^{-\alpha \lambda^2 t}$, and one above it as by mean
    curvature, $r^2 = r_0^2 - 2 \alpha t$, until it is as small as that; for a sphere both rates are twice as large.

    Where $w(k)\,k$ falls with k the motion is ill-posed, as smoothing of this kind is: bends beyond the threshold
    sharpen slowly, so run it for as long as the noise takes and no longer. With a weight of $\lambda / |k|$, which only
    saturates, it would be well posed, and corners sink nearly twice as far. With that of the reference, $\lambda^2 /
    (\lambda^2 + 10\,(|k| - \lambda)^2)$, they sink a little less, but circles just beyond the threshold, where it falls
    fastest, are off by a fifth.

    Attributes:
        rate: The coefficient $\alpha > 0$, in length^2 per unit time.
        threshold: The curvature $\lambda > 0$ beyond which a bend is a feature, in 1 / length: 1 / radius.

    Raises:
        ValueError: If the rate or the threshold is not positive.

    Reference:
        Hildebrandt and Polthier, Anisotropic filtering of non-linear surface features, Comput. Graph. Forum 23 (2004).
    """

    rate: float
    threshold: float

    order = 2
    sharpens = True
    contracts = True
    bounded = True

    def __post_init__(self) -> None:
        if not self.rate > 0 or not self.threshold > 0:
            raise ValueError(
                f"{self!r}: the rate and the threshold must be positive. The threshold is 1 / r for the least radius r "
                "of bends that are to be smoothed like all others."
            )

    def speed(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, " n"]:
        k = principal_curvatures(jet)
        weight = (self.threshold / k.abs().clamp_min(self.threshold)) ** 2
        return -self.rate * (weight * k).sum(1)
