"""What a surface must offer: a box around it, samples with normals and, for a solid, a signed distance."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box


class Samples(NamedTuple):
    """Points of a surface and the outward unit normals there."""

    points: Float[Tensor, "n d"]
    normals: Float[Tensor, "n d"]


class Shape(ABC):
    """A surface in R^d that can be sampled."""

    @property
    @abstractmethod
    def box(self) -> Box:
        """The smallest box around the surface, in the units of the shape."""

    @abstractmethod
    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        """n points drawn uniformly by area, with outward unit normals, float64 on the generator's device."""


class Solid(Shape):
    """A surface that bounds a solid, so that every point of space has a signed distance.

    Attributes:
        is_costly: Whether a distance takes so long that it pays to tabulate it.
    """

    is_costly: bool = False

    @abstractmethod
    def distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """The exact distance to the surface, negative inside, in the units, dtype and device of x."""
