"""A moving field played to another clock: slower, faster, at rest, backwards."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.fields import Field
from levelflow.jets import Jet


class Retimed(Field):
    r"""A moving field to another clock, $(x, t) \mapsto f(x, \sigma(t))$, as an animator sets it by keys.

    `Retimed(f, {0: 0, 1: 0.5, 3: 0.5, 4: 1})` goes half the way in a second, waits for two and goes on. A key whose old
    time is below that of the key before runs backwards. Between two keys, from $(t_0, s_0)$ to $(t_1, s_1)$, with the
    ease e and $u = (t - t_0) / (t_1 - t_0)$,

    $$\sigma(t) = s_0 + (s_1 - s_0)\,\bigl((1 - e)\,u + e\,(3 u^2 - 2 u^3)\bigr),$$

    the Hermite cubic whose slope at both keys is 1 - e of the mean: it never leaves the times between them. Before the
    first key and after the last it stands still. At a key with a kink, derivatives are those of what comes after.

    Args:
        field: A field of space and one time, with a box. One that loops may be shown for several rounds: its times go
            on beyond its interval.
        keys: Its times, in the order of a film, by the new times at which they are shown.
        ease: 0 for an even speed from key to key, with kinks; 1 to come to rest at every key.

    Attributes:
        provenance: Where the field comes from, for reports and files: plain values under string keys. The field inside
            keeps its own.

    Raises:
        ValueError: If the field has no box or not one time, there are fewer than two keys, a time is no finite number
            or not one of the field, or the ease is not in [0, 1].
    """

    box: Box

    def __init__(self, field: Field, keys: Mapping[float, float], *, ease: float = 1.0) -> None:
        super().__init__()
        if field.times != 1:
            raise ValueError(
                f"Retimed: the field has {field.times} times or parameters; give one that moves, and a slice of a "
                "family of several, f.at(None, 0.5)."
            )
        if field.box is None:
            raise ValueError("Retimed: the field has no box, and so no interval of times; give one that is Placed.")
        if len(keys) < 2 or not all(map(math.isfinite, [*keys, *keys.values()])):
            raise ValueError(
                f"Retimed(keys={dict(keys)}): give two keys or more, finite numbers: {{new time: old time, ...}}, such "
                "as {0: 0, 2: 1}."
            )
        if not 0 <= ease <= 1:
            raise ValueError(f"Retimed(ease={ease:g}): give a number from 0, an even speed, to 1, at rest at each key.")
        self.field, self.ease = field, float(ease)
        self._interval = field.box.times[0]
        self.keys = {float(new): float(keys[new]) for new in sorted(keys)}
        self.space, self.times, self.periodic = field.space, 1, field.periodic
        new, old = list(self.keys), list(self.keys.values())
        self.box = field.box.during((new[0], new[-1]))
        self.loops = math.isclose(self._within(old[0]), self._within(old[-1]), rel_tol=1e-9, abs_tol=1e-12)
        for time in old:
            try:
                field.at(self._within(time))
            except ValueError as error:
                raise ValueError(f"Retimed(keys={self.keys}): of the old times, {error}") from None
        self.provenance: dict[str, Any] = {}

    def moment(self, t: float) -> float:
        r"""The time $\sigma(t)$ of the field inside; of one that loops, it counts on beyond the interval."""
        return float(self._sigma(torch.tensor([t], dtype=torch.float64), 0)[0])

    def push(self, jet: Jet) -> Jet:
        d = self.space
        return self.field.push(jet.components(0, d).beside(jet.components(d).pointwise(self._sigma)))

    def forward(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None) -> Float[Tensor, " n"]:
        x, t = self._inputs(x, t)
        return self.field(x, self._sigma(t, 0)[0])

    def jet(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None, *, order: int = 1) -> Jet:
        x, t = self._inputs(x, t)
        moment, rate = self._sigma(t, 1)
        jet = self.field.jet(x, moment, order=order)
        if jet.first is None:
            return jet
        first = torch.cat([jet.gradient, jet.dt * rate.to(jet.dt)], dim=1)
        return Jet(jet.value, first, jet.second, jet.space)

    def at(self, *t: float | None) -> Field:
        self._check_times(t)
        (time,) = t
        return self if time is None else self.field.at(self._within(self.moment(time)))

    def _sigma(self, t: Tensor, order: int) -> tuple[Tensor, ...]:
        r"""$\sigma(t)$ and its first `order` derivatives; taken in float64, in which keys are exact."""
        now, ease = t.double(), self.ease
        new, old = (now.new_tensor(list(times)) for times in (self.keys, self.keys.values()))
        after = torch.searchsorted(new, now.detach().contiguous(), right=True).clamp(1, len(new) - 1)
        length, rise = new[after] - new[after - 1], old[after] - old[after - 1]
        u = ((now - new[after - 1]) / length).clamp(0, 1)
        share = u * (1 - ease + ease * u * (3 - 2 * u))
        moves = (now >= new[0]) & (now <= new[-1])
        rate = torch.where(moves, rise / length * (1 - ease + 6 * ease * u * (1 - u)), 0.0)
        bend = torch.where(moves, rise / length**2 * 6 * ease * (1 - 2 * u), 0.0)
        return tuple(s.to(t) for s in (torch.lerp(old[after - 1], old[after], share), rate, bend)[: order + 1])

    def _within(self, time: float) -> float:
        """A time of the field inside, brought into its interval if it loops."""
        first, last = self._interval
        return first + (time - first) % (last - first) if self.field.loops else time
