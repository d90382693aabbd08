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
    ends of the interval, and adds what brings a volume back that has gone astray. It acts on the level sets near the
    surface, by $\bar v_0 \exp(-f^2 / l^2)$, so that no other level set becomes a surface.

    Attributes:
        motion: The motion $v_0$; a sum goes inside: VolumePreserving(a + b).
        times: Where the mean is known, in ascending order; `solve` fills this in.
        means: What it is there.
        reach: The length l.

    Raises:
        TypeError: If the motion is none along the normal.
        ValueError: If the speed is asked for and no mean is known.

    Reference:
        Huisken, The volume preserving mean curvature flow, J. reine angew. Math. 382 (1987).
    """

    motion: LevelSetEquation
    times: tuple[float, ...] = ()
    means: tuple[float, ...] = ()
    reach: float = math.inf

    averages = True

    def __post_init__(self) -> None:
        if not isinstance(self.motion, LevelSetEquation):
            raise TypeError(f"VolumePreserving({self.motion!r}): this is no motion along the normal and has no mean.")
        for name in ("order", "sharpens", "bounded", "bends"):
            object.__setattr__(self, name, getattr(self.motion, name))

    def __repr__(self) -> str:
        return f"VolumePreserving({self.motion!r})"

    def measured(self, times: Sequence[float], means: Sequence[float], *, reach: float = math.inf) -> VolumePreserving:
        """The same motion with the mean of its speed known at some times."""
        return replace(self, times=tuple(times), means=tuple(means), reach=reach)

    def speed(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, " n"]:
        if not self.times:
            raise ValueError(f"{self!r}: the mean over the surface is not known; give it with measured(times, means).")
        speed = self.motion.speed(x, t, jet)
        mean = self._mean(t[:, 0]).to(speed)
        return speed - mean * torch.exp(-((jet.value / self.reach) ** 2))

    def weight(self, t: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
        return self.motion.weight(t)

    def _mean(self, t: Tensor) -> Tensor:
        """The mean at the times t, linear between those where it is known."""
        knots, means = t.new_tensor(self.times), t.new_tensor(self.means)
        if len(knots) == 1:
            return means.expand_as(t)
        after = torch.searchsorted(knots, t.contiguous()).clamp(1, len(knots) - 1)
        part = ((t - knots[after - 1]) / (knots[after] - knots[after - 1])).clamp(0, 1)
        return (1 - part) * means[after - 1] + part * means[after]
