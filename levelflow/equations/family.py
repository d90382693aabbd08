"""Families of surfaces with several parameters: a motion for each of them."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.equations.equation import Equation, LevelSetEquation
from levelflow.jets import Jet


class Family(Equation):
    r"""A motion for each of k parameters, $\partial_{t_i} f + v_i\,|\nabla f| = 0$ for $i = 1, \dots, k$.

    A point $(t_1, \dots, t_k)$ stands for the surface after each motion has run for its own time, and every line along
    one parameter is an animation by one motion. That is one surface whatever the order in which the motions run only
    where they commute: translations among themselves, rotations about one axis, curvature with anything rigid. Others
    have no family, and training settles on something between the orders.

    Args:
        motions: One for each parameter, in their order.

    Raises:
        ValueError: If there is no motion.
        TypeError: If one of them is not a level-set equation.

    Reference:
        Novello et al., Neural homotopies (2022), Secs. 3.3 and 4.1.3.
    """

    def __init__(self, *motions: LevelSetEquation) -> None:
        if not motions:
            raise ValueError("Family(): give a motion for each parameter, such as Family(bend, MeanCurvature(0.1)).")
        for motion in motions:
            if not isinstance(motion, LevelSetEquation):
                raise TypeError(f"Family: {motion!r} is no motion along the normal and has no parameter of its own.")
        self.motions = motions
        self.order = max(motion.order for motion in motions)
        self.sharpens = any(motion.sharpens for motion in motions)
        self.bends = any(motion.bends for motion in motions)
        self.averages = any(motion.averages for motion in motions)

    def __repr__(self) -> str:
        return f"Family({', '.join(map(repr, self.motions))})"

    @property
    def columns(self) -> tuple[Equation, ...]:
        return tuple(Along(motion, i) for i, motion in enumerate(self.motions))

    def residual(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, "n k"]:
        self._check(t)
        return torch.stack([column.residual(x, t, jet) for column in self.columns], dim=1)

    def error(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, "n k"]:
        self._check(t)
        return torch.stack([column.error(x, t, jet) for column in self.columns], dim=1)

    def _check(self, t: Tensor) -> None:
        if t.shape[1] != len(self.motions):
            raise ValueError(
                f"{self!r}: {len(self.motions)} motions for a field of {t.shape[1]} parameter(s); give one for each, "
                f"SIREN(time={len(self.motions)})."
            )


class Along(Equation):
    """A motion in one of several parameters."""

    is_speed = True

    def __init__(self, motion: LevelSetEquation, parameter: int) -> None:
        self.motion, self.parameter = motion, parameter
        self.order, self.sharpens = motion.order, motion.sharpens
        self.bounded, self.bends = motion.bounded, motion.bends

    def __repr__(self) -> str:
        return repr(self.motion)

    @property
    def leads_to(self) -> tuple[Box, ...]:
        return self.motion.leads_to

    def carry(self, x: Tensor, start: Tensor, end: Tensor, *, steps: int = 32) -> Tensor | None:
        return self.motion.carry(x, start, end, steps=steps)

    def held(self, x: Tensor) -> Tensor:
        return self.motion.held(x)

    def residual(self, x: Tensor, t: Tensor, jet: Jet) -> Tensor:
        return self.motion.residual(x, t[:, self.parameter, None], jet.along(self.parameter))

    def error(self, x: Tensor, t: Tensor, jet: Jet) -> Tensor:
        return self.motion.error(x, t[:, self.parameter, None], jet.along(self.parameter))
