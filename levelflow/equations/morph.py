"""Morphing towards given shapes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.equations.equation import LevelSetEquation
from levelflow.fields import Field
from levelflow.jets import Jet
from levelflow.shapes.implicit import Implicit, value_of
from levelflow.shapes.shape import Solid
from levelflow.shapes.tabulated import Tabulated

_SOON = 1e-6
"""The least time that counts as remaining."""


class Morph(LevelSetEquation):
    r"""Morphing towards the level sets of a target g, $\partial_t f = |\nabla f|\,(g - f) / (t_1 - t)$.

    Where f lies inside the target the surface moves out, and where it lies outside, in. Divided by the time that
    remains, the speed reaches the target exactly at t1: distances of concentric spheres give r(t) linear in time. (The
    speed g - f of the paper leaves a factor 1/e of the difference after unit time.) The error that training sees is
    multiplied by the part of the time that remains, so that it stays bounded at the end. After the last target nothing
    moves.

    A distance to a mesh is tabulated on a grid once, because the speed is needed at new points in every step.

    Args:
        target: The shape or field to arrive at; or several of them by their times, {0.5: bob, 1.0: torus}, each
            approached after the one before.
        since: The time of departure, from which the remaining part of the time is counted.
        until: The time t1 of arrival, for a single target.

    Raises:
        TypeError: If a target has no distance.
        ValueError: If a target is to be reached before the departure.

    Reference:
        Novello et al., Neural Implicit Surface Evolution, ICCV 2023, Sec. 5.3, eqs. 9 and 10.
    """

    def __init__(
        self, target: Solid | Field | Mapping[float, Solid | Field], *, since: float = 0.0, until: float = 1.0
    ) -> None:
        targets = dict(target) if isinstance(target, Mapping) else {until: target}
        if min(targets) <= since:
            raise ValueError(f"Morph: a target at t = {min(targets):g} is not after the departure at t = {since:g}.")
        self.since, self.targets = since, dict(sorted(targets.items()))
        self._values = [goal_of(shape, call="Morph") for shape in self.targets.values()]

    def __repr__(self) -> str:
        return f"Morph(towards {len(self.targets)} target(s) at t = {', '.join(f'{t:g}' for t in self.targets)})"

    @property
    def leads_to(self) -> tuple[Box, ...]:
        return tuple(box for target in self.targets.values() for box in box_of(target))

    def speed(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, " n"]:
        which, remaining, _ = self._next(t)
        return -gaps(self._values, which, x, jet) / remaining.clamp_min(_SOON).to(jet.value)

    def weight(self, t: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
        which, remaining, interval = self._next(t)
        return torch.where(which < len(self.targets), remaining.clamp_min(_SOON) / interval, 1.0)

    def _next(self, t: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """For each time the number of the next target, the time that remains, and the whole time of its approach.

        After the last target the number is one too many, and nothing moves.
        """
        arrivals = t.new_tensor(list(self.targets))
        starts = torch.cat([arrivals.new_tensor([self.since]), arrivals[:-1]])
        which = torch.searchsorted(arrivals, t[:, 0].contiguous())
        i = which.clamp_max(len(arrivals) - 1)
        return which, arrivals[i] - t[:, 0], (arrivals - starts)[i]


def gaps(goals: Sequence[Callable[[Tensor], Tensor]], which: Tensor, x: Tensor, jet: Jet) -> Tensor:
    """By how much the value of each point's goal exceeds that of the field, (n,); 0 where the number is of no goal."""
    gap = torch.zeros_like(jet.value)
    for i, goal in enumerate(goals):
        mine = (which == i).to(jet.value.device)
        if mine.any():
            with torch.no_grad():
                value = goal(x[mine]).to(jet.value)
            gap[mine] = value - jet.value[mine]
    return gap


def box_of(target: Solid | Field) -> tuple[Box, ...]:
    """The box around a target; none for a field that is known everywhere."""
    if isinstance(target, Solid):
        return (target.box,)
    return () if target.box is None else (Implicit(target).box,)


def goal_of(shape: Solid | Field, *, call: str) -> Callable[[Tensor], Tensor]:
    """The values of a target, from a table where they are costly.

    Raises:
        TypeError: If it has none.
    """
    if not isinstance(shape, Solid | Field):
        raise TypeError(
            f"{call}: a target of type {type(shape).__name__} has no distance; fit a field to it and give that."
        )
    return value_of(Tabulated(shape) if isinstance(shape, Solid) and shape.is_costly else shape)
