"""Points of the zero set of a field, uniform by area, without a mesh."""

from __future__ import annotations

import itertools
import math

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from levelflow.boxes import Box
from levelflow.curvature import gradient_norm, normal
from levelflow.fields import Field
from levelflow.shapes.shape import Samples

_WIDE = 0.05
"""Half the width of the shell around the surface where the search for it starts, by the longest side of the box."""
_PER_CELL = 2
"""How many points of the surface a cell of the grid around it holds, on average, before it is drawn from."""
_AT_ONCE = 1 << 12
_NEAR = 1e-5
"""From how near to the surface a Newton step ends on it, by the longest side of the box."""


class NoSurface(ValueError):
    """The field has no zero where it was looked for."""


def sample_surface(field: Field, n: int, *, box: Box | None = None, generator: torch.Generator) -> Samples:
    r"""n points of the zero set of a static field, uniform by area, with its normals.

    Three steps find them. Points of the box that are not far from the surface (rejection) are projected onto it by
    Newton steps

    $$x \leftarrow x - \frac{f\, \nabla f}{|\nabla f|^2}.$$

    They are denser where it bends, so they only mark the cells of a grid in which it lies; Langevin steps, a little
    noise and another projection, lead from there to what they have missed. Then points are drawn uniformly from these
    cells and kept in the shell $|f| / |\nabla f| < h$, a quarter of a cell, and projected. A shell about a patch of
    area A has the volume $2 h A\, (1 + h^2 K / 3)$ with K its Gauss curvature: what it is more outside it is less
    inside. So the density is uniform but for $O(h^2)$, for fields that are no distances too.

    In the plane it is the same with lengths. Cells become smaller as n grows, from about a thirtieth of the box in
    space. Points that did not converge or have left the box are dropped.

    Args:
        field: A field with k = 0; a slice of one that moves.
        n: How many points.
        box: Where to look; the box of the field if left out.
        generator: The source of randomness.

    Returns:
        Points in the units of the box and outward unit normals, both (n, d) in float64 on the generator's device.

    Raises:
        ValueError: If the field depends on time, no box is known, or n is not positive.
        NoSurface: If the field has no zero in the box.

    Reference:
        Yang et al., Geometry Processing with Neural Fields, NeurIPS 2021, Sec. 5.1, which stops after the Langevin
        steps. `benchmarks/sampling.py` compares the two.
    """
    if field.times:
        raise ValueError(
            f"sample_surface: the field depends on {field.times} time(s); give a slice, sample_surface(f.at(t), n)."
        )
    box = box or field.box
    if box is None:
        raise ValueError(
            "sample_surface: the field has no box; say where its surface is with sample_surface(f, n, box=Box(...))."
        )
    if n < 1:
        raise ValueError(f"sample_surface(f, {n}): give the number of points, at least 1.")
    most = 1 << (14 if box.space == 3 else 11)
    rough, around = _rough(field, box, min(max(n, most >> 3), most), generator)
    cells = _Cells(field, box, around, rough, generator)
    found: list[Samples] = []
    count = 0
    while count < n:
        found.append(cells.draw(max(n - count, 256), generator))
        count += len(found[-1].points)
    return Samples(torch.cat([s.points for s in found])[:n], torch.cat([s.normals for s in found])[:n])


