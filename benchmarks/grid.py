"""A rival: the level-set method on a Cartesian grid, as textbooks have it, behind the call of `levelflow.solve`.

Curvature is taken by central differences with steps as long as is stable, without
reinitialisation: the level sets of its viscosity solution move independently of each other, so that distances need not
be kept. Velocity fields are followed by upwind WENO5 differences, other speeds by Godunov's upwinding of them, in three
Runge-Kutta stages each; every few steps the field becomes a distance again, with a subcell fix. Points farther from the
surface than a band rest.

References:
    Osher and Fedkiw, Level Set Methods and Dynamic Implicit Surfaces, Springer 2003, chapters 3 to 7;
    Jiang and Peng, Weighted ENO schemes for Hamilton-Jacobi equations, SIAM J. Sci. Comput. 21 (2000);
    Russo and Smereka, A remark on computing distance functions, J. Comput. Phys. 163 (2000).
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from scipy.ndimage import distance_transform_edt, spline_filter
from torch import Tensor

from levelflow import Box, Field
from levelflow.boxes import interval
from levelflow.conditions import Key, surface_of
from levelflow.equations import Equation, LevelSetEquation, MeanCurvature, Stationary, Transport
from levelflow.equations.equation import Motions
from levelflow.jets import Jet
from levelflow.shapes import Solid
from levelflow.shapes.implicit import value_of
from levelflow.transported import reach

GHOST = 4
"""Grid points beyond the box on each side; the outer three are extrapolated."""

BAND = 6
"""Half the width, in cells, of the band that moves under speeds of first order."""

WIDE = 12
"""The same, in values divided by the spacing, under curvature."""

OFTEN = 5
"""Steps from one reinitialisation to the next."""

SNAPSHOTS = 64
"""Intervals of time between the grids that are kept."""


class Grid:
    """The points of a Cartesian grid around a box, numbered in the order of memory.

    Attributes:
        spacing: h, the side of a cell.
        counts: Points along each axis.
        strides: By how much the number of a point grows along each axis.
        inner: The numbers of all points but the outer three layers.
    """

    def __init__(self, box: Box, resolution: int) -> None:
        self.spacing = max(box.size) / resolution
        self.counts = [max(1, math.ceil(side / self.spacing - 1e-9)) + 1 + 2 * GHOST for side in box.size]
        self.lower = [c - self.spacing * (n - 1) / 2 for c, n in zip(box.center, self.counts, strict=True)]
        self.strides = [math.prod(self.counts[i + 1 :]) for i in range(box.space)]
        self.inner = torch.arange(math.prod(self.counts)).reshape(self.counts)[(slice(3, -3),) * box.space].reshape(-1)
        self._is_inner = torch.zeros(math.prod(self.counts), dtype=torch.bool)
        self._is_inner[self.inner] = True

    def points(self, number: Tensor) -> Float[Tensor, "n d"]:
        """The positions of grid points."""
        index = torch.stack([number // s % n for s, n in zip(self.strides, self.counts, strict=True)], dim=1)
        return torch.tensor(self.lower, dtype=torch.float64) + self.spacing * index

    def near(self, f: Tensor, width: float, *, grown: int = 0) -> Tensor:
        """The numbers of the inner points with |f| below the width, and of those up to `grown` points from them."""
        mask = self._is_inner & (f.abs() < width)
        number = mask.nonzero()[:, 0]
        for stride, k in itertools.product(self.strides, range(1, grown + 1)):
            mask[number + k * stride] = mask[number - k * stride] = True
        return (mask & self._is_inner).nonzero()[:, 0]

    def extrapolate(self, f: Tensor) -> None:
        """Continues the field linearly to the outer three layers, in place."""
        values = f.reshape(self.counts)
        for axis in range(len(self.counts)):
            side = values.transpose(0, axis)
            for i in (2, 1, 0):
                side[i] = 2 * side[i + 1] - side[i + 2]
                side[-1 - i] = 2 * side[-2 - i] - side[-3 - i]


class Snapshots(Field):
    """Grids at several times: linear between them in time, cubic B-splines in space, clamped beyond the grid.

    Attributes:
        provenance: Where the field comes from: plain values under string keys.
    """

    box: Box

    def __init__(self, grid: Grid, snapshots: Mapping[float, Tensor], box: Box) -> None:
        super().__init__()
        self.grid, self.box, self.space, self.times = grid, box, box.space, 1
        self._moments = torch.tensor(sorted(snapshots), dtype=torch.float64)
        self._values = [snapshots[t] for t in self._moments.tolist()]
        self._splines: dict[int, Tensor] = {}
        self.provenance: dict[str, Any] = {}

    def at(self, *t: float) -> Static:
        self._check_times(t)
        i, part = self._between(torch.tensor(t, dtype=torch.float64))
        return Static(self.grid, torch.lerp(self._spline(int(i)), self._spline(int(i) + 1), float(part)), self.box)

    def push(self, jet: Jet) -> Jet:
        x, t = jet.value[:, : self.space].double(), jet.value[:, self.space].double()
        interval, part = self._between(t)
        slope, bend = x.new_zeros(len(x), self.space + 1), x.new_zeros(len(x), self.space + 1, self.space + 1)
        value = torch.zeros_like(t)
        for i in interval.unique().tolist():
            here = interval == i
            ends = [_jet(self.grid, self._spline(j), x[here], jet.order) for j in (i, i + 1)]
            v, g, h = (
                torch.lerp(a, b, part[here].reshape(-1, *[1] * (a.ndim - 1))) for a, b in zip(*ends, strict=True)
            )
            duration = self._moments[i + 1] - self._moments[i]
            rate, turn = ((ends[1][k] - ends[0][k]) / duration for k in (0, 1))
            value[here], slope[here] = v, torch.cat([g, rate[:, None]], dim=1)
            bend[here] = torch.cat([torch.cat([h, turn[:, :, None]], dim=2), F.pad(turn, (0, 1))[:, None]], dim=1)
        return _chained(jet, value, slope, bend)

    def _between(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """The number of the last snapshot before each time, and the part of the interval to the next that is gone."""
        i = (torch.searchsorted(self._moments, t.contiguous(), right=True) - 1).clamp(0, len(self._moments) - 2)
        first, last = self._moments[i], self._moments[i + 1]
        return i, ((t - first) / (last - first)).clamp(0, 1)

    def _spline(self, i: int) -> Tensor:
        if i not in self._splines:
            values = self._values[i].reshape(self.grid.counts).numpy()
            self._splines[i] = torch.from_numpy(spline_filter(values, output=values.dtype.type).reshape(-1))
        return self._splines[i]


class Static(Field):
    """The cubic spline on a grid with the given coefficients."""

    def __init__(self, grid: Grid, coefficients: Tensor, box: Box) -> None:
        super().__init__()
        self.grid, self.coefficients = grid, coefficients
        self.box, self.space, self.times = box.during(), box.space, 0

    def push(self, jet: Jet) -> Jet:
        return _chained(jet, *_jet(self.grid, self.coefficients, jet.value.double(), jet.order))


def solve(
    equation: Equation,
    network: object = None,
    *,
    at: Mapping[float, Key],
    until: float | Sequence[float] | None = None,
    box: Box | None = None,
    resolution: int = 96,
    dtype: torch.dtype = torch.float32,
    **ignored: object,
) -> Snapshots:
    """Moves the first given shape on a grid; what belongs to networks is ignored.

    Args:
        equation: A motion, or a sum of motions.
        network: Not used; it stands where `levelflow.solve` has it.
        at: The shapes; the motion starts from the first of them, and the others are at most targets of it.
        until: As for `levelflow.solve`. Curvature backwards in time blows up; values are kept within the size of the
            box, and `provenance["blown_up"]` says since when that was needed.
        box: As for `levelflow.solve`.
        resolution: Cells along the longest side of the box.
        dtype: Of the grid.
        ignored: Budgets, seeds and the like.

    Raises:
        TypeError: If the equation is no motion, or the first shape has neither distance nor values.
    """
    motions = equation.motions if isinstance(equation, Motions) else (equation,)
    if not all(isinstance(m, LevelSetEquation) and (m.order < 2 or isinstance(m, MeanCurvature)) for m in motions):
        raise TypeError(
            f"grid.solve: {equation!r} is no sum of motions by curvature, velocities and speeds of order 1."
        )
    ends = interval(at, until, call="solve")
    surfaces = {t: surface_of(key) for t, key in at.items()}
    start = min(at)
    if not isinstance(at[start], Solid | Field):
        raise TypeError(f"grid.solve: {at[start]!r} has no values to put on a grid; give a solid or a field.")
    box = (box or reach(equation, surfaces, ends)).during(ends)
    grid = Grid(box, resolution)
    with torch.no_grad():
        points = grid.points(torch.arange(math.prod(grid.counts)))
        values = torch.cat([value_of(at[start])(x) for x in points.split(1 << 18)]).to(dtype)
        moments = sorted({start, *torch.linspace(*ends, SNAPSHOTS + 1, dtype=torch.float64).tolist()})
        state = State(grid, motions, values)
        snapshots = {start: values}
        for times in ([t for t in moments if t > start], [t for t in reversed(moments) if t < start]):
            snapshots |= dict(zip(times, state.run(values, start, times), strict=True))
    field = Snapshots(grid, snapshots, box)
    field.provenance = {
        "verb": "grid",
        "equation": repr(equation),
        "resolution": resolution,
        "spacing": grid.spacing,
        "steps": state.steps,
        "blown_up": sorted(state.blown_up.values()),
    }
    return field


class State:
    """A field on a grid on its way through time.

    Attributes:
        f: Its values at all points.
        time: Where it stands.
        steps: Steps done.
        blown_up: The first times, one for either direction, at which values had to be kept within the limit.
    """

    def __init__(self, grid: Grid, motions: Sequence[LevelSetEquation], f: Tensor) -> None:
        self.grid, self.f, self.time, self.steps = grid, f, 0.0, 0
        self.curvature = sum(m.rate for m in motions if isinstance(m, MeanCurvature))
        self.motions = [m for m in motions if not isinstance(m, MeanCurvature | Stationary)]
        self.width = (WIDE if self.curvature else BAND) * grid.spacing
        self.limit = 2 * grid.spacing * max(grid.counts)
        self.blown_up: dict[int, float] = {}

    def run(self, f: Tensor, start: float, times: Sequence[float]) -> Iterator[Tensor]:
        """The values at times that go away from the start, in either direction."""
        self.f, self.time, age = f.clone(), start, 0
        for end in times:
            while self.time != end and (self.curvature or self.motions):
                if age % OFTEN == 0:
                    if not self.curvature:
                        reinitialise(self.grid, self.f, self.width)
                    self._active = self.grid.near(self.f, self.width, grown=2)
                    self._x = self.grid.points(self._active).to(f)
                if not len(self._active):
                    break
                self._step(end)
                age += 1
            self.time = end
            is_clamped = self.motions and not self.curvature
            yield widened(self.grid, self.f, self.width) if is_clamped else self.f.clone()

    def _step(self, end: float) -> None:
        """One step towards a time: Euler's for curvature alone, else the three stages of Shu and Osher."""
        f, here, left, sense = self.f, self._active, abs(end - self.time), math.copysign(1, end - self.time)
        rate, longest = self._rate(self.time, sense)
        ahead = [abs(t - self.time) for m in self.motions for t in getattr(m, "targets", ()) if t > self.time]
        soon = [remaining / 2 for remaining in ahead if remaining > 1e-6]  # morphs divide by the time that remains
        dt = min(left, longest, *soon)
        then = end if dt == left else self.time + sense * dt
        before = f[here]
        self._put(before + dt * rate)
        if self.motions:
            rate, _ = self._rate(then, sense)
            self._put(3 / 4 * before + 1 / 4 * (f[here] + dt * rate))
            rate, _ = self._rate((self.time + then) / 2, sense)
            self._put(1 / 3 * before + 2 / 3 * (f[here] + dt * rate))
        self.time = then
        self.steps += 1
        if not f[here].abs().max() < self.limit:
            self.blown_up.setdefault(int(sense), then)
            f.nan_to_num_().clamp_(-self.limit, self.limit)

    def _put(self, values: Tensor) -> None:
        self.f[self._active] = values
        self.grid.extrapolate(self.f)

    def _rate(self, t: float, sense: float) -> tuple[Tensor, float]:
        """The derivative of the field in the direction that time runs, at the active points, and the longest step."""
        f, h, d = self.f, self.grid.spacing, len(self.grid.counts)
        rate, limit = torch.zeros_like(self._x[:, 0]), 0.0
        if self.curvature:
            rate += sense * self.curvature * curving(self.grid, f, self._active)
            limit += 2 * d * self.curvature / (0.9 * h**2)
        now = self._x.new_full((len(self._x), 1), t)
        stencils = [differences(f, self._active, s, h) for s in self.grid.strides] if self.motions else []
        for motion in self.motions:
            if isinstance(motion, Transport):
                v = sense * motion.velocity(self._x, now).to(f)
                rate -= sum(v[:, i] * weno(stencils[i], v[:, i] > 0) for i in range(d))
                fastest = v.abs().sum(1)
            else:
                slope = torch.stack([(p[2] + p[3]) / 2 for p in stencils] + [torch.zeros_like(rate)], dim=1)
                speed = sense * motion.speed(self._x, now, Jet(f[self._active], slope, None, d)).to(f)
                rate -= speed * godunov(stencils, speed)
                fastest = math.sqrt(d) * speed.abs()
            limit += float(fastest.max()) / (0.5 * h)
        return rate, 1 / max(limit, 1e-12)


