"""Parts of space by which a user points at parts of a surface."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from levelflow.boxes import Box
from levelflow.shapes.reading import read_ply


class Region(ABC):
    """A part of space; the part of a surface that lies in it is meant."""

    @property
    @abstractmethod
    def pivot(self) -> tuple[float, ...]:
        """The middle of the region, d numbers: what a handle turns about if no other centre is given."""

    @abstractmethod
    def distance(self, points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        """How far points are from the region; 0 in it."""


@dataclass(frozen=True)
class BoxRegion(Region):
    """What lies in a box.

    Attributes:
        box: The box; its times are not used.
    """

    box: Box

    @property
    def pivot(self) -> tuple[float, ...]:
        return self.box.center

    def distance(self, points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        return np.linalg.norm(points - np.clip(points, self.box.lower, self.box.upper), axis=1)


@dataclass(frozen=True)
class SphereRegion(Region):
    """What lies in a ball, in the plane in a disc.

    Attributes:
        center: Its centre, d numbers.
        radius: Its radius.

    Raises:
        ValueError: If a number is not finite, or the radius is not positive.
    """

    center: tuple[float, ...]
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", tuple(float(v) for v in self.center))
        if not all(map(math.isfinite, self.center)):
            raise ValueError(f"`SphereRegion(center={self.center})`: the centre must be finite numbers.")
        _check_radius("SphereRegion", self.radius)

    @property
    def pivot(self) -> tuple[float, ...]:
        return self.center

    def distance(self, points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        return np.maximum(np.linalg.norm(points - np.array(self.center), axis=1) - self.radius, 0.0)


@dataclass(frozen=True, eq=False)
class PointsRegion(Region):
    """What lies within a radius of one of some points.

    Attributes:
        points: The points, (k, d).
        radius: How far around each of them the region reaches.

    Raises:
        ValueError: If there are no points, a coordinate is not finite, or the radius is not positive.
    """

    points: Float[np.ndarray, "k d"] = field(repr=False)
    radius: float

    def __post_init__(self) -> None:
        points = np.array(self.points, dtype=np.float64)
        if points.ndim != 2 or not points.size:
            raise ValueError(f"PointsRegion: the points have the shape {points.shape}; give at least one, (k, d).")
        if len(lost := np.flatnonzero(~np.isfinite(points).all(1))):
            raise ValueError(f"PointsRegion: point {lost[0] + 1} is {tuple(points[lost[0]].tolist())}, not finite.")
        _check_radius("PointsRegion", self.radius)
        object.__setattr__(self, "points", points)

    @property
    def pivot(self) -> tuple[float, ...]:
        return tuple(self.points.mean(0).tolist())

    def distance(self, points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        return np.maximum(self._tree.query(points)[0] - self.radius, 0.0)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.points)


class PaintedRegion(Region):
    """What is nearest to a painted vertex of some mesh of the same surface.

    The mesh in hand need not be the painted one: a point has the paint of the nearest vertex, if that is near enough.

    Args:
        vertices: The vertices of the painted mesh, (k, d).
        painted: Which of them are painted, (k,).
        reach: How far paint carries at most; a tenth of the longest side of the mesh if left out.

    Raises:
        ValueError: If the arrays do not fit together, a coordinate is not finite, nothing is painted, or the reach is
            not positive.
    """

    def __init__(self, vertices: ArrayLike, painted: ArrayLike, *, reach: float | None = None) -> None:
        vertices, painted = np.array(vertices, dtype=np.float64), np.array(painted)
        if vertices.ndim != 2 or painted.shape != vertices.shape[:1] or painted.dtype != np.bool_:
            raise ValueError(
                f"PaintedRegion: vertices of the shape {vertices.shape} and paint of the shape {painted.shape} and "
                f"type {painted.dtype}; give vertices (k, d) and one bool for each, such as `values > 0.5`."
            )
        if not np.isfinite(vertices).all():
            raise ValueError(f"PaintedRegion: {int((~np.isfinite(vertices)).any(1).sum())} vertices are not finite.")
        if not painted.any():
            raise ValueError(f"PaintedRegion: none of the {len(vertices)} vertices is painted.")
        self.reach = reach if reach is not None else max(Box.around(vertices).size) / 10
        _check_radius("PaintedRegion", self.reach, "reach")
        self.vertices, self.painted = vertices, painted
        self._all, self._painted = cKDTree(vertices), cKDTree(vertices[painted])

    @property
    def pivot(self) -> tuple[float, ...]:
        return tuple(self.vertices[self.painted].mean(0).tolist())

    def __repr__(self) -> str:
        return f"PaintedRegion({int(self.painted.sum())} of {len(self.vertices)} vertices, reach={self.reach:g})"

    @classmethod
    def read(cls, path: str | Path, property: str, *, above: float = 0.5, reach: float | None = None) -> PaintedRegion:
        """The paint in a PLY file: vertices with a property greater than a threshold.

        Colours are stored as `red`, `green` and `blue` from 0 to 255, other paint under a name such as `quality`.

        Args:
            path: The file, with faces, or with edges for a curve in the plane.
            property: The name of the property.
            above: The threshold.
            reach: See `PaintedRegion`.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If it is no valid PLY file, or its vertices have no such property.
        """
        elements = read_ply(path, call="PaintedRegion.read")
        vertex = elements.get("vertex", {})
        axes = "xy" if "edge" in elements and "face" not in elements else "xyz"
        if missing := [name for name in (*axes, property) if name not in vertex]:
            raise ValueError(
                f"PaintedRegion.read: the vertices of {Path(path).name!r} have no property {missing[0]!r}; they have "
                f"{', '.join(vertex) or 'none'}."
            )
        vertices = np.stack([vertex[axis] for axis in axes], 1).astype(np.float64)
        return cls(vertices, vertex[property] > above, reach=reach)

    def distance(self, points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        away, nearest = self._all.query(points)
        held: Bool[np.ndarray, " n"] = self.painted[nearest] & (away <= self.reach)
        return np.where(held, 0.0, self._painted.query(points)[0])


def _check_radius(call: str, radius: float, name: str = "radius") -> None:
    if not 0 < radius < math.inf:
        raise ValueError(f"`{call}({name}={radius})`: the {name} must be a positive length.")
