"""The solid where a formula is negative."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.shapes.shape import Samples, Solid

_ATTEMPTS = 64


class Level(Solid):
    r"""The solid $f(x) < 0$ of a formula, in a box: its surface ends at the sides, or goes on in the next cell.

    **The distance is that to first order**, $f / |\nabla f|$: it vanishes where it is to and grows at the rate 1 from
    there. Motions by curvature need no more, since all fields with the same zero set move alike under them.

    Args:
        formula: f for points (n, d), differentiable, in the units of the box.
        box: The box, of the plane or of space.
    """

    def __init__(self, formula: Callable[[Tensor], Tensor], box: Box) -> None:
        self.formula, self._box = formula, box

    @property
    def box(self) -> Box:
        return self._box

    def distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        value, gradient = self._value(x)
        return value / torch.linalg.vector_norm(gradient, dim=1).clamp_min(torch.finfo(x.dtype).tiny ** 0.5)

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        """Points of a thin band around the surface, moved to it by Newton steps: nearly uniform by area.

        Raises:
            ValueError: If the surface does not pass through the box.
        """
        found: list[Samples] = []
        size = max(self._box.size)
        for _ in range(_ATTEMPTS):
            x = self._box.uniform(8 * n, generator=generator)
            x = x[self.distance(x).abs() < 0.02 * size]
            for _ in range(5):
                value, gradient = self._value(x)
                x = x - (value / (gradient * gradient).sum(1))[:, None] * gradient
            value, gradient = self._value(x)
            slope = torch.linalg.vector_norm(gradient, dim=1)
            arrived = self._box.contains(x) & (value.abs() < 1e-9 * size * slope)
            found.append(Samples(x[arrived], (gradient / slope[:, None])[arrived]))
            if sum(len(part.points) for part in found) >= n:
                return Samples(*(torch.cat(parts)[:n] for parts in zip(*found, strict=True)))
        raise ValueError(
            f"Level.sample: the formula has (almost) no zero in the box from {self._box.lower} to {self._box.upper}; "
            "give the box around its surface."
        )

    def _value(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """The formula and its gradient."""
        with torch.enable_grad():
            x = x.detach().requires_grad_()
            value = self.formula(x)
            (gradient,) = torch.autograd.grad(value.sum(), x)
        return value.detach(), gradient