def differences(f: Tensor, here: Tensor, stride: int, h: float) -> list[Tensor]:
    """The six divided differences around points along an axis, from that between two and three points behind."""
    near = [f[here + k * stride] for k in range(-3, 4)]
    return [(b - a) / h for a, b in itertools.pairwise(near)]


def weno(differences: Sequence[Tensor], behind: Tensor | bool) -> Tensor:
    """The fifth-order derivative from the left where `behind`, else from the right (Jiang and Peng)."""
    choose = (lambda a, b: a if behind else b) if isinstance(behind, bool) else functools.partial(torch.where, behind)
    a, b, c, d, e = (choose(differences[i], differences[5 - i]) for i in range(5))
    s1 = 13 / 12 * (a - 2 * b + c) ** 2 + (a - 4 * b + 3 * c) ** 2 / 4
    s2 = 13 / 12 * (b - 2 * c + d) ** 2 + (b - d) ** 2 / 4
    s3 = 13 / 12 * (c - 2 * d + e) ** 2 + (3 * c - 4 * d + e) ** 2 / 4
    w1, w2, w3 = 0.1 / (s1 + 1e-6) ** 2, 0.6 / (s2 + 1e-6) ** 2, 0.3 / (s3 + 1e-6) ** 2
    first, second, third = 2 * a - 7 * b + 11 * c, -b + 5 * c + 2 * d, 2 * c + 5 * d - e
    return (w1 * first + w2 * second + w3 * third) / (6 * (w1 + w2 + w3))


