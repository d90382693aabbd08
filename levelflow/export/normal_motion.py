"""How the points of a moving surface move: along its normal, read off the jets of its field, or as is known."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float

from levelflow.fields import Field
from levelflow.retimed import Retimed

_POINTS_AT_ONCE = 1 << 15
_MOST_STEPS = 256
_NEWTON_STEPS = 3

Points = Float[np.ndarray, "n d"]
Scalars = Float[np.ndarray, " n"]


class Slopes(NamedTuple):
    """The value of a field and its first derivatives at n points and one time, in float64.

    Attributes:
        value: f.
        gradient: The derivatives in space.
        rate: The derivative in time; zero where the field has no time.
    """

    value: Scalars
    gradient: Points
    rate: Scalars

    @property
    def normals(self) -> Points:
        """grad f / |grad f|; zero where the gradient is zero."""
        return self.gradient / self._norm[:, None]

    @property
    def velocities(self) -> Points:
        r"""The normal part of the velocity, $-\partial_t f\,\nabla f / |\nabla f|^2$, in lengths per time."""
        return self._along_gradient(-self.rate)

    @property
    def distances(self) -> Scalars:
        """|f| / |grad f|, the distance to the zero set to first order."""
        return np.abs(self.value) / self._norm

    @property
    def newton(self) -> Points:
        r"""The step $-f\,\nabla f / |\nabla f|^2$ towards the zero set."""
        return self._along_gradient(-self.value)

    @property
    def _norm(self) -> Scalars:
        return np.linalg.norm(self.gradient, axis=1).clip(min=np.finfo(np.float64).tiny)

    def _along_gradient(self, scalars: Scalars) -> Points:
        """The vectors s grad f / |grad f|^2; zero where the gradient is."""
        square = (self.gradient**2).sum(1)
        return np.divide(scalars, square, out=np.zeros_like(scalars), where=square > 0)[:, None] * self.gradient


class Carried(NamedTuple):
    """Points after a motion.

    Attributes:
        points: Where they are, in the order in which they were given.
        arrived: Which of them are on the surface, and were near it all the way.
    """

    points: Points
    arrived: Bool[np.ndarray, " n"]


def slopes(field: Field, x: Points, t: float) -> Slopes:
    """Value, gradient and time derivative of a field of space and at most one time."""
    parts = []
    with torch.no_grad():
        for start in range(0, len(x), _POINTS_AT_ONCE):
            points = torch.tensor(x[start : start + _POINTS_AT_ONCE], dtype=torch.float64, device=field.device)
            jet = field.jet(points, points.new_full((len(points), field.times), t), order=1)
            rate = jet.dt[:, 0] if field.times else torch.zeros_like(jet.value)
            parts.append([part.double().cpu().numpy() for part in (jet.value, jet.gradient, rate)])
    return Slopes(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def carry(field: Field, x: Points, start: float, end: float, *, step: float) -> Carried:
    r"""Points of the surface at one time, carried to another: $\dot x = -\partial_t f\,\nabla f / |\nabla f|^2$.

    Runge-Kutta steps of order 4, during which hardly a point moves further than `step`, each followed by Newton steps
    back to the zero set. Where the surface pinches, vanishes or tears, its points have nowhere to go: they did not
    arrive. The end may lie before the start. Where the field knows how its points move, as one that is `Transported`
    does, they move like that instead, tangentially as well, and those of a `Retimed` one as those of the field inside
    between its two moments.

    Args:
        field: A field of space and one time.
        x: Points on the surface at the time `start`.
        start: When they are there.
        end: When they are wanted.
        step: A length, about that of a detail of the surface: a point that Newton steps move further is lost.
    """
    if isinstance(field, Retimed):
        return carry(field.field, x, field.moment(start), field.moment(end), step=step)
    x, t = np.array(x, dtype=np.float64), start
    arrived = np.ones(len(x), dtype=bool)
    points = torch.from_numpy(x)
    with torch.no_grad():
        carried = field.carry(points, *(points.new_full((len(x), 1), moment) for moment in (start, end)))
    if carried is not None:
        return Carried(carried.numpy(), arrived)
    least = abs(end - start) / _MOST_STEPS
    while t != end:
        speed = float(np.quantile(np.linalg.norm(slopes(field, x, t).velocities, axis=1), 0.99))
        size = max(least, abs(end - start) / 4 if speed == 0 else min(step / speed, abs(end - start) / 4))
        after = end if size >= abs(end - t) * (1 - 1e-9) else t + np.copysign(size, end - start)
        x, near = _step(field, x, t, after, step)
        arrived &= near
        t = after
    return Carried(x, arrived & (slopes(field, x, t).distances <= 1e-2 * step))


def _step(field: Field, x: Points, t: float, after: float, step: float) -> tuple[Points, Bool[np.ndarray, " n"]]:
    """One Runge-Kutta step and the way back to the surface, and which points needed less than `step` for that."""
    h = after - t
    rates = [slopes(field, x, t).velocities]
    for share in (0.5, 0.5, 1.0):
        rates.append(slopes(field, x + _short(share * h * rates[-1], 4 * step), t + share * h).velocities)
    moved = x + _short(h / 6 * (rates[0] + 2 * rates[1] + 2 * rates[2] + rates[3]), 4 * step)
    back = moved
    for _ in range(_NEWTON_STEPS):
        back = back + _short(slopes(field, back, after).newton, step)
    return back, np.linalg.norm(back - moved, axis=1) <= step


def _short(vectors: Points, longest: float) -> Points:
    """The vectors, no longer than that: where the gradient nearly vanishes, velocities know no bound."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors * (longest / length.clip(min=longest))
