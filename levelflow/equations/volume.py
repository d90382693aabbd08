"""Motions that keep the volume."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.equations.equation import LevelSetEquation
from levelflow.jets import Jet


@dataclass(frozen=True)
class VolumePreserving(LevelSetEquation):
    r"""A motion without its mean, $v = v_0 - \bar v_0(t)$, $\bar v_0$ the mean of $v_0$ over the surface at time t.

    The volume inside stays what it is, since $dV/dt = \int v$; in the plane the area inside does. Mean curvature then
    lowers the area of the surface at a given volume: spheres stand still, and everything that does not break apart
    becomes one. A surface of several bodies keeps the sum of their volumes, and the smaller ones feed the larger.

    The mean is that of the whole surface. `solve` measures it on the field as training goes on, at times between the
    ends of the interval, and adds what brings a volume back that has gone astray. Level sets nearby have their own
    means: with that of the surface those inside a sphere would shrink and those outside grow, and the field become flat
    in between. Farther away than the levels at which it is known, the mean fades like a bell curve of the width l, so
    that no other level set becomes a surface.

    Attributes:
        motion: The motion $v_0$; a sum goes inside: VolumePreserving(a + b).
        times: When the means are known, in ascending order; `solve` fills these in.
        levels: The values of f for whose level sets they are known, in ascending order.
        means: What they are, a row for each time.
        reach: The length l.

    Raises:
        TypeError: If the motion is none along the normal.
        ValueError: If the speed is asked for and no mean is known.

    Reference:
        Huisken, The volume preserving mean curvature flow, J. reine angew. Math. 382 (1987).
    """

    motion: LevelSetEquation
    times: tuple[float, ...] = ()
    levels: tuple[float, ...] = (0.0,)
    means: tuple[tuple[float, ...], ...] = ()
    reach: float = math.inf

    averages = True

    def __post_init__(self) -> None:
        if not isinstance(self.motion, LevelSetEquation):
            raise TypeError(f"VolumePreserving({self.motion!r}): this is no motion along the normal and has no mean.")
        for name in ("order", "sharpens", "bounded", "bends"):
            object.__setattr__(self, name, getattr(self.motion, name))

    def __repr__(self) -> str:
        return f"VolumePreserving({self.motion!r})"

    def measured(
        self,
        times: Sequence[float],
        means: Sequence[Sequence[float]],
        *,
        levels: Sequence[float] = (0.0,),
        reach: float = math.inf,
    ) -> VolumePreserving:
        """The same motion with the means of its speed known at some times, for some level sets."""
        return replace(self, times=tuple(times), levels=tuple(levels), means=tuple(map(tuple, means)), reach=reach)

    def speed(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, " n"]:
        if not self.times:
            raise ValueError(f"{self!r}: the mean over the surface is not known; give it with measured(times, means).")
        speed = self.motion.speed(x, t, jet)
        value = jet.value.to(t)
        beyond = value - value.clamp(self.levels[0], self.levels[-1])
        mean = self._mean(t[:, 0], value) * torch.exp(-((beyond / self.reach) ** 2))
        return speed - mean.to(speed)

    def weight(self, t: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
        return self.motion.weight(t)

    def _mean(self, t: Tensor, value: Tensor) -> Tensor:
        """The mean of level sets at times, linear between those where it is known."""
        (before, after, part), (below, above, share) = _between(self.times, t), _between(self.levels, value)
        means = t.new_tensor(self.means)
        low, high = ((1 - part) * means[before, i] + part * means[after, i] for i in (below, above))
        return (1 - share) * low + share * high


def _between(knots: Sequence[float], at: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The knots before and after, and how far on the way; the same two where there is only one."""
    known = at.new_tensor(knots)
    after = torch.searchsorted(known, at.contiguous()).clamp(min(1, len(known) - 1), len(known) - 1)
    before = (after - 1).clamp_min(0)
    length = torch.where(after > before, known[after] - known[before], 1.0)
    return before, after, ((at - known[before]) / length).clamp(0, 1)
