"""A field in time between fields at given times."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from levelflow.fields import Field, Slice
from levelflow.jets import Jet


class Keyframed(Field):
    r"""Static fields at times $t_0 < \dots < t_m$, and between two of them $f = (1 - s)\, f_i + s\, f_{i+1}$.

    s is the part of the time between the two that has passed. At the given times the field is the one given; between
    them the surface of distances that moves by d strays by the order of $d^2$ times its curvature. Before the first and
    after the last time nothing moves.

    Args:
        fields: Static fields on the same space.
        times: Their times, in ascending order.

    Raises:
        ValueError: If there are fewer than two, or fields and times do not fit together.
    """

    def __init__(self, fields: Sequence[Field], times: Sequence[float]) -> None:
        super().__init__()
        if len(fields) != len(times) or len(fields) < 2:
            raise ValueError(f"Keyframed: {len(fields)} fields and {len(times)} times; give two or more, and as many.")
        if not all(map(math.isfinite, times)) or not all(a < b for a, b in itertools.pairwise(times)):
            raise ValueError(f"Keyframed: the times {tuple(times)} must be finite and in ascending order.")
        if kinds := {(field.space, field.times) for field in fields} - {(fields[0].space, 0)}:
            raise ValueError(
                f"Keyframed: fields of (space, times) {sorted(kinds)} beside ({fields[0].space}, 0); give static "
                "fields on one space."
            )
        self.fields = nn.ModuleList(fields)
        self.knots = tuple(float(t) for t in times)
        self.space, self.times = fields[0].space, 1

    def forward(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None) -> Tensor:
        return self.jet(x, t, order=0).value

    def jet(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None, *, order: int = 1) -> Jet:
        x, t = self._inputs(x, t)
        return self._gathered(t[:, 0], lambda i, rows: self._between(x[rows], t[rows, 0], i, order))

    def push(self, jet: Jet) -> Jet:
        d = self.space

        def part(i: int, rows: Tensor) -> Jet:
            first, second = (None if p is None else p[rows] for p in (jet.first, jet.second))
            mine = Jet(jet.value[rows], first, second, jet.space)
            before, after = (self._field(j).push(mine.components(0, d)) for j in (i, i + 1))
            length = self.knots[i + 1] - self.knots[i]
            time = mine.component(d)
            share = Jet(
                ((time.value - self.knots[i]) / length).clamp(0, 1),
                None if time.first is None else time.first / length * self._moving(time.value)[:, None],
                None if time.second is None else time.second / length * self._moving(time.value)[:, None, None],
                jet.space,
            )
            return before + share * _difference(after, before)

        return self._gathered(jet.value[:, d], part)

    def at(self, *t: float | None) -> Field:
        self._check_times(t)
        return self._field(self.knots.index(t[0])) if t[0] in self.knots else Slice(self, t)

    def _between(self, x: Tensor, t: Tensor, i: int, order: int) -> Jet:
        """The jet between the times i and i + 1, from those of the fields themselves."""
        before, after = (self._field(j).jet(x, order=order) for j in (i, i + 1))
        length = self.knots[i + 1] - self.knots[i]
        share = ((t - self.knots[i]) / length).clamp(0, 1).to(before.value)
        blended = [
            None if a is None or b is None else a + share.reshape(-1, *[1] * (a.ndim - 1)) * (b - a)
            for a, b in ((before.value, after.value), (before.first, after.first), (before.second, after.second))
        ]
        value, first, second = blended
        assert value is not None
        if first is not None:
            rate = (after.value - before.value) / length * self._moving(t).to(value)
            first = torch.cat([first, rate[:, None]], dim=1)
        return Jet(value, first, second, self.space)

    def _gathered(self, t: Tensor, part: Callable[[int, Tensor], Jet]) -> Jet:
        """The jets of the points of each interval, put together in the order of the points."""
        knots = t.new_tensor(self.knots)
        interval = (torch.searchsorted(knots, t.contiguous(), right=True) - 1).clamp(0, len(knots) - 2)
        pieces, places = [], []
        for i in interval.unique().tolist() or [0]:
            rows = (interval == i).nonzero()[:, 0]
            pieces.append(part(i, rows))
            places.append(rows)
        back = torch.cat(places).argsort()

        def together(planes: Sequence[Tensor | None]) -> Tensor | None:
            whole = [plane for plane in planes if plane is not None]
            return torch.cat(whole)[back] if whole else None

        value = together([piece.value for piece in pieces])
        assert value is not None
        return Jet(value, together([p.first for p in pieces]), together([p.second for p in pieces]), self.space)

    def _moving(self, t: Tensor) -> Tensor:
        """1 between the first and the last time, 0 beyond them."""
        return ((t >= self.knots[0]) & (t <= self.knots[-1])).to(t)

    def _field(self, i: int) -> Field:
        field = self.fields[i]
        assert isinstance(field, Field)
        return field


def _difference(a: Jet, b: Jet) -> Jet:
    return Jet(
        a.value - b.value,
        None if a.first is None or b.first is None else a.first - b.first,
        None if a.second is None or b.second is None else a.second - b.second,
        a.space,
    )
