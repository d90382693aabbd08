"""The zero set of a field as a shape."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.fields import Field
from levelflow.shapes.sampling import NoSurface as NoSurface
from levelflow.shapes.sampling import gap, sample_surface
from levelflow.shapes.shape import Samples, Shape, Solid


def value_of(key: Solid | Field) -> Callable[[Tensor], Tensor]:
    """The distance to a solid, or the values of a field, continued beyond its box if it has one."""
    if isinstance(key, Solid):
        return key.distance
    return key if key.box is None else Implicit(key).value


class Implicit(Shape):
    """The zero set of a static field.

    Args:
        field: A field with k = 0.
        box: Where to look for its surface; the box of the field if left out.

    Raises:
        ValueError: If the field depends on time, or no box is known.
    """

    def __init__(self, field: Field, *, box: Box | None = None) -> None:
        if field.times:
            raise ValueError(f"Implicit: the field depends on {field.times} time(s); give a slice, Implicit(f.at(t)).")
        box = box or field.box
        if box is None:
            raise ValueError("Implicit: the field has no box; say where its surface is with Implicit(field, box=...).")
        self.field = field
        self._search = box

    @cached_property
    def box(self) -> Box:
        """A box around samples of the surface, grown by a hundredth of its size."""
        points = self.sample(4096, generator=torch.Generator().manual_seed(0)).points
        around = Box.around(points)
        return around.expanded(0.01 * max(around.size))

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        """n points of the surface, uniform by area; see `sample_surface`.

        Raises:
            NoSurface: If the field has no zero in the box.
        """
        return sample_surface(self.field, n, box=self._search, generator=generator)

    def value(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """The field, continued beyond its box as it repeats itself, or else by the distance to that box."""
        if self.field.periodic and self._search == self.field.box:
            x = self._search.wrapped(x, self.field.periodic)
        inside = x.clamp(x.new_tensor(self._search.lower), x.new_tensor(self._search.upper))
        # A root whose derivatives are zero, not infinite, where nothing lies beyond the box.
        beyond = ((x - inside) ** 2).sum(1)
        out = beyond > 0
        return self.field(inside).to(x) + torch.where(out, beyond.where(out, 1.0).sqrt(), 0.0)

    def gap(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """|f| / |grad f|, the distance of points to the surface to first order."""
        return gap(self.field, x)
