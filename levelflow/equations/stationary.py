"""No motion."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from levelflow.equations.equation import LevelSetEquation
from levelflow.jets import Jet


@dataclass(frozen=True)
class Stationary(LevelSetEquation):
    r"""The surface stands still, $\partial_t f = 0$.

    With shapes given at several times it is the morph that changes f least.

    Reference:
        Novello et al., Neural homotopies (2022), Sec. 6.3.5.
    """

    def speed(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, " n"]:
        return torch.zeros_like(jet.value)

    def held(self, x: Float[Tensor, "n d"]) -> Bool[Tensor, " n"]:
        return torch.ones(len(x), dtype=torch.bool, device=x.device)

    def carry(
        self, x: Float[Tensor, "n d"], start: Float[Tensor, " n"], end: Float[Tensor, " n"], *, steps: int = 1
    ) -> Float[Tensor, "n d"]:
        return x