def godunov(stencils: Sequence[Sequence[Tensor]], speed: Tensor) -> Tensor:
    """|grad f|, each derivative from the side from which the motion with this speed comes."""
    out, total = speed > 0, torch.zeros_like(speed)
    for stencil in stencils:
        left, right = weno(stencil, True), weno(stencil, False)
        total += torch.maximum(
            torch.where(out, left, -left).clamp_min(0) ** 2, torch.where(out, -right, right).clamp_min(0) ** 2
        )
    return total.sqrt()


def curving(grid: Grid, f: Tensor, here: Tensor) -> Tensor:
    """|grad f| kappa by central differences, with |kappa| at most that of a sphere of radius h."""
    h, d, strides = grid.spacing, len(grid.counts), grid.strides
    center = f[here]
    sides = [(f[here - s], f[here + s]) for s in strides]
    first = [(b - a) / (2 * h) for a, b in sides]
    square = sum((p * p for p in first), torch.full_like(center, 1e-12))
    steepest = sum(torch.maximum((center - a).abs(), (b - center).abs()) ** 2 for a, b in sides)
    trace, along = torch.zeros_like(center), torch.zeros_like(center)
    for i in range(d):
        second = (sides[i][0] + sides[i][1] - 2 * center) / h**2
        trace += second
        along += first[i] ** 2 * second
        for j in range(i):
            a, b = strides[i], strides[j]
            mixed = (f[here + a + b] + f[here - a - b] - f[here + a - b] - f[here - a + b]) / (4 * h**2)
            along += 2 * first[i] * first[j] * mixed
    bound = (d - 1) / h * steepest.sqrt() / h
    return torch.minimum(torch.maximum(trace - along / square, -bound), bound)


