"""Motions that act in one region more than in another."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.equations.equation import LevelSetEquation
from levelflow.equations.masks import Mask
from levelflow.equations.transport import Transport
from levelflow.jets import Jet


class Regional(LevelSetEquation):
    r"""A motion whose speed is multiplied by a mask of the place, $v(x, t) = m(x)\,v_0(x, t)$.

    Where the mask is 0 the surface stands still: what is there is a boundary for the rest, and `solve` asks for the
    given shape there at every time. Mean curvature with a fixed region leads to soap films, since minimal surfaces are
    where it comes to rest. A motion by a velocity field remains one, by $m(x)\,V(x, t)$, and keeps its characteristics.

    Args:
        motion: The motion where the mask is 1.
        mask: Numbers for points (n, d): `BoxMask`, `SphereMask`, `PaintedMask`, a function, or a static field; smooth,
            for the sake of the network.

    Raises:
        TypeError: If the motion is none along the normal, or the mask is not a function of points.

    Reference:
        Novello et al., Neural homotopies (2022), Sec. 4.2.3.
    """

    def __init__(self, motion: LevelSetEquation, mask: Mask) -> None:
        if not isinstance(motion, LevelSetEquation):
            raise TypeError(
                f"Regional({motion!r}, ...): this is no motion along the normal; only its speed has a mask."
            )
        if not callable(mask):
            raise TypeError(f"Regional({motion!r}, {mask!r}): the mask is to be a function of points, or a field.")
        self.motion, self.mask = motion, mask
        self.order, self.sharpens = motion.order, motion.sharpens
        self.bounded, self.bends, self.averages = motion.bounded, motion.bends, motion.averages

    def __repr__(self) -> str:
        return f"Regional({self.motion!r}, {self.mask!r})"

    @property
    def leads_to(self) -> tuple[Box, ...]:
        return self.motion.leads_to

    def speed(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, " n"]:
        return self._mask(x).to(jet.value) * self.motion.speed(x, t, jet)

    def weight(self, t: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
        return self.motion.weight(t)

    def held(self, x: Float[Tensor, "n d"]) -> Bool[Tensor, " n"]:
        return self._mask(x).to(x.device) == 0

    def carry(
        self, x: Float[Tensor, "n d"], start: Float[Tensor, " n"], end: Float[Tensor, " n"], *, steps: int = 32
    ) -> Float[Tensor, "n d"] | None:
        """The characteristics of the masked velocity field, by Runge and Kutta's method."""
        if not isinstance(self.motion, Transport):
            return None
        velocity = self.motion.velocity
        masked = Transport(lambda x, t: self._masked(x).to(x)[:, None] * velocity(x, t))
        return masked.carry(x, start, end, steps=steps)

    @torch.no_grad()
    def _mask(self, x: Tensor) -> Tensor:
        return self._masked(x)

    def _masked(self, x: Tensor) -> Tensor:
        mask = self.mask(x)
        if mask.shape != x.shape[:1]:
            raise ValueError(
                f"{self!r}: the mask has the shape {tuple(mask.shape)} at {len(x)} points; one number each is needed."
            )
        return mask
