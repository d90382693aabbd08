"""Means over the whole surface, for equations that need them."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.equations.volume import VolumePreserving
from levelflow.extraction import EmptyLevelSet, ExtractionWarning, extract
from levelflow.fields import Placed
from levelflow.jets import Jet
from levelflow.shapes.mesh import Mesh


class Averages:
    """The mean speed of the whole surface, measured on the field at times between the ends of the interval.

    The mean is taken over points of a coarse mesh, and so that a volume that has gone astray comes back it is raised by
    the excess, spread over the surface, times `pull` over the length of the interval. Where the surface has vanished
    the mean is 0.

    Args:
        placed: The field.
        equation: The motion whose mean is wanted.
        origin: The time at which the volume is right.
    """

    every, knots, resolution, points, pull, share = 30, 9, 48, 2000, 4.0, 0.3

    def __init__(self, placed: Placed, equation: VolumePreserving, origin: float) -> None:
        self.placed, self.equation, self.origin = placed, equation, origin
        first, last = placed.box.times[0]
        self.times = torch.linspace(first, last, self.knots, dtype=torch.float64)

    @property
    def unknown(self) -> Float[Tensor, " m"]:
        """What stands for measurements before the first."""
        return self.times.new_zeros(1 + self.knots)

    def known(self, found: Float[Tensor, " m"]) -> VolumePreserving:
        """The equation with what was measured."""
        return self.equation.measured(self.times.tolist(), found[1:].tolist(), reach=float(found[0]) or math.inf)

    def measured(
        self, before: Float[Tensor, " m"], jet: Callable[[Tensor], Jet], generator: torch.Generator
    ) -> Float[Tensor, " m"]:
        """What was measured before, brought nearer to the field as it is: all the way at first.

        The field follows what is said of its means with a delay, so that more at once makes the two chase each other.
        """
        now = self._measure(jet, generator)
        return now if not before.any() else before + self.share * (now - before)

    @torch.no_grad()
    def _measure(self, jet: Callable[[Tensor], Jet], generator: torch.Generator) -> Float[Tensor, " m"]:
        """Twice the volume over the area at first, then the mean at each time, on the field as it is.

        Args:
            jet: Gives what the motion sees at normalised points of space-time.
            generator: Source of the points on the surface.
        """
        found = self.unknown
        reference = self._surface(self.origin)
        if reference is None:
            return found
        found[0] = 2 * abs(reference.volume) / reference.area
        first, last = self.placed.box.times[0]
        for i, time in enumerate(self.times.tolist()):
            surface = self._surface(time)
            if surface is None:
                continue
            x = surface.sample(self.points, generator=generator).points
            t = torch.full((len(x), 1), time, dtype=x.dtype)
            z = torch.cat([self.placed.box.frame.to_unit(x), self.placed.unit_times(t)], dim=1)
            speed = self.equation.motion.speed(x, t, jet(z.to(self.placed.device, self.placed.dtype)))
            excess = (surface.volume - reference.volume) / surface.area
            found[1 + i] = speed.double().mean().cpu() + self.pull / (last - first) * excess
        return found

    def _surface(self, time: float) -> Mesh | None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ExtractionWarning)
            try:
                return extract(self.placed.at(time), resolution=self.resolution, refine=2)
            except EmptyLevelSet:
                return None


def with_means(
    equation: VolumePreserving, field: Placed, *, origin: float, generator: torch.Generator
) -> VolumePreserving:
    """The motion with its mean as measured on a field, whose volume is right at the time `origin`."""

    def jet(z: Tensor) -> Jet:
        return field.in_units(field.field.jet(z[:, : field.space], z[:, field.space :], order=equation.order))

    averages = Averages(field, equation, origin)
    return averages.known(averages.measured(averages.unknown, jet, generator))