def reinitialise(grid: Grid, f: Tensor, width: float, *, iterations: int = 12) -> None:
    """Makes the field a distance up to the width from its zero set, in place; beyond, it is plus or minus the width.

    Points with a neighbour of the other sign get the distance that the given values and slopes there say, so that the
    surface stays (Russo and Smereka); it spreads to the others by sgn(f) (1 - |grad f|).
    """
    h = grid.spacing
    f.clamp_(-width, width)
    here = grid.near(f, width, grown=3)
    given = f[here]
    sign = torch.where(given < 0, -1.0, 1.0).to(f)
    sides = [(f[here - s], f[here + s]) for s in grid.strides]
    crossed = torch.stack([(a < 0) != (given < 0) for side in sides for a in side]).any(0)
    central = sum(((b - a) / 2) ** 2 for a, b in sides).sqrt()
    slopes = [central, *((given - a).abs() for side in sides for a in side)]
    target = h * given / torch.stack(slopes).amax(0).clamp_min(1e-6 * h)
    for _ in range(iterations):
        norm = godunov([differences(f, here, s, h) for s in grid.strides], sign)
        now = f[here]
        f[here] = now - 0.4 * torch.where(crossed, now - target, h * sign * (norm - 1))
        grid.extrapolate(f)
    f.clamp_(-width, width)


