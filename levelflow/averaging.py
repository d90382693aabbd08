"""What equations need to know of the whole surface: means over it, and the volume inside."""

from __future__ import annotations

import functools
import math
import warnings
from collections.abc import Callable

import torch
from torch import Tensor

from levelflow.curvature import gauss_curvature, gradient_norm, normal, total_curvature
from levelflow.equations.volume import VolumePreserving
from levelflow.extraction import EmptyLevelSet, ExtractionWarning, extract
from levelflow.fields import Placed
from levelflow.jets import Jet
from levelflow.minimising import Batch
from levelflow.shapes.mesh import Mesh


class Volume:
    r"""The volume inside, at times between the ends of the interval, and what keeps it.

    Every few steps the surface of each time is measured on the field: its volume V, its area A, the mean speed of the
    motion, and points $x_s$ on it, where the field is $f_s$ and its slope $g_s$. So that a volume that has gone astray
    comes back, the mean speed is raised by the excess $(V - V_0) / A$, times `pull` over the length of the interval.
    So are those of the level sets nearby, which are measured at points moved along the normals by s and weighed by the
    change $1 + s \kappa + s^2 K$ of the area.

    Means that are learnt with noise keep the volume to half a per cent. In the last part of training, as a term of the
    loss, the volume is therefore asked for itself: in between two looks at the surface

    $$e = \frac{V - V_0}{A} - \frac{1}{n} \sum_s \frac{f(x_s, t) - f_s}{g_s}$$

    is to first order the mean distance by which it lies too far out, and its square is the loss. (Earlier, while the
    field still changes much between two looks, the same makes it swing.) A surface that has vanished is asked for
    nothing, and its mean speed is 0.

    Args:
        placed: The field.
        motion: The equation that keeps the volume.
        start: The values of the shape whose volume is kept, at points in its units.
        jet: What the equation sees, in the units of the shape, at normalised points of space-time.
    """

    name, weight, since = "volume", 1000.0, 0.7
    every, knots, resolution, points, pull, share = 20, 9, 48, 500, 4.0, 0.3
    levels = (-0.3, -0.15, 0.0, 0.15, 0.3)

    def __init__(
        self,
        placed: Placed,
        motion: VolumePreserving,
        start: Callable[[Tensor], Tensor],
        *,
        jet: Callable[[Tensor], Jet],
    ) -> None:
        self.placed, self.motion, self.start, self.jet = placed, motion, start, jet
        first, last = placed.box.times[0]
        self.times = torch.linspace(first, last, self.knots, dtype=torch.float64)
        like, shape = next(placed.parameters()), (self.knots, self.points)
        self.memory = {
            "age": torch.zeros(1),
            "reach": self.times.new_zeros(1),
            "means": self.times.new_zeros(self.knots, len(self.levels)),
            "points": like.new_zeros(*shape, placed.space + 1),
            "values": like.new_zeros(shape),
            "slopes": like.new_full(shape, math.inf),
            "excess": like.new_zeros(self.knots),
        }

    @property
    def equation(self) -> VolumePreserving:
        """The equation with what was measured."""
        reach = float(self.memory["reach"]) or math.inf
        levels = [level * reach for level in self.levels] if math.isfinite(reach) else self.levels
        return self.motion.measured(self.times.tolist(), self.memory["means"].tolist(), levels=levels, reach=reach)

    def look(self, generator: torch.Generator) -> None:
        """Measures anew when it is time; to be called once a step."""
        if self.memory["age"] % self.every == 0:
            self.measure(generator)
        self.memory["age"] += 1

    def sample(self, generator: torch.Generator) -> Batch:
        return tuple(self.memory[name] for name in ("points", "values", "slopes", "excess"))

    def loss(self, *batch: Tensor) -> Tensor:
        points, values, slopes, excess = batch
        z = points.flatten(0, 1)
        found = self.placed.field(z[:, : self.placed.space], z[:, self.placed.space :]).view_as(values)
        return (excess - ((found - values) / slopes).mean(1)) ** 2

    @torch.no_grad()
    def measure(self, generator: torch.Generator) -> None:
        """Looks at the field as it is.

        The field follows what is said of its means with a delay, so that to believe a new mean at once makes the two
        chase each other: it counts for a share, all but the first.
        """
        memory, placed = self.memory, self.placed
        reference = self._reference
        if reference is None:
            return
        share = self.share if memory["reach"] else 1.0
        memory["reach"] = memory["reach"] + share * (2 * abs(reference.volume) / reference.area - memory["reach"])
        for i, time in enumerate(self.times.tolist()):
            memory["slopes"][i], memory["excess"][i], means = math.inf, 0.0, self.times.new_zeros(len(self.levels))
            surface = self._surface(placed.at(time))
            if surface is not None:
                excess = (surface.volume - reference.volume) / surface.area
                x = surface.sample(self.points, generator=generator).points
                z, jet = self._seen(x, time)
                scale = placed.box.frame.scale
                memory["points"][i], memory["values"][i] = z, jet.value / scale
                memory["slopes"][i], memory["excess"][i] = gradient_norm(jet), excess / scale
                means = self._means(x, time, jet) + self.pull / float(self.times[-1] - self.times[0]) * excess
            memory["means"][i] += share * (means - memory["means"][i])

    def _seen(self, x: Tensor, time: float) -> tuple[Tensor, Jet]:
        """The normalised points of space-time, and the jet there."""
        t = torch.full((len(x), 1), time, dtype=x.dtype)
        z = torch.cat([self.placed.box.frame.to_unit(x), self.placed.unit_times(t)], dim=1).to(self.memory["points"])
        return z, self.jet(z)

    def _means(self, x: Tensor, time: float, jet: Jet) -> Tensor:
        """The mean speed of the level sets around points of the surface."""
        across, slope = normal(jet).to(x), gradient_norm(jet).to(x)
        kappa = total_curvature(jet).to(x)
        gauss = gauss_curvature(jet).to(x) if x.shape[1] == 3 else torch.zeros_like(kappa)
        t = torch.full((len(x), 1), time, dtype=x.dtype)
        found = []
        for level in self.levels:
            s = level * float(self.memory["reach"]) / slope.clamp_min(0.3)
            weight = (1 + s * kappa + s**2 * gauss).clamp(0.0, 4.0)
            _, there = self._seen(x + s[:, None] * across, time)
            speed = self.motion.motion.speed(x, t, there).to(weight)
            found.append((weight * speed).sum() / weight.sum().clamp_min(1e-9))
        return torch.stack(found)

    @functools.cached_property
    def _reference(self) -> Mesh | None:
        return self._surface(self.start)

    def _surface(self, field: Callable[[Tensor], Tensor]) -> Mesh | None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ExtractionWarning)
            try:
                return extract(field, box=self.placed.box, resolution=self.resolution, refine=2)
            except EmptyLevelSet:
                return None


def with_means(
    equation: VolumePreserving, field: Placed, *, origin: float, generator: torch.Generator
) -> VolumePreserving:
    """The motion with its mean as measured on a field, whose volume is right at the time `origin`."""

    def jet(z: Tensor) -> Jet:
        return field.in_units(field.field.jet(z[:, : field.space], z[:, field.space :], order=equation.order))

    volume = Volume(field, equation, field.at(origin), jet=jet)
    volume.measure(generator)
    return volume.equation
