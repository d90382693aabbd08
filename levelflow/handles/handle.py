"""Handles: regions of a surface that are held, moved, turned or scaled, and the vertices they hold."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from levelflow.handles.regions import Region


class HandleWarning(UserWarning):
    """An edit was accepted although its handles ask for something odd."""


@dataclass(frozen=True)
class Handle:
    r"""A region of a surface, and where it is to go.

    At a part p of the edit, from 0 to 1, a point x of the region is at

        $x_p = c + p\,b + s^p\,R(p\,\alpha)\,(x - c)$,

    with R the rotation about the axis through the centre: a region that turns stays rigid on its way. Without b, angle
    and scale it is frozen.

    Args:
        region: Which part of the surface.
        by: The translation b, d numbers.
        angle: The angle $\alpha$ in degrees, counter-clockwise seen against the axis.
        axis: The direction of the axis, of any length. Only in space, and there only with an angle.
        scale: The factor s.
        center: The point c that turning and scaling leave in place; the centre of the region if left out.
        name: What messages call the handle.

    Raises:
        ValueError: If a number is not finite, the vectors have not as many coordinates as the region, the scale is not
            positive, or an angle and an axis do not come together.
    """

    region: Region
    by: tuple[float, ...] = ()
    angle: float = 0.0
    axis: tuple[float, ...] = ()
    scale: float = 1.0
    center: tuple[float, ...] = ()
    name: str = ""

    def __post_init__(self) -> None:
        d = len(self.region.pivot)
        for key in ("by", "axis", "center"):
            vector = tuple(float(v) for v in getattr(self, key))
            object.__setattr__(self, key, vector)
            if vector and (len(vector) != d or not all(map(math.isfinite, vector))):
                raise ValueError(f"`Handle({key}={vector})`: the region lies in R^{d}; give {d} finite numbers.")
        if not math.isfinite(self.angle):
            raise ValueError(f"`Handle(angle={self.angle})`: the angle must be a finite number of degrees.")
        if not 0 < self.scale < math.inf:
            raise ValueError(f"`Handle(scale={self.scale})`: the scale must be a positive number; 1 changes nothing.")
        if self.axis and (d == 2 or not any(self.axis)):
            why = "in the plane all turns about a point; leave it out." if d == 2 else "the axis has no direction."
            raise ValueError(f"`Handle(axis={self.axis})`: {why}")
        if d == 3 and bool(self.angle) != bool(self.axis):
            raise ValueError(
                f"`Handle(angle={self.angle:g}, axis={self.axis})`: in space an angle in degrees and an axis, such as "
                "(0, 0, 1), come together."
            )

    @classmethod
    def fix(cls, region: Region, *, name: str = "") -> Handle:
        """A region that stays where it is."""
        return cls(region, name=name)

    @classmethod
    def move(cls, region: Region, *, by: Sequence[float], name: str = "") -> Handle:
        """A region that is moved by a vector."""
        return cls(region, by=tuple(by), name=name)

    @classmethod
    def rotate(
        cls, region: Region, *, angle: float, axis: Sequence[float] = (), center: Sequence[float] = (), name: str = ""
    ) -> Handle:
        """A region that is turned by an angle in degrees, in space about an axis."""
        return cls(region, angle=angle, axis=tuple(axis), center=tuple(center), name=name)

    def target(self, points: Float[np.ndarray, "n d"], part: float) -> Float[np.ndarray, "n d"]:
        """Where points of the region are after a part of the edit, from 0 to 1."""
        center, shift = self._places(part)
        return center + shift + self.scale**part * (points - center) @ self._rotation(part).T

    def origin(self, points: Float[np.ndarray, "n d"], part: float) -> Float[np.ndarray, "n d"]:
        """Where the points were that are at the given ones after a part of the edit, the inverse of `target`."""
        center, shift = self._places(part)
        return center + (points - center - shift) @ self._rotation(part) / self.scale**part

    def _places(self, part: float) -> tuple[np.ndarray, np.ndarray]:
        center = np.array(self.center or self.region.pivot)
        return center, part * np.array(self.by) if self.by else np.zeros_like(center)

    def _rotation(self, part: float) -> Float[np.ndarray, "d d"]:
        angle = math.radians(part * self.angle)
        if len(self.region.pivot) == 2:
            c, s = math.cos(angle), math.sin(angle)
            return np.array([[c, -s], [s, c]])
        if not angle:
            return np.eye(3)
        from scipy.spatial.transform import Rotation

        axis = np.array(self.axis)
        return Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()


def selected(
    handles: Sequence[Handle], vertices: Float[np.ndarray, "n d"], *, call: str = "selected"
) -> tuple[Int[np.ndarray, " k"], ...]:
    """The numbers of the vertices that each handle holds.

    A vertex in the regions of several handles that agree about it is the first one's.

    Args:
        handles: The handles.
        vertices: The vertices of the surface before the edit.
        call: Who asks, for the errors.

    Raises:
        ValueError: If there are no handles, a region lies in another space than the surface or holds no vertex of it,
            or handles contradict each other about a vertex.

    Warns:
        HandleWarning: If all handles ask for the same motion, so that nothing changes its form.
    """
    if not handles:
        raise ValueError(f"{call}: there are no handles; give at least one that moves, and one that holds the rest.")
    titles = [f"handle {i}" + (f" ({handle.name!r})" if handle.name else "") for i, handle in enumerate(handles, 1)]
    d, size = vertices.shape[1], float(np.ptp(vertices, axis=0).max())
    held = np.empty((len(handles), len(vertices)), dtype=bool)
    for i, handle in enumerate(handles):
        if len(handle.region.pivot) != d:
            raise ValueError(
                f"{call}: {titles[i]} has a region in R^{len(handle.region.pivot)}, and the surface lies in R^{d}."
            )
        distance = handle.region.distance(vertices)
        held[i] = distance <= 1e-9 * size
        if not held[i].any():
            nearest = int(distance.argmin())
            raise ValueError(
                f"{call}: the region of {titles[i]} holds no vertex of the surface; the nearest one, at "
                f"{_place(vertices[nearest])}, is {distance[nearest]:.4g} away. Move or enlarge the region; the "
                f"surface lies between {_place(vertices.min(0))} and {_place(vertices.max(0))}."
            )
    for i in range(len(handles)):
        for j in range(i):
            shared = np.flatnonzero(held[i] & held[j])
            wrong = shared[_contradict(handles[j], handles[i], vertices[shared], size=size)]
            if len(wrong):
                raise ValueError(
                    f"{call}: {titles[j]} and {titles[i]} both hold {len(wrong)} vertices, such as the one at "
                    f"{_place(vertices[wrong[0]])}, and want them in different places. Make one of the regions smaller."
                )
    anywhere = vertices[held.any(0)]
    if not any(_contradict(handles[0], handle, anywhere, size=size).any() for handle in handles[1:]):
        still = not _contradict(handles[0], Handle(handles[0].region), anywhere, size=size).any()
        warnings.warn(
            f"{call}: all handles are frozen, so nothing moves; add one that does."
            if still
            else f"{call}: all handles ask for the same motion, so the whole surface goes along; freeze some of it.",
            HandleWarning,
            stacklevel=2,
        )
    first = held.argmax(0)
    return tuple(np.flatnonzero(held[i] & (first == i)) for i in range(len(handles)))


def _contradict(a: Handle, b: Handle, points: Float[np.ndarray, "n d"], *, size: float) -> Bool[np.ndarray, " n"]:
    """Which points two handles want in different places, by more than rounding in a surface of that size."""
    # A full turn ends where it starts: the way there counts as well.
    gaps = [np.linalg.norm(a.target(points, part) - b.target(points, part), axis=1) for part in (0.3, 1.0)]
    return np.maximum(*gaps) > 1e-9 * size


def _place(point: Float[np.ndarray, " d"]) -> str:
    return "(" + ", ".join(f"{c:.4g}" for c in point) + ")"
