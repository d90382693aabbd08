"""Solids made of other solids: moved, turned, and melted together."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.shapes.shape import Samples, Solid


@dataclass(frozen=True)
class Translated(Solid):
    """A solid moved by a vector.

    Attributes:
        solid: The solid to move.
        by: The vector.
    Raises:
        ValueError: If the vector has another dimension than the solid, or is not finite.
    """

    solid: Solid
    by: tuple[float, ...]

    def __post_init__(self) -> None:
        by, d = tuple(float(v) for v in self.by), self.solid.box.space
        if len(by) != d or not all(map(math.isfinite, by)):
            raise ValueError(f"`Translated(by={by})`: the solid is in R^{d}, so `by` must be {d} finite numbers.")
        object.__setattr__(self, "by", by)

    @property
    def box(self) -> Box:
        box = self.solid.box
        return Box(
            tuple(c + v for c, v in zip(box.lower, self.by, strict=True)),
            tuple(c + v for c, v in zip(box.upper, self.by, strict=True)),
        )

    def distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return self.solid.distance(x - x.new_tensor(self.by))

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        points, normals = self.solid.sample(n, generator=generator)
        return Samples(points + points.new_tensor(self.by), normals)


@dataclass(frozen=True)
class Rotated(Solid):
    """A solid turned about the origin; in space about an axis, by the right-hand rule.

    Its `box` is the one around the turned box of the solid, which may be larger than needed.

    Attributes:
        solid: The solid to turn.
        angle: The angle in radians.
        axis: The axis of rotation, of any length. Not used in the plane.
    Raises:
        ValueError: If the angle is not finite, or the axis is not three finite numbers with a direction.
    """

    solid: Solid
    angle: float
    axis: tuple[float, ...] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        x, y, z = (*map(float, self.axis), *[math.nan] * 3)[:3]
        length = math.hypot(x, y, z)
        if len(self.axis) != 3 or not length > 0 or not math.isfinite(length):
            raise ValueError(f"`Rotated(axis={self.axis})`: the axis must be three finite numbers, not all zero.")
        if not math.isfinite(self.angle):
            raise ValueError(f"`Rotated(angle={self.angle})`: the angle must be a finite number of radians.")
        object.__setattr__(self, "axis", (x, y, z))

    def matrix(self) -> Float[Tensor, "d d"]:
        """The rotation matrix, from Rodrigues's formula $I + \\sin a\\, K + (1 - \\cos a) K^2$."""
        if self.solid.box.space == 2:
            c, s = math.cos(self.angle), math.sin(self.angle)
            return torch.tensor([[c, -s], [s, c]], dtype=torch.float64)
        length = math.hypot(*self.axis)
        x, y, z = (v / length for v in self.axis)
        k = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
        return torch.eye(3, dtype=torch.float64) + math.sin(self.angle) * k + (1 - math.cos(self.angle)) * k @ k

    @property
    def box(self) -> Box:
        box = self.solid.box
        corners = torch.tensor(list(product(*zip(box.lower, box.upper, strict=True))), dtype=torch.float64)
        return Box.around(corners @ self.matrix().T)

    def distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return self.solid.distance(x @ self.matrix().to(x))

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        points, normals = self.solid.sample(n, generator=generator)
        turn = self.matrix().to(points).T
        return Samples(points @ turn, normals @ turn)