def widened(grid: Grid, f: Tensor, width: float) -> Tensor:
    """A field that stops at plus or minus the width, continued by the distance to where it stops."""
    far = (f.abs() >= width * (1 - 1e-6)).reshape(grid.counts).numpy()
    beyond = torch.from_numpy(distance_transform_edt(far)).reshape(-1).to(f)
    return f + f.sign() * beyond * grid.spacing


def _jet(grid: Grid, coefficients: Tensor, x: Float[Tensor, "n d"], order: int) -> tuple[Tensor, Tensor, Tensor]:
    """Value, gradient and Hessian of a spline; zeros for those that are not asked for."""
    parts = [_jet_of_few(grid, coefficients, part, order) for part in x.split(1 << 14)]
    value, slope, bend = (torch.cat(planes) for planes in zip(*parts, strict=True))
    return value, slope, bend


def _jet_of_few(grid: Grid, coefficients: Tensor, x: Tensor, order: int) -> tuple[Tensor, Tensor, Tensor]:
    d = x.shape[1]
    u = (x - x.new_tensor(grid.lower)) / grid.spacing
    u = torch.minimum(u.clamp_min(1.0), u.new_tensor(grid.counts) - 2.001)
    cell = u.floor()
    weights = _spline_weights(u - cell)
    strides = torch.tensor(grid.strides)
    corners = torch.tensor(list(itertools.product(range(-1, 3), repeat=d))) @ strides
    found = coefficients[(cell.long() @ strides)[:, None] + corners].double()

    def derivative(*axes: int) -> Tensor:
        c = found
        for axis in reversed(range(d)):
            c = (c.reshape(len(x), -1, 4) * weights[axes.count(axis)][:, axis, None]).sum(2)
        return c[:, 0] / grid.spacing ** len(axes)

    slope, bend = torch.zeros_like(x), x.new_zeros(len(x), d, d)
    if order > 0:
        slope = torch.stack([derivative(i) for i in range(d)], dim=1)
    if order > 1:
        for i, j in itertools.combinations_with_replacement(range(d), 2):
            bend[:, i, j] = bend[:, j, i] = derivative(i, j)
    return derivative(), slope, bend


def _spline_weights(u: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The four cubic B-splines at a point of a cell, (..., 4), and their first and second derivatives."""
    v = 1 - u
    values = (v**3, 3 * u**3 - 6 * u**2 + 4, 3 * v**3 - 6 * v**2 + 4, u**3)
    first = (-3 * v**2, 9 * u**2 - 12 * u, -9 * v**2 + 12 * v, 3 * u**2)
    second = (6 * v, 18 * u - 12, 18 * v - 12, 6 * u)
    return tuple(torch.stack(w, dim=-1) / 6 for w in (values, first, second))


def _chained(jet: Jet, value: Tensor, slope: Tensor, bend: Tensor) -> Jet:
    """The jet of a function after a map, by the chain rule."""
    slope, bend = slope.to(jet.value), bend.to(jet.value)
    first, second = None, None
    if jet.first is not None:
        first = torch.einsum("nim,nm->ni", jet.first, slope)
    if jet.second is not None:
        second = torch.einsum("nijm,nm->nij", jet.second, slope)
        second = second + torch.einsum("nim,nmk,njk->nij", jet.gradient, bend, jet.gradient)
    return Jet(value.to(jet.value), first, second, jet.space)
