"""The zero set of a field as a shape."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.curvature import gradient_norm, normal
from levelflow.fields import Field
from levelflow.shapes.shape import Samples, Shape, Solid


class NoSurface(ValueError):
    """The field has no zero where it was looked for."""


def value_of(key: Solid | Field) -> Callable[[Tensor], Tensor]:
    """The distance to a solid, or the values of a field, continued beyond its box if it has one."""
    if isinstance(key, Solid):
        return key.distance
    return key if key.box is None else Implicit(key).value


class Implicit(Shape):
    """The zero set of a static field, sampled by projection.

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
        """n points of the surface by Newton steps from uniform points of the box.

        Only points within a thin band around the surface are taken, by |f| / |grad f|, so that the density of the
        samples is nearly uniform by area. Where the surface fills little of the box, the search closes in on it.

        Raises:
            NoSurface: If the field has no zero in the box.
        """
        box, found, count = self._search, [], 0
        for attempt in range(64):
            x = box.uniform(8 * n, generator=generator)
            x, normals = self._project(x[self.gap(x) < 0.05 * max(box.size)])
            found.append(Samples(x.cpu(), normals.cpu()))
            count += len(x)
            if count >= n:
                return Samples(torch.cat([s.points for s in found])[:n], torch.cat([s.normals for s in found])[:n])
            if attempt % 4 == 3:
                if not count:
                    if attempt > 8:
                        break
                    continue
                # A few points show only a part of the surface, so the box around them is widened; and they go, for
                # they are denser or sparser than those of the new box.
                around = Box.around(torch.cat([s.points for s in found]))
                margin = 1.0 if count < 200 else 0.1
                box = around.expanded(margin * max(*around.size, 1e-3 * max(self._search.size)))
                found, count = [], 0
        raise NoSurface(
            f"Implicit.sample: the field has (almost) no zero in the box {self._search.lower} to "
            f"{self._search.upper}; its surface has vanished or lies outside."
        )

    def value(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """The field, continued beyond its box as it repeats itself, or else by the distance to that box."""
        if self.field.periodic and self._search == self.field.box:
            x = self._search.wrapped(x, self.field.periodic)
        inside = x.clamp(x.new_tensor(self._search.lower), x.new_tensor(self._search.upper))
        # A root whose derivatives are zero, not infinite, where nothing lies beyond the box.
        beyond = ((x - inside) ** 2).sum(1)
        out = beyond > 0
        return self.field(inside).to(x) + torch.where(out, beyond.where(out, 1.0).sqrt(), 0.0)

    @torch.no_grad()
    def gap(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """|f| / |grad f|, the distance of points to the surface to first order; in pieces, for the sake of memory."""
        jets = [self.field.jet(part, order=1) for part in x.split(1 << 15)]
        return torch.cat([jet.value.abs() / gradient_norm(jet) for jet in jets]).to(x)

    @torch.no_grad()
    def _project(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Points moved to the surface by four Newton steps, and the normals; points that do not arrive are dropped."""
        for _ in range(4):
            jet = self.field.jet(x, order=1)
            step = (jet.value / gradient_norm(jet) ** 2)[:, None] * jet.gradient
            x = x - step.to(x)
        jet = self.field.jet(x, order=1)
        arrived = (jet.value.abs() / gradient_norm(jet) < 1e-4 * max(self._search.size)).to(x.device)
        arrived &= self._search.contains(x)
        return x[arrived], normal(jet).to(x)[arrived]
