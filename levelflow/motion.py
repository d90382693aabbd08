"""What an equation asks of a field in space-time, as terms of a loss: on moving samples, and along characteristics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from levelflow.averaging import Volume
from levelflow.boxes import Box
from levelflow.conditions import BAND, Given, band_error, pick
from levelflow.curvature import gradient_norm, total_curvature
from levelflow.equations.equation import Equation
from levelflow.equations.volume import VolumePreserving
from levelflow.fields import Placed
from levelflow.jets import Jet
from levelflow.minimising import Batch

Start = Callable[[Tensor], Tensor]
"""The values of a given shape, at points in its units."""


class Motion:
    """The equation, near the moving surface and, for a fifth of the samples, anywhere in the box.

    Points near the surface are walkers in space-time. Every few steps each makes one Newton step towards the zero set
    of the field as it then is, and a tenth of them start afresh; a sample is a walker plus noise. The error of the
    equation is brought to normalised units, so that it reads as a displacement over half the time interval. Beyond a
    tenth its square grows only like a logarithm: on the medial axis curvature is singular, and no network is to
    follow it there. Where f is nearly flat, |grad f| < 0.05, a speed says nothing and is left out. In an equation of
    second order errors count relative to the curvature once its radius is below a tenth: a neck of radius r closes
    after a time of the order of r^2, in which an error of its speed moves it by that share of r. Where the speed is
    bounded they count as they are.

    Attributes:
        volume: Of an equation that keeps the volume, what says the mean speed; a term of its own, too.
    """

    name = "motion"
    weight, noise = 1.0, 0.01
    every, turnover, knee, near, bend = 10, 0.1, 0.1, 0.8, 0.1
    ramp, spent, gain = 0.0, 0.0, 1.0

    def __init__(
        self, placed: Placed, equation: Equation, *, n: int, since: float = 0.0, start: Start | None = None
    ) -> None:
        self.placed, self.equation, self.n, self.since = placed, equation, n, since
        like = next(placed.parameters())
        self.memory = {"walkers": like.new_zeros(8 * n, placed.space + placed.times), "age": torch.zeros(1)}
        self.volume = None
        if isinstance(equation, VolumePreserving):
            self.volume = Volume(placed, equation, start or placed.at(placed.box.times[0][0]), jet=self.jet)
            self.ramp = 0.4

    def sample(self, generator: torch.Generator) -> Batch:
        if self.memory["age"] % self.every == 0:
            self._walk(generator)
        if self.volume is not None:
            self.volume.look(generator)
            self.equation = self.volume.equation
        self.memory["age"] += 1
        near, d = max(1, round(self.near * self.n)), self.placed.space
        (z,) = pick(near, self.memory["walkers"], generator=generator)
        noise = self.noise / self.gain * torch.randn(near, d, generator=generator, dtype=z.dtype)
        z = torch.cat([z[:, :d] + noise.to(z.device), z[:, d:]], dim=1)
        return (torch.cat([z, self._anywhere(self.n - near, generator)]),)

    def loss(self, *batch: Tensor) -> Tensor:
        (z,) = batch
        return self.charge(z, self.jet(z))

    def jet(self, z: Tensor) -> Jet:
        """The jet that the equation sees, in the units of the file, at normalised points of space-time."""
        d = self.placed.space
        return self.placed.in_units(self.placed.field.jet(z[:, :d], z[:, d:], order=self.equation.order))

    @property
    def pace(self) -> float:
        """By how much slower the motion runs than it is to in the end."""
        return min(1.0, max(0.02, (self.spent - self.since) / self.ramp)) if self.ramp else 1.0

    def charge(self, z: Tensor, jet: Jet) -> Tensor:
        """The loss for the error of the equation, (n,)."""
        pace = self.pace
        if pace < 1 and jet.first is not None:
            jet = replace(jet, first=torch.cat([jet.gradient, jet.dt / pace], dim=1))
        error, speeds = pace * self._errors(z, jet), self._is_speed(z)
        error = torch.where(speeds, self.gain * error, error)
        loss = self.knee**2 * torch.log1p((error / self.knee) ** 2)
        steep = (gradient_norm(jet) > 0.05)[:, None]
        return torch.where(steep | ~speeds, loss, 0.0).sum(1)

    def _errors(self, z: Tensor, jet: Jet) -> Tensor:
        """The errors in normalised units, those of curvature relative to it where it is strong, (n, r)."""
        placed, d = self.placed, self.placed.space
        u, tau = z[:, :d], z[:, d:]
        # In float64, for the sake of shapes far from the origin of their units.
        x, t = placed.box.frame.from_unit(u.double()), placed.times_in_units(tau.double())
        error = self.equation.error(x, t, jet).reshape(len(z), -1).to(u.dtype)
        error = error * error.new_tensor([part.unit(placed.box) for part in self.equation.columns])
        if self.equation.order > 1:
            bend = 1 + self.bend * placed.box.frame.scale * total_curvature(jet).detach().abs()
            sharp = [part.is_speed and part.order > 1 and not part.bounded for part in self.equation.columns]
            curved = torch.tensor(sharp, device=error.device)
            error = torch.where(curved, error / bend[:, None], error)
        return error

    def _is_speed(self, like: Tensor) -> Tensor:
        """Which columns are speeds, (r,)."""
        return torch.tensor([part.is_speed for part in self.equation.columns], device=like.device)

    @torch.no_grad()
    def _walk(self, generator: torch.Generator) -> None:
        walkers, d, steps = self.memory["walkers"], self.placed.space, 1
        if self.memory["age"] == 0:
            walkers, steps = self._anywhere(len(walkers), generator), 4
        for _ in range(steps):
            walkers = torch.cat([self._newton(z) for z in walkers.split(4096)])
        away = (walkers[:, :d].abs() > _sides(self.placed, walkers)).any(1).cpu()
        away |= torch.rand(len(walkers), generator=generator) < self.turnover
        afresh = self._anywhere(len(walkers), generator)
        self.memory["walkers"] = torch.where(away[:, None].to(walkers.device), afresh, walkers)

    def _newton(self, z: Tensor) -> Tensor:
        """One step of at most 0.3 towards the zero set, at fixed time; out on one side of a cell, in on the other."""
        d = self.placed.space
        jet = self.placed.field.jet(z[:, :d], z[:, d:], order=1)
        step = (jet.value / (gradient_norm(jet) ** 2).clamp_min(1e-4))[:, None] * jet.gradient
        step = step * (0.3 / torch.linalg.vector_norm(step, dim=1, keepdim=True).clamp_min(0.3))
        x = z[:, :d] - step
        if self.placed.periodic:
            x = Box((-1,) * d, (1,) * d).wrapped(x, self.placed.periodic)
        return torch.cat([x, z[:, d:]], dim=1)

    def _anywhere(self, n: int, generator: torch.Generator) -> Tensor:
        like = self.memory["walkers"]
        z = 2 * torch.rand(n, like.shape[1], generator=generator, dtype=like.dtype) - 1
        z[:, : self.placed.space] *= _sides(self.placed, z)
        drawn = self.equation.draw(n, generator=generator)
        if drawn is not None:
            z[:, self.placed.space :] = self.placed.unit_times(drawn)
        return z.to(like.device)


class Smoothing(Motion):
    """The same for motions by curvature that run forwards, which forgive what is not quite right around the surface.

    The noise is wider, because second derivatives of f are known from some way around the surface, and the weight is
    larger. So that what moves too fast to be followed does not move the given surface as well, errors grow like a
    logarithm beyond a hundredth already; but at first beyond a tenth, or else a leap would cost as little, and faces of
    a cube were seen to leave the box at once and for good.
    """

    weight, noise = 10.0, 0.03
    gentle, settled = 0.01, 0.35

    @property
    def knee(self) -> float:  # type: ignore[override]
        """Where the loss begins to grow like a logarithm: it comes down in the first part of the training."""
        return Motion.knee * (self.gentle / Motion.knee) ** min(1.0, self.spent / self.settled)


class Clinging(Smoothing):
    """The same for a shape that is free to move everywhere: samples stay with it.

    All walkers start from the given surface, and there are no samples elsewhere: away from it the level sets of a
    distance bend without bound, and what a network cannot follow there held up details of the surface as well. Where
    the surface moves by less than `slow`, in the mean, errors count and samples lie in proportion to that, at most
    `most` times; little by little, because the given surface has to be known first.

    Args:
        given: The shape that moves.
    """

    noise, near = 0.02, 1.0
    slow, most, risen = 0.004, 5.0, 0.7

    def __init__(self, placed: Placed, equation: Equation, given: Given, *, n: int, since: float = 0.0) -> None:
        super().__init__(placed, equation, n=n, since=since)
        self.given = given
        self.memory["gain"] = torch.zeros(1)

    def sample(self, generator: torch.Generator) -> Batch:
        batch = super().sample(generator)
        if not self.memory["gain"]:
            self.memory["gain"] = self._measured(*batch).cpu().reshape(1)
        return batch

    @property
    def gain(self) -> float:  # type: ignore[override]
        """By how much errors are enlarged, and the noise of samples reduced, because little moves."""
        return (float(self.memory["gain"]) or 1.0) ** self.rise

    @property
    def rise(self) -> float:
        """How far the surface counts as known, from 0 to 1."""
        return min(1.0, self.spent / self.risen)

    @torch.no_grad()
    def _measured(self, z: Tensor) -> Tensor:
        """The gain by the mean size of the errors if nothing moves."""
        jet = self.jet(z)
        still = replace(jet, first=torch.cat([jet.gradient, torch.zeros_like(jet.dt)], dim=1))
        errors = self._errors(z, still)[gradient_norm(jet) > 0.05][:, self._is_speed(z)]
        return (self.slow / (errors.abs().sum() / max(1, errors.numel())).clamp_min(1e-30)).clamp(1.0, self.most)

    def _anywhere(self, n: int, generator: torch.Generator) -> Tensor:
        z = super()._anywhere(n, generator)
        (z[:, : self.placed.space],) = pick(n, self.given.points, generator=generator)
        return z


class Sharpening(Clinging):
    """The same backwards in time, where nothing is forgiven: what grows is not to be given up for being large.

    The weight therefore rises as the gain does, or else the given surface would be learnt too late.
    """

    gentle = Motion.knee

    @property
    def weight(self) -> float:  # type: ignore[override]
        return Smoothing.weight**self.rise


class Diffusion(Motion):
    """The same for equations about all values of f: asked for in the whole box, half of the samples at the surface."""

    noise, near = 0.1, 0.5


class Carried:
    """The values of the given shape, carried along the characteristics of a motion by a velocity field.

    Three quarters of the samples start near the given surface and are carried to a random time. The others are drawn
    anywhere in the box at a random time and carried back, so that what the motion leaves behind is known as well.
    """

    name = "carried"
    weight = 1.0
    legs = 16

    def __init__(
        self, placed: Placed, equation: Equation, given: Given, time: float, *, n: int, generator: torch.Generator
    ) -> None:
        self.placed, self.equation, self.n = placed, equation, n
        ((first, last),) = placed.box.times
        self.nodes = torch.linspace(first, last, self.legs + 1, dtype=torch.float64)
        self.paths = self._paths(placed.box.frame.from_unit(given.near.double().cpu()), time)
        self.values = given.near_values
        self.far = placed.box.uniform(len(given.far), generator=generator)
        self.far_times = placed.box.uniform_times(len(given.far), generator=generator)
        origins = equation.carry(self.far, self.far_times[:, 0], torch.full_like(self.far_times[:, 0], time))
        assert origins is not None
        with torch.no_grad():
            self.far_values = given.value(origins).to(self.values) / placed.box.frame.scale

    def sample(self, generator: torch.Generator) -> Batch:
        near = 3 * self.n // 4
        i = torch.randint(len(self.values), (near,), generator=generator)
        t = self.placed.box.uniform_times(near, generator=generator)
        first, last = float(self.nodes[0]), float(self.nodes[-1])
        k = ((t[:, 0] - first) / (last - first) * self.legs).round().long()
        x = self._carry(self.paths[k, i], self.nodes[k], t[:, 0], steps=1)
        far, far_times, far_values = pick(
            self.n - near, self.far, self.far_times, self.far_values.cpu(), generator=generator
        )
        like = self.values
        u = self.placed.box.frame.to_unit(torch.cat([x, far]))
        tau = self.placed.unit_times(torch.cat([t, far_times]))
        return u.to(like), tau.to(like), torch.cat([like[i.to(like.device)], far_values.to(like)])

    def loss(self, *batch: Tensor) -> Tensor:
        u, tau, values = batch
        return band_error(self.placed.field(u, tau), values) ** 2

    def _paths(self, x: Tensor, time: float) -> Tensor:
        """Where the points are at each node, (nodes, n, d)."""
        paths = x.new_empty(len(self.nodes), *x.shape)
        later = int((self.nodes < time).sum())
        for leg in (range(later, len(self.nodes)), range(later - 1, -1, -1)):
            y, now = x, time
            for k in leg:
                then = float(self.nodes[k])
                y = self._carry(y, x.new_full((len(x),), now), x.new_full((len(x),), then), steps=2)
                paths[k], now = y, then
        return paths

    def _carry(self, x: Tensor, start: Tensor, end: Tensor, *, steps: int) -> Tensor:
        carried = self.equation.carry(x, start, end, steps=steps)
        assert carried is not None
        return carried


class Blend:
    """Values at every time between those of the given shapes, linear in time: where training starts from.

    A single shape stands still, which is the initialisation of the paper; two give the plain morph of their distances.
    In a loop they go on from the last shape to the first. It needs no derivatives, and so is several times cheaper than
    the equation. `Held` is the same to the end, where the equation holds the shape.

    Reference:
        Novello et al., Neural Implicit Surface Evolution, ICCV 2023, Sec. 4.4.
    """

    name = "blend"
    weight = 1.0

    def __init__(
        self,
        placed: Placed,
        given: Sequence[Given],
        times: Sequence[float],
        *,
        n: int,
        until: float = 1.0,
        band: float = BAND,
    ) -> None:
        self.placed, self.n, self.until, self.band = placed, n, until, band
        scale, frame = placed.box.frame.scale, placed.box.frame
        self.points = torch.cat([part for g in given for part in (g.near, g.far)])
        own = [torch.cat([g.near_values, g.far_values]) for g in given]
        columns = []
        for i, g in enumerate(given):
            parts = []
            for j, other in enumerate(given):
                if i == j:
                    parts.append(own[j])
                else:
                    with torch.no_grad():
                        x = frame.from_unit(torch.cat([other.near, other.far]).double())
                        parts.append(g.value(x).to(own[j]) / scale)
            columns.append(torch.cat(parts))
        order = sorted(range(len(times)), key=lambda i: times[i])
        self.values = torch.stack([columns[i] for i in order], dim=1)
        self.times = torch.tensor([times[i] for i in order], dtype=torch.float64)
        if placed.loops:
            ((start, end),) = placed.box.times
            before, after = self.times[-1:] - (end - start), self.times[:1] + (end - start)
            self.times = torch.cat([before, self.times, after])
            self.values = torch.cat([self.values[:, -1:], self.values, self.values[:, :1]], dim=1)

    def sample(self, generator: torch.Generator) -> Batch:
        x, values = pick(self.n, self.points, self.values, generator=generator)
        t = self.placed.box.uniform_times(self.n, generator=generator)
        now = t[:, 0].clamp(self.times[0], self.times[-1])
        after = torch.searchsorted(self.times, now).clamp(min(1, len(self.times) - 1))
        before = (after - 1).clamp_min(0)
        length = (self.times[after] - self.times[before]).clamp_min(1e-300)
        part = ((now - self.times[before]) / length).clamp(0, 1).to(values)
        rows = torch.arange(self.n, device=values.device)
        value = (1 - part) * values[rows, before.to(x.device)] + part * values[rows, after.to(x.device)]
        return x, self.placed.unit_times(t).to(x), value

    def loss(self, *batch: Tensor) -> Tensor:
        u, tau, values = batch
        return band_error(self.placed.field(u, tau), values, self.band) ** 2


class Outside:
    r"""$f \ge 0.02$ at every time farther than `gap` from the convex hull of the given surface, in normalised units.

    By the principle of comparison a closed surface that contracts stays in its hull; of one that meets the box nothing
    is asked. An equation that is asked for near the moving surface alone lets new pieces come in from beyond: after
    some lifted starts they stood in corners of the box, at the last time. Faces, edges, corners and ends therefore have
    a share of the samples. The weight rises over half of the training, in which a lifted field finds its way.
    """

    name, since, gap, least, pool = "outside", 0.1, 0.04, 0.02, 20_000
    weight, most, spent = 0.0, 30.0, 0.0

    def __init__(self, placed: Placed, given: Given, *, n: int, generator: torch.Generator) -> None:
        self.placed, self.n, on, frame = placed, n, given.points, placed.box.frame
        sides = _sides(placed, on)
        x = sides * self._within((self.pool, placed.space), generator).to(on)
        closed = (on.abs() < sides - self.gap).all()
        normals = torch.nn.functional.normalize(torch.randn((256, placed.space), generator=generator), dim=1).to(on)
        x = x[((x @ normals.T - (on[: self.pool] @ normals.T).amax(0)).amax(1) > self.gap) & closed]
        with torch.no_grad():
            self.points = x[given.value(frame.from_unit(x.double())) > self.gap * frame.scale]

    def sample(self, generator: torch.Generator) -> Batch:
        self.weight = self.most * min(1.0, self.spent / 0.5) ** 2
        (x,) = pick(self.n, self.points, generator=generator)
        return x, self._within((self.n, self.placed.times), generator).to(x)

    def loss(self, *batch: Tensor) -> Tensor:
        return (self.least - self.placed.field(*batch)).relu() ** 2

    @staticmethod
    def _within(shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
        """Numbers in [-1, 1], a tenth of them at either end."""
        return (1.25 * (2 * torch.rand(shape, generator=generator) - 1)).clamp(-1, 1)


class Held(Blend):
    """The values of a given shape, at every time, where the equation lets nothing move: a boundary that stays."""

    name = "held"
    weight = 100.0


def _sides(placed: Placed, like: Tensor) -> Tensor:
    """Half the side lengths of the box in normalised units: at most 1."""
    return like.new_tensor(placed.box.size) / (2 * placed.box.frame.scale)