@torch.no_grad()
def gap(field: Field, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    """|f| / |grad f|, the distance of points to the surface to first order; in pieces, for the sake of memory."""
    jets = (field.jet(part.to(field.device), order=1) for part in x.split(_AT_ONCE))
    return torch.cat([jet.value.abs() / gradient_norm(jet) for jet in jets]).to(x)


@torch.no_grad()
def project(field: Field, x: Float[Tensor, "n d"], box: Box, *, steps: int = 7) -> tuple[Samples, Bool[Tensor, " n"]]:
    """Points moved to the surface by Newton steps, the normals there, and which of them have arrived within the box.

    A point takes one more step when it is there, and then rests; the others are given up after the last step.
    """
    near = _NEAR * max(box.size)
    x, normals = x.clone(), torch.zeros_like(x)
    going = torch.arange(len(x), device=x.device)
    arrived = torch.zeros(len(x), dtype=torch.bool, device=x.device)
    for _ in range(steps):
        left = []
        for part in going.split(_AT_ONCE):
            jet = field.jet(x[part].to(field.device), order=1)
            away = (jet.value / gradient_norm(jet)).to(x)
            normals[part] = normal(jet).to(x)
            x[part] -= away[:, None] * normals[part]
            there = away.abs() < near
            arrived[part[there]] = True
            left.append(part[~there])
        going = torch.cat(left)
        if not len(going):
            break
    return Samples(x, normals), arrived & box.contains(x)


def _rough(field: Field, box: Box, count: int, generator: torch.Generator) -> tuple[Float[Tensor, "n d"], Box]:
    """At least `count` points of the surface, not uniform, and the box that they were looked for in.

    Where the surface fills little of the box, the search closes in on it.
    """
    search, found = box, box.uniform(0, generator=generator)
    for attempt in range(64):
        x = search.uniform(4 * count, generator=generator)
        on, arrived = project(field, x[gap(field, x) < _WIDE * max(search.size)], search)
        found = torch.cat([found, on.points[arrived]])
        if len(found) >= count:
            return found, search
        if attempt % 4 == 3:
            if not len(found):
                if attempt > 8:
                    break
                continue
            # A few points show only a part of the surface, so the box around them is widened.
            around = Box.around(found)
            closer = around.expanded((1.0 if len(found) < 200 else 0.1) * max(*around.size, 1e-3 * max(box.size)))
            if max(closer.size) < 0.5 * max(search.size):
                search, found = closer, found[:0]
    raise NoSurface(
        f"sample_surface: the field has (almost) no zero in the box {box.lower} to {box.upper}; its surface has "
        "vanished or lies outside."
    )


class _Cells:
    """The cells of a grid in which the surface lies, or that it is nearer to than a quarter of a cell.

    Args:
        field: The field.
        box: Where its surface counts.
        around: The box that the grid fills.
        points: Points of the surface.
        generator: The source of randomness.
    """

    def __init__(
        self, field: Field, box: Box, around: Box, points: Float[Tensor, "n d"], generator: torch.Generator
    ) -> None:
        self.field, self.box = field, box
        # One more cell on every side, which all that is near the surface lies within.
        self.side, self.lower = max(around.size), points.new_tensor(around.lower)
        while True:
            finer = self.side / 2
            if len(torch.unique(((points - self.lower) / finer).floor(), dim=0)) > len(points) / _PER_CELL:
                break
            self.side = finer
        self.lower = self.lower - self.side
        counts = [math.floor(side / self.side) + 3 for side in around.size]
        self.strides = torch.tensor([math.prod(counts[i + 1 :]) for i in range(box.space)], device=points.device)
        self.counts = torch.tensor(counts, device=points.device)
        self.half = self.side / 4
        self.marked = torch.zeros(math.prod(counts), dtype=torch.bool, device=points.device)
        known = self._mark(points)
        for _ in range(8):
            noise = torch.randn(points.shape, generator=generator, dtype=points.dtype, device=points.device)
            on, arrived = project(field, points + self.side * noise, box)
            points, before = on.points[arrived], known
            known = self._mark(points)
            if known < 1.05 * before:
                break
        self.index = self.marked.nonzero()[:, 0]

    def draw(self, n: int, generator: torch.Generator) -> Samples:
        """About n points of the surface, or more or fewer."""
        device = self.marked.device
        chosen = self.index[torch.randint(len(self.index), (4 * n,), generator=generator, device=device)]
        corner = chosen[:, None] // self.strides % self.counts
        u = torch.rand(corner.shape, generator=generator, dtype=torch.float64, device=device)
        x = self.lower + self.side * (corner + u)
        on, arrived = project(self.field, x[gap(self.field, x) < self.half], self.box)
        return Samples(on.points[arrived], on.normals[arrived])

    def _mark(self, points: Float[Tensor, "n d"]) -> int:
        """Marks all cells within the half width of the shell of any of the points; how many are marked then."""
        for corner in itertools.product((-self.half, self.half), repeat=self.box.space):
            self.marked[self._number(points + points.new_tensor(corner))] = True
        return int(self.marked.sum())

    def _number(self, x: Float[Tensor, "n d"]) -> Int[Tensor, " n"]:
        cell = ((x - self.lower) / self.side).floor().long()
        return (cell.clamp_min(0).minimum(self.counts - 1) * self.strides).sum(1)
