"""The exact solution of motions by velocity fields."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box, Until, intervals
from levelflow.conditions import box_around, surface_of
from levelflow.equations.commuting import warn_of_order
from levelflow.equations.equation import Equation
from levelflow.equations.family import Along, Family
from levelflow.fields import Field
from levelflow.jets import Jet
from levelflow.shapes.implicit import value_of
from levelflow.shapes.shape import Shape, Solid

# Points carried at once: few enough for the many small steps to stay in the cache of a processor.
_AT_ONCE = 1 << 13


class Transported(Field):
    r"""A shape or field carried along characteristics, $f(x, t) = f_0(\Phi_{t \to t_0}(x))$, without any training.

    For a `Family` it is carried along each motion in turn, the first before the second; that solves the equations of
    all parameters where the motions commute.

    Its surface is exact up to the Runge-Kutta steps, whatever the motion draws out, and up to nothing where the
    velocity has a formula for its flow; a network of space and time cannot hold what is thinner than its details. Every
    value costs the way back and a value of f0, so a mesh is best fitted first. Values are those of f0, so |grad f| is
    what the motion makes of it.

    Args:
        motion: An equation with characteristics: `Transport`, `Stationary`, or a `Family` of these.
        shape: A solid, or a static field with a box, such as one from `fit`.
        until: The other end of the time interval, or both ends; of a family one of these for each parameter.
        box: Where the field is to be looked at, with the interval of its time, instead of `until`. If left out, the box
            of the shape, carried along, and a margin.
        time: The time $t_0$ at which the shape is given; for a family, unless it is the same number, one for each.
        steps: Runge-Kutta steps of each evaluation and motion; if left out, as many as bring points of the box to their
            place within a hundred thousandth of its size.

    Attributes:
        provenance: Where the field comes from, for reports and files: plain values under string keys.

    Raises:
        ValueError: If a motion depends on the surface, or an interval of time is missing.

    Warns:
        UserWarning: If two motions of a family do not commute.

    Reference:
        Novello et al., Neural homotopies (2022), Secs. 3.3 and 4.1.2.
    """

    box: Box

    def __init__(
        self,
        motion: Equation,
        shape: Solid | Field,
        *,
        until: Until = None,
        box: Box | None = None,
        time: float | Sequence[float] = 0.0,
        steps: int | None = None,
    ) -> None:
        super().__init__()
        motions = motion.columns
        k = len(motions)
        start = tuple(map(float, time)) if isinstance(time, Sequence) else (float(time),) * k
        if len(start) != k:
            raise ValueError(f"Transported(time={time}): the motion has {k} parameter(s); give a number for each.")
        if box is None:
            ends = intervals([[t] for t in start], until, call="Transported")
            surface = surface_of(shape)
            if isinstance(motion, Family):
                box = reach_of_family(motion, [surface], [start], ends).during(*ends)
            else:
                box = reach(motion, {start[0]: surface}, ends[0]).during(*ends)
        if len(box.times) != k:
            example = ", ".join(["(0, 1)"] * k)
            raise ValueError(
                f"Transported: the box has {len(box.times)} times and the motion {k}; give an interval for each, "
                f"box.during({example})."
            )
        for part in motions:
            if not part.has_characteristics(box.space):
                raise ValueError(f"Transported: {part!r} depends on the surface and has no characteristics; solve it.")
        if isinstance(motion, Family):
            warn_of_order(motion, box, start, "They run in the order in which they are given.", call="Transported")
        self.motion, self.shape, self.time = motion, shape, start if k > 1 else start[0]
        self._start = start
        self.steps = steps or max(
            _enough_steps(part, box, ends, t) for part, ends, t in zip(motions, box.times, start, strict=True)
        )
        self.value = value_of(shape)
        self.box, self.space, self.times = box, box.space, k
        self.provenance: dict[str, Any] = {}

    def forward(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None) -> Float[Tensor, " n"]:
        x, t = self._inputs(x, t)
        start = t.new_tensor(self._start).expand_as(t)
        pieces = zip(x.split(_AT_ONCE), t.split(_AT_ONCE), start.split(_AT_ONCE), strict=True)
        return self.value(torch.cat([self._back(*piece) for piece in pieces]))

    def carry(
        self, x: Float[Tensor, "n d"], start: Float[Tensor, "n k"], end: Float[Tensor, "n k"]
    ) -> Float[Tensor, "n d"]:
        if self.times == 1:
            return self._back(x, start, end)
        given = start.new_tensor(self._start).expand_as(start)
        x = self._back(x, start, given)
        for i, motion in enumerate(self.motion.columns):
            x = self._along(motion, x, given[:, i], end[:, i])
        return x

    def _back(self, x: Tensor, start: Tensor, end: Tensor) -> Tensor:
        """Along each motion in turn, the last first."""
        for i, motion in reversed(list(enumerate(self.motion.columns))):
            x = self._along(motion, x, start[:, i], end[:, i])
        return x

    def _along(self, motion: Equation, x: Tensor, start: Tensor, end: Tensor) -> Tensor:
        carried = motion.carry(x, start, end, steps=self.steps)
        assert carried is not None
        return carried

    def push(self, jet: Jet) -> Jet:
        """The chain rule, with derivatives of f by automatic differentiation; a Hessian where f0 has one."""
        # The graph of a piece holds every Runge-Kutta step of it.
        at_once = max(256, (1 << 18) // (self.steps * self.times))
        pieces = [self._derivatives(z, jet.order) for z in jet.value.detach().split(at_once)]
        value, slope, bend = (torch.cat(part) if part[0] is not None else None for part in zip(*pieces, strict=True))
        assert value is not None
        first, second = None, None
        if jet.first is not None:
            first = torch.einsum("nim,nm->ni", jet.first, slope)
        if jet.second is not None:
            du = jet.gradient
            second = torch.einsum("nijm,nm->nij", jet.second, slope)
            second = second + torch.einsum("nim,nmk,njk->nij", du, bend, du)
        return Jet(value, first, second, jet.space)

    def _derivatives(self, z: Tensor, order: int) -> tuple[Tensor, Tensor | None, Tensor | None]:
        """Value, gradient and Hessian in the coordinates z of space and time, as far as they are asked for."""
        with torch.set_grad_enabled(order > 0):
            z = z.requires_grad_(order > 0)
            value = self(z[:, : self.space], z[:, self.space :])
            if order == 0:
                return value, None, None
            (slope,) = torch.autograd.grad(value.sum(), z, create_graph=order > 1)
            if order == 1:
                return value.detach(), slope, None
            rows = [torch.autograd.grad(slope[:, i].sum(), z, retain_graph=True)[0] for i in range(z.shape[1])]
        return value.detach(), slope.detach(), torch.stack(rows, dim=1)


def _enough_steps(motion: Equation, box: Box, ends: tuple[float, float], time: float) -> int:
    """The power of two after which twice as many steps move no point by more than 1e-5 of the box."""
    generator = torch.Generator().manual_seed(0)
    x = box.uniform(500, generator=generator)
    t = torch.tensor(ends, dtype=torch.float64)[torch.randint(2, (500,), generator=generator)]
    start = torch.full_like(t, time)
    steps, carried = 4, motion.carry(x, t, start, steps=4)
    while steps < 1024:
        finer = motion.carry(x, t, start, steps=2 * steps)
        assert carried is not None
        assert finer is not None
        if not (finer - carried).abs().max() > 1e-5 * max(box.size):
            break
        steps, carried = 2 * steps, finer
    return steps


def reach(motion: Equation, surfaces: Mapping[float, Shape], ends: tuple[float, float]) -> Box:
    """A box around surfaces given at some times, and around where the motion carries them if it can be told."""
    first, last = ends
    boxes = [box for column in motion.columns for box in column.leads_to]
    for t0, surface in surfaces.items():
        boxes.append(surface.box)
        x = surface.sample(2000, generator=torch.Generator().manual_seed(0)).points
        start = torch.full((len(x),), float(t0), dtype=torch.float64)
        for t in torch.linspace(first, last, 17).tolist():
            carried = motion.carry(x, start, torch.full_like(start, t))
            if carried is not None:
                boxes.append(Box.around(carried))
    return box_around(boxes)


def reach_of_family(
    family: Equation, surfaces: Sequence[Shape], starts: Sequence[Sequence[float]], ends: Sequence[tuple[float, float]]
) -> Box:
    """A box around surfaces given at points of the parameters, and around where the motions carry them in turn.

    As far as that can be told: for the motions of a `Family`.
    """
    boxes = [surface.box for surface in surfaces]
    boxes += [box for column in family.columns for box in column.leads_to]
    motions = [column for column in family.columns if isinstance(column, Along)]
    for surface, start in zip(surfaces, starts, strict=True):
        x = surface.sample(2000, generator=torch.Generator().manual_seed(0)).points
        for motion in motions:
            since, (first, last) = start[motion.parameter], ends[motion.parameter]
            pieces = [x]
            for t in torch.linspace(first, last, 9).tolist():
                carried = motion.carry(
                    x, x.new_full((len(x),), first if math.isnan(since) else since), x.new_full((len(x),), t)
                )
                pieces += [] if carried is None else [carried]
            x = torch.cat(pieces)
            boxes.append(Box.around(x))
            x = x[torch.randperm(len(x), generator=torch.Generator().manual_seed(0))[:4000]]
    return box_around(boxes)