@dataclass(frozen=True)
class SmoothUnion(Solid):
    """Two solids melted together: the zero set of a smooth minimum of their distances a and b.

    With $h = \\max(k - |a - b|, 0) / k$ the field is $\\min(a, b) - k h^2 / 4$. It equals $\\min(a, b)$, the exact
    distance outside, wherever $|a - b| \\ge k$. **In the blend it is not an exact distance**: its gradient is a mean of
    two unit vectors, hence at most 1 long, so that it never exceeds the distance to the surface; and it is below
    min(a, b) by at most k / 4. Inside, the same holds as for any union: it is a bound where the solids overlap.

    The `box` has room for the largest possible bulge, k / 4, and may be larger than needed.

    Attributes:
        first: A solid.
        second: Another one, in the same dimension.
        blend: The length k over which they melt together.
    Raises:
        ValueError: If the blend is not positive, or if one solid is in the plane and the other in space.
    Reference:
        Quilez, Smooth minimum (the quadratic polynomial), https://iquilezles.org/articles/smin.
    """

    first: Solid
    second: Solid
    blend: float = 0.1

    def __post_init__(self) -> None:
        if not self.blend > 0 or not math.isfinite(self.blend):
            raise ValueError(f"`SmoothUnion(blend={self.blend})`: the blend must be a positive length.")
        if self.first.box.space != self.second.box.space:
            raise ValueError(
                f"`SmoothUnion`: the first solid is in R^{self.first.box.space}, the second in "
                f"R^{self.second.box.space}."
            )

    @property
    def box(self) -> Box:
        return self.first.box.union(self.second.box).expanded(self.blend / 4)

    def distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """The smooth minimum: zero on the surface, negative inside, at most the distance in absolute value."""
        a, b = self.first.distance(x), self.second.distance(x)
        h = (1 - (a - b).abs() / self.blend).clamp(min=0)
        return torch.minimum(a, b) - self.blend * h.square() / 4

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        """Points where random lines cross the surface; by Crofton's formula those are uniform by area.

        Two crossings of a line within 1/1000 of the diameter of the box can be missed.
        """
        found: list[Tensor] = []
        while sum(map(len, found)) < n:
            found.append(self._crossings(max(n, 64), generator))
        points = torch.cat(found)
        points = points[torch.randperm(len(points), generator=generator, device=generator.device)[:n]]
        with torch.enable_grad():
            x = points.clone().requires_grad_()
            (gradient,) = torch.autograd.grad(self.distance(x).sum(), x)
        return Samples(points, gradient / gradient.norm(dim=1, keepdim=True))

    @torch.no_grad()
    def _crossings(self, lines: int, generator: torch.Generator) -> Float[Tensor, "m d"]:
        """The crossings of the surface with uniformly random lines through the ball around the box.

        The field changes by at most the way gone, so that a piece of a line on which it is larger in the middle
        than half the length of the piece holds no crossing; the others are halved.
        """
        d, radius = self.box.space, math.hypot(*self.box.size) / 2
        normal = torch.randn(2, lines, d, generator=generator, dtype=torch.float64, device=generator.device)
        direction = normal[0] / normal[0].norm(dim=1, keepdim=True)
        offset = normal[1] - (normal[1] * direction).sum(1, keepdim=True) * direction
        u = torch.rand(lines, 1, generator=generator, dtype=torch.float64, device=generator.device)
        offset = offset / offset.norm(dim=1, keepdim=True) * radius * u ** (1 / (d - 1))
        start = offset + offset.new_tensor(self.box.center)
        middle, half = start.new_zeros(lines), radius
        for _ in range(10):
            near = self.distance(start + middle[:, None] * direction).abs() <= half
            start, direction, middle, half = start[near], direction[near], middle[near], half / 2
            start, direction = start.repeat(2, 1), direction.repeat(2, 1)
            middle = torch.cat([middle - half, middle + half])
        low, high = middle - half, middle + half
        inside = self.distance(start + low[:, None] * direction) < 0
        crossed = inside != (self.distance(start + high[:, None] * direction) < 0)
        start, direction, inside, low, high = (part[crossed] for part in (start, direction, inside, low, high))
        for _ in range(45):
            middle = (low + high) / 2
            before = (self.distance(start + middle[:, None] * direction) < 0) == inside
            low, high = torch.where(before, middle, low), torch.where(before, high, middle)
        return start + ((low + high) / 2)[:, None] * direction
