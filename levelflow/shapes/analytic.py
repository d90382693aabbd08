"""Solids with a formula for their exact signed distance, around the origin; in space and in the plane.

All follow the dtype and device of their argument and can be differentiated. Move them with `Translated` and `Rotated`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.shapes.shape import Samples, Solid


@dataclass(frozen=True)
class Sphere(Solid):
    """The ball $|x - c| \\le r$.

    Attributes:
        radius: The radius r.
        center: The centre c.
    Raises:
        ValueError: If the radius is not positive, or the centre not a finite point of space.
    """

    radius: float = 1.0
    center: tuple[float, ...] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        _require_positive(self, "radius")
        object.__setattr__(self, "center", _point(self, "center", self.center, 3))

    @property
    def box(self) -> Box:
        return Box(self.center, self.center).expanded(self.radius)

    def distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return (_checked(self, x, 3) - x.new_tensor(self.center)).norm(dim=1) - self.radius

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        normals = _directions(n, 3, generator)
        return Samples(normals.new_tensor(self.center) + self.radius * normals, normals)


@dataclass(frozen=True)
class Cuboid(Solid):
    """The box $|x_i| \\le s_i / 2$, with its edges and corners rounded on request.

    The rounding lies inside the given sides: the rounded box is every point within `radius` of a smaller box.

    Attributes:
        sides: The three side lengths s.
        radius: The radius of the rounding, 0 for sharp edges.
    Raises:
        ValueError: If a side is not positive, or the radius not between 0 and half the shortest side.
    """

    sides: tuple[float, ...] = (1.0, 1.0, 1.0)
    radius: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "sides", _sides(self, self.sides, self.radius, 3))

    @property
    def box(self) -> Box:
        return Box(tuple(-s / 2 for s in self.sides), tuple(s / 2 for s in self.sides))

    def distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return _rounded_distance(_checked(self, x, 3), self.sides, self.radius)

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        return _rounded_sample(n, self.sides, self.radius, generator)


@dataclass(frozen=True)
class Torus(Solid):
    """The ring $(\\sqrt{x^2 + y^2} - R)^2 + z^2 \\le r^2$ around the z axis.

    Attributes:
        major: The radius R of the circle in the middle of the tube.
        minor: The radius r of the tube, below R.
    Raises:
        ValueError: Unless 0 < minor < major.
    """

    major: float = 1.0
    minor: float = 0.4

    def __post_init__(self) -> None:
        _require_positive(self, "major", "minor")
        if self.minor >= self.major:
            raise ValueError(
                f"`{self}`: the tube closes the hole; `minor` must be below `major`, the radius to its middle."
            )

    @property
    def box(self) -> Box:
        out = self.major + self.minor
        return Box((-out, -out, -self.minor), (out, out, self.minor))

    def distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        across = _checked(self, x, 3)[:, :2].norm(dim=1) - self.major
        return torch.stack([across, x[:, 2]], 1).norm(dim=1) - self.minor

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        u = _uniform(n, 3, generator)
        around, tube = 2 * math.pi * u[:, 0], 2 * math.pi * u[:, 1]
        # The density is proportional to 1 + e cos(tube); of the pair tube, pi - tube one is kept in that ratio.
        keep = u[:, 2] < (1 + self.minor / self.major * tube.cos()) / 2
        tube = torch.where(keep, tube, math.pi - tube)
        axis = torch.stack([around.cos(), around.sin(), torch.zeros_like(around)], 1)
        normals = tube.cos()[:, None] * axis + tube.sin()[:, None] * axis.new_tensor([0.0, 0.0, 1.0])
        return Samples(self.major * axis + self.minor * normals, normals)


@dataclass(frozen=True)
class Cylinder(Solid):
    """The cylinder $x^2 + y^2 \\le r^2, |z| \\le h / 2$ with flat ends.

    Attributes:
        radius: The radius r.
        height: The height h along the z axis.
    Raises:
        ValueError: If the radius or the height is not positive.
    """

    radius: float = 0.5
    height: float = 1.0

    def __post_init__(self) -> None:
        _require_positive(self, "radius", "height")

    @property
    def box(self) -> Box:
        corner = (self.radius, self.radius, self.height / 2)
        return Box(tuple(-c for c in corner), corner)

    def distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        across, along = _checked(self, x, 3)[:, :2].norm(dim=1) - self.radius, x[:, 2].abs() - self.height / 2
        return _corner_distance(torch.stack([across, along], 1))

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        u = _uniform(n, 3, generator)
        axis = torch.cat([_directions(n, 2, generator), u.new_zeros(n, 1)], 1)
        side = u[:, :1] < self.height / (self.height + self.radius)
        end = (2 * u[:, 1:2] - 1).sign() * u.new_tensor([0.0, 0.0, 1.0])
        wall = self.radius * axis + self.height * (u[:, 1:2] - 0.5) * u.new_tensor([0.0, 0.0, 1.0])
        disc = self.radius * u[:, 2:].sqrt() * axis + self.height / 2 * end
        return Samples(torch.where(side, wall, disc), torch.where(side, axis, end))


@dataclass(frozen=True)
class Capsule(Solid):
    """Every point within r of the segment $x = y = 0, |z| \\le h / 2$: a cylinder with round ends.

    Attributes:
        radius: The radius r.
        height: The length h of the straight part; the whole is h + 2 r long.
    Raises:
        ValueError: If the radius or the height is not positive.
    """

    radius: float = 0.3
    height: float = 1.0

    def __post_init__(self) -> None:
        _require_positive(self, "radius", "height")

    @property
    def box(self) -> Box:
        return Box((0.0, 0.0, -self.height / 2), (0.0, 0.0, self.height / 2)).expanded(self.radius)

    def distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        along = _checked(self, x, 3)[:, 2:]
        beyond = along - along.clamp(-self.height / 2, self.height / 2)
        return torch.cat([x[:, :2], beyond], 1).norm(dim=1) - self.radius

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        u = _uniform(n, 2, generator)
        wall = u[:, :1] < self.height / (self.height + 2 * self.radius)
        around = torch.cat([_directions(n, 2, generator), u.new_zeros(n, 1)], 1)
        normals = torch.where(wall, around, _directions(n, 3, generator))
        shift = torch.where(wall, u[:, 1:] - 0.5, 0.5 * normals[:, 2:].sign())
        return Samples(self.radius * normals + self.height * shift * u.new_tensor([0.0, 0.0, 1.0]), normals)


@dataclass(frozen=True)
class Dumbbell(Solid):
    """Two equal balls on the z axis, joined by a cylindrical neck.

    In the half plane of $(\\sqrt{x^2 + y^2}, |z|)$ the surface is an arc and a segment that meet in the sharp rim of
    the neck; the distance to the nearer one is exact inside and outside.

    Attributes:
        radius: The radius of the balls.
        length: The distance between their centres.
        neck: The radius of the neck.
    Raises:
        ValueError: If a length is not positive, the neck not thinner than the balls, or the balls so close that
            they meet around the neck.
    """

    radius: float = 0.3
    length: float = 1.0
    neck: float = 0.1

    def __post_init__(self) -> None:
        _require_positive(self, "radius", "length", "neck")
        if self.neck >= self.radius:
            raise ValueError(f"`{self}`: the neck must be thinner than the balls.")
        if self._rim <= 0:
            raise ValueError(
                f"`{self}`: the balls meet around the neck; the length must be above "
                f"{self.length - 2 * self._rim:.6g}, or the neck thicker."
            )

    @property
    def _rim(self) -> float:
        """The height |z| at which the neck meets the ball."""
        return self.length / 2 - math.sqrt(self.radius**2 - self.neck**2)

    @property
    def box(self) -> Box:
        return Box((0.0, 0.0, -self.length / 2), (0.0, 0.0, self.length / 2)).expanded(self.radius)

    def distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        across, along = _checked(self, x, 3)[:, :2].norm(dim=1), x[:, 2].abs()
        from_center = torch.stack([across, along - self.length / 2], 1)
        reach = from_center.norm(dim=1)
        to_rim = torch.stack([across - self.neck, along - self._rim], 1).norm(dim=1)
        cut_off = from_center[:, 1] * self.radius < reach * (self._rim - self.length / 2)
        to_ball = torch.where(cut_off, to_rim, _magnitude(reach - self.radius))
        to_neck = torch.where(along < self._rim, _magnitude(across - self.neck), to_rim)
        inside = (reach < self.radius) | ((across < self.neck) & (along < self.length / 2))
        nearest = torch.minimum(to_ball, to_neck)
        return torch.where(inside, -nearest, nearest)

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        u = _uniform(n, 2, generator)
        around, up = _directions(n, 2, generator), u.new_tensor([0.0, 0.0, 1.0])
        axis = torch.cat([around, u.new_zeros(n, 1)], 1)
        top = self.length / 2 + self.radius
        ball, tube = self.radius * (top - self._rim), self.neck * self._rim
        on_ball = u[:, :1] * (ball + tube) < ball
        # Equal slices of a sphere have equal areas, so the height of the samples is uniform on both pieces.
        signed = 2 * u[:, 1:] - 1
        end = torch.ones_like(signed).copysign(signed)
        rise = self._rim + (top - self._rim) * signed.abs() - self.length / 2
        outward = rise / self.radius * end * up + (1 - (rise / self.radius) ** 2).clamp(min=0).sqrt() * axis
        normals = torch.where(on_ball, outward, axis)
        points = torch.where(
            on_ball, self.length / 2 * end * up + self.radius * outward, self.neck * axis + self._rim * signed * up
        )
        return Samples(points, normals)


@dataclass(frozen=True)
class Circle(Solid):
    """The disc $|x - c| \\le r$ of the plane.

    Attributes:
        radius: The radius r.
        center: The centre c.
    Raises:
        ValueError: If the radius is not positive, or the centre not a finite point of the plane.
    """

    radius: float = 1.0
    center: tuple[float, ...] = (0.0, 0.0)

    def __post_init__(self) -> None:
        _require_positive(self, "radius")
        object.__setattr__(self, "center", _point(self, "center", self.center, 2))

    @property
    def box(self) -> Box:
        return Box(self.center, self.center).expanded(self.radius)

    def distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return (_checked(self, x, 2) - x.new_tensor(self.center)).norm(dim=1) - self.radius

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        normals = _directions(n, 2, generator)
        return Samples(normals.new_tensor(self.center) + self.radius * normals, normals)


@dataclass(frozen=True)
class Rectangle(Solid):
    """The rectangle $|x_i| \\le s_i / 2$ of the plane, with its corners rounded on request.

    Attributes:
        sides: The two side lengths s.
        radius: The radius of the rounding, which lies inside the given sides; 0 for sharp corners.
    Raises:
        ValueError: If a side is not positive, or the radius not between 0 and half the shorter side.
    """

    sides: tuple[float, ...] = (1.0, 1.0)
    radius: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "sides", _sides(self, self.sides, self.radius, 2))

    @property
    def box(self) -> Box:
        return Box(tuple(-s / 2 for s in self.sides), tuple(s / 2 for s in self.sides))

    def distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return _rounded_distance(_checked(self, x, 2), self.sides, self.radius)

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        return _rounded_sample(n, self.sides, self.radius, generator)


@dataclass(frozen=True)
class Polygon(Solid):
    """The region of the plane inside a closed polygon that does not cross itself.

    Attributes:
        vertices: The corners in order, in either sense of rotation; the last is joined to the first. They are kept
            counter-clockwise.
    Raises:
        ValueError: If there are fewer than three corners, one is not finite or equals the next, or edges cross.
    """

    vertices: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        corners = np.array(self.vertices, dtype=np.float64)
        if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
            raise ValueError(
                f"`Polygon`: the vertices have the shape {corners.shape}; at least three (x, y) are needed."
            )
        if not np.isfinite(corners).all():
            raise ValueError(f"`Polygon`: vertex {int((~np.isfinite(corners).all(1)).argmax())} is not finite.")
        after = np.roll(corners, -1, axis=0)
        if len(same := np.flatnonzero((corners == after).all(1))):
            raise ValueError(f"`Polygon`: vertex {same[0]} and the next are both {tuple(corners[same[0]].tolist())}.")
        if crossing := _crossing(corners, after):
            raise ValueError(f"`Polygon`: edges {crossing[0]} and {crossing[1]} cross or touch; inside is ambiguous.")
        if (corners[:, 0] * after[:, 1] - corners[:, 1] * after[:, 0]).sum() < 0:
            corners = corners[::-1]
        object.__setattr__(self, "vertices", tuple((x, y) for x, y in corners.tolist()))

    @cached_property
    def box(self) -> Box:
        return Box.around(np.array(self.vertices))

    def distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        rows = max(1, 500_000 // len(self.vertices))
        return torch.cat([self._distance(part) for part in _checked(self, x, 2).split(rows)])

    def _distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        start = x.new_tensor(self.vertices)
        edges = start.roll(-1, 0) - start
        lengths = edges.norm(dim=1)
        normals = torch.stack([edges[:, 1], -edges[:, 0]], 1) / lengths[:, None]
        with torch.no_grad():
            along = ((x[:, None] - start) * edges).sum(2) / lengths**2
            feet = start + along.clamp(0, 1)[:, :, None] * edges
            nearest = (x[:, None] - feet).square().sum(2).argmin(1)
            along = along.gather(1, nearest[:, None])[:, 0]
        here, normal = start[nearest], normals[nearest]
        above_edge = ((x - here) * normal).sum(1)
        corner = (nearest + (along >= 0.5)) % len(start)
        from_corner = x - start[corner]
        outside = (from_corner * (normals[corner] + normals[corner - 1])).sum(1) >= 0
        to_corner = from_corner.norm(dim=1)
        to_corner = torch.where(outside, to_corner, -to_corner)
        return torch.where((along > 0) & (along < 1), above_edge, to_corner)

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        u = _uniform(n, 2, generator)
        start = u.new_tensor(self.vertices)
        edges = start.roll(-1, 0) - start
        total = edges.norm(dim=1).cumsum(0)
        edge = torch.searchsorted(total, u[:, 0] * total[-1], right=True).clamp_(max=len(total) - 1)
        normals = torch.stack([edges[:, 1], -edges[:, 0]], 1) / edges.norm(dim=1, keepdim=True)
        return Samples(start[edge] + u[:, 1:] * edges[edge], normals[edge])


def _crossing(start: np.ndarray, end: np.ndarray) -> tuple[int, int] | None:
    """The first pair of edges that meet elsewhere than in the corner between neighbours."""
    edges, n = end - start, len(start)

    def side(a: np.ndarray, edge: np.ndarray, p: np.ndarray) -> np.ndarray:
        return np.sign(edge[..., 0] * (p - a)[..., 1] - edge[..., 1] * (p - a)[..., 0])

    for i in range(n):
        j = np.arange(i + 1, n)
        apart = (side(start[i], edges[i], start[j]) * side(start[i], edges[i], end[j]) > 0) | (
            side(start[j], edges[j], start[i]) * side(start[j], edges[j], end[i]) > 0
        )
        low, high = np.minimum(start, end), np.maximum(start, end)
        apart |= ((low[j] > high[i]) | (high[j] < low[i])).any(1)
        neighbour = (j == i + 1) | ((i == 0) & (j == n - 1))
        back = (side(start[i], edges[i], start[j]) == 0) & (side(start[i], edges[i], end[j]) == 0)
        back &= (edges[i] * edges[j]).sum(1) < 0
        if len(hit := j[np.where(neighbour, back, ~apart)]):
            return i, int(hit[0])
    return None


def _magnitude(u: Tensor) -> Tensor:
    """|u| with the derivative +1 at 0, so that normals of points on the surface are not lost."""
    return torch.where(u < 0, -u, u)


def _corner_distance(q: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
    """The distance to the orthant q <= 0."""
    return q.clamp(min=0).norm(dim=1) + q.amax(dim=1).clamp(max=0)


def _rounded_distance(x: Float[Tensor, "n d"], sides: Sequence[float], radius: float) -> Float[Tensor, " n"]:
    return _corner_distance(x.abs() - x.new_tensor([s / 2 - radius for s in sides])) - radius


def _rounded_sample(n: int, sides: Sequence[float], radius: float, generator: torch.Generator) -> Samples:
    """Samples of a box grown by a ball: a piece per set of directions that its normals take part in.

    The normals of a piece fill the unit sphere of those k directions, $|S^{k-1}| r^{k-1}$ in area, and the other
    coordinates run along the sides of the inner box.
    """
    d, half = len(sides), torch.tensor([s / 2 - radius for s in sides], dtype=torch.float64, device=generator.device)
    sets = [c for k in range(1, d + 1) for c in combinations(range(d), k)]
    active = torch.tensor([[i in c for i in range(d)] for c in sets], device=generator.device)
    sphere = half.new_tensor([(2.0, 2 * math.pi * radius, 4 * math.pi * radius**2)[len(c) - 1] for c in sets])
    areas = sphere * torch.where(active, 1.0, 2 * half).prod(1)
    piece = torch.searchsorted(areas.cumsum(0), _uniform(n, 1, generator)[:, 0] * areas.sum(), right=True)
    active = active[piece.clamp_(max=len(sets) - 1)]
    normals = torch.randn(n, d, generator=generator, dtype=torch.float64, device=generator.device) * active
    normals = normals / normals.norm(dim=1, keepdim=True)
    along = (2 * _uniform(n, d, generator) - 1) * half
    return Samples(torch.where(active, normals.sign() * half, along) + radius * normals, normals)


def _uniform(n: int, k: int, generator: torch.Generator) -> Float[Tensor, "n k"]:
    return torch.rand(n, k, generator=generator, dtype=torch.float64, device=generator.device)


def _directions(n: int, d: int, generator: torch.Generator) -> Float[Tensor, "n d"]:
    """Unit vectors, uniform on the sphere."""
    normals = torch.randn(n, d, generator=generator, dtype=torch.float64, device=generator.device)
    return normals / normals.norm(dim=1, keepdim=True)


def _checked(solid: Solid, x: Tensor, d: int) -> Tensor:
    if x.ndim != 2 or x.shape[1] != d:
        raise ValueError(f"`{type(solid).__name__}.distance(x)`: x has the shape {tuple(x.shape)}; wanted is (n, {d}).")
    return x


def _require_positive(solid: Solid, *names: str) -> None:
    for name in names:
        if not (value := getattr(solid, name)) > 0 or not math.isfinite(value):
            raise ValueError(f"`{type(solid).__name__}({name}={value})`: the {name} must be positive and finite.")


def _point(solid: Solid, name: str, values: Sequence[float], d: int) -> tuple[float, ...]:
    point = tuple(float(v) for v in values)
    if len(point) != d or not all(map(math.isfinite, point)):
        raise ValueError(f"`{type(solid).__name__}({name}={point})`: the {name} must be {d} finite numbers.")
    return point


def _sides(solid: Solid, values: Sequence[float], radius: float, d: int) -> tuple[float, ...]:
    sides, name = _point(solid, "sides", values, d), type(solid).__name__
    if min(sides) <= 0:
        raise ValueError(f"`{name}(sides={sides})`: the sides must be positive.")
    if not 0 <= radius <= min(sides) / 2:
        raise ValueError(
            f"`{name}(sides={sides}, radius={radius})`: the radius must be between 0 and half the shortest side, "
            f"{min(sides) / 2:g}."
        )
    return sides
