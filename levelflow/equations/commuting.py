"""Whether the order matters in which the motions of a family run."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterator, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.equations.equation import LevelSetEquation
from levelflow.equations.family import Family
from levelflow.equations.regional import Regional

TOLERANCE = 1e-3
"""The share of the box, or of a length, by which two orders may differ and still count as one."""

_POINTS = 500
# The distance of the differences that tell how a motion stretches lengths, as a part of the box.
_NEAR = 1e-4


def warn_of_order(family: Family, box: Box, start: Sequence[float], outcome: str, *, call: str) -> None:
    r"""Warns of motions that do not commute: they have no family of surfaces.

    Of two motions with characteristics $\Phi$ and $\Psi$, points of the box are carried by $\Psi \circ \Phi$ and by
    $\Phi \circ \Psi$, and what is between them is compared to the box. Motions that depend on the surface, as curvature
    does, commute with rigid motions at most: the strain $\frac12 (D\Phi^\top D\Phi - I)$ of the other is looked at, by
    differences, and the mask of one that is `Regional`.

    Args:
        family: The motions.
        box: Where the points are, with the interval of each parameter.
        start: The parameters at which the shape is given.
        outcome: What becomes of motions that do not commute, in a sentence.
        call: Who asks, for the warning.
    """
    # Each motion runs to the end of its interval that is further off.
    end = [max(ends, key=lambda t: abs(t - since)) for ends, since in zip(box.times, start, strict=False)]
    runs = [_Run(motion, *ends) for motion, *ends in zip(family.motions, start, end, strict=False)]
    x = box.uniform(_POINTS, generator=torch.Generator().manual_seed(0))
    found = [
        complaint for pair in itertools.combinations(runs, 2) for complaint in _complaints(*pair, x, max(box.size))
    ]
    if found:
        warnings.warn(
            f"{call}: not all motions of the family commute. {' '.join(found)} What they make of a shape depends on "
            f"which of them runs first. {outcome}",
            stacklevel=3,
        )


class _Run:
    """A motion from one value of its parameter to another."""

    def __init__(self, motion: LevelSetEquation, start: float, end: float) -> None:
        self.motion, self.start, self.end = motion, start, end

    def __repr__(self) -> str:
        return repr(self.motion)

    def carry(self, x: Float[Tensor, "n d"]) -> Float[Tensor, "n d"] | None:
        return self.motion.carry(x, x.new_full((len(x),), self.start), x.new_full((len(x),), self.end))

    def strain(self, x: Float[Tensor, "n d"], step: float) -> float:
        """The greatest entry of the strain, by central differences."""
        columns = []
        for axis in torch.eye(x.shape[1], dtype=x.dtype) * step:
            ahead, behind = self.carry(x + axis), self.carry(x - axis)
            assert ahead is not None
            assert behind is not None
            columns.append((ahead - behind) / (2 * step))
        slopes = torch.stack(columns, dim=2)
        strain = (slopes.transpose(1, 2) @ slopes - torch.eye(x.shape[1], dtype=x.dtype)) / 2
        return float(strain.abs().max())


def _complaints(one: _Run, other: _Run, x: Tensor, size: float) -> Iterator[str]:
    """A sentence if two motions do not commute, as far as that can be told."""
    with torch.no_grad():
        moved, after = one.carry(x), other.carry(x)
        if moved is not None and after is not None:
            first, second = one.carry(after), other.carry(moved)
            assert first is not None
            assert second is not None
            apart = float(torch.linalg.vector_norm(first - second, dim=1).max())
            if apart > TOLERANCE * size:
                yield (
                    f"{one!r} before {other!r} takes points up to {apart:.3g} away from where the other order does, "
                    f"{100 * apart / size:.2g} % of the box."
                )
        elif moved is not None or after is not None:
            rigid, bending, there = (one, other, moved) if after is None else (other, one, after)
            assert there is not None
            strain = rigid.strain(x, _NEAR * size)
            mask = bending.motion.mask if isinstance(bending.motion, Regional) else None
            if strain > TOLERANCE:
                yield f"{rigid!r} has a strain of {strain:.2g}: it changes lengths, on which {bending!r} depends."
            elif mask is not None and (change := float((mask(x) - mask(there)).abs().max())) > TOLERANCE:
                yield f"{rigid!r} takes points to where the mask of {bending!r} is another, by up to {change:.2g}."
