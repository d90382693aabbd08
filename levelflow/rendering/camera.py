"""Where a picture is taken from, where points of space land in it, and along which rays it looks."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from levelflow.boxes import Box

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Camera:
    """A pinhole or an orthographic camera. Points of the plane lie at z = 0.

    Attributes:
        eye: Where the camera is.
        target: The point in the middle of the picture.
        up: The direction that points up in the picture.
        field_of_view: The angle that the shorter side of the picture spans, in degrees.
        orthographic: Whether rays are parallel; the picture then shows the extent seen at the distance of the target.

    Raises:
        ValueError: If the eye is at the target, `up` points along the view, or the angle is not within (0, 180).
    """

    eye: Vector
    target: Vector = (0.0, 0.0, 0.0)
    up: Vector = (0.0, 1.0, 0.0)
    field_of_view: float = 25.0
    orthographic: bool = False

    def __post_init__(self) -> None:
        view = np.subtract(self.target, self.eye)
        if not np.linalg.norm(view) > 0:
            raise ValueError(f"Camera: the eye {self.eye} is at the target; move it back.")
        if np.linalg.norm(np.cross(view, self.up)) <= 1e-9 * np.linalg.norm(view) * np.linalg.norm(self.up):
            raise ValueError(f"Camera: up {self.up} points along the view {tuple(view.tolist())}; give another `up`.")
        if not 0 < self.field_of_view < 180:
            raise ValueError(f"Camera(field_of_view={self.field_of_view}): give an angle between 0 and 180 degrees.")

    @classmethod
    def around(
        cls,
        subject: Box | Float[np.ndarray, "n d"],
        azimuth: float = 30.0,
        elevation: float = 15.0,
        *,
        up: Vector = (0.0, 1.0, 0.0),
        field_of_view: float = 25.0,
        orthographic: bool = False,
        margin: float = 1.08,
    ) -> Camera:
        """A camera that sees the whole subject and little more.

        Args:
            subject: The box or the points to frame. What lies in the plane is seen from the front, without perspective.
            azimuth: The angle around `up`, in degrees, from the front: +z, or -y if z is up. 90 looks at the side
                that faces +x.
            elevation: The angle above the horizon, in degrees, within (-90, 90).
            up: The direction that points up in the picture.
            field_of_view: In degrees.
            orthographic: Whether rays are parallel.
            margin: How many times larger than the subject the view is.
        """
        points = (
            np.array(list(itertools.product(*zip(subject.lower, subject.upper, strict=True))))
            if isinstance(subject, Box)
            else np.asarray(subject, dtype=np.float64)
        )
        if points.shape[1] == 2:
            points = np.pad(points, ((0, 0), (0, 1)))
            azimuth, elevation, orthographic, up = 0.0, 0.0, True, (0.0, 1.0, 0.0)
        vertical = np.array(up, dtype=np.float64) / np.linalg.norm(up)
        reference = np.array((0.0, 0.0, 1.0) if abs(vertical[2]) < 0.99 else (0.0, -1.0, 0.0))
        front = reference - (reference @ vertical) * vertical
        front /= np.linalg.norm(front)
        a, e = np.radians([azimuth, elevation])
        back = np.cos(e) * (np.cos(a) * front + np.sin(a) * np.cross(vertical, front)) + np.sin(e) * vertical
        axes = cls(_vector(back), up=up).axes
        # The middle is taken in the frame of the camera, where the subject should be centred.
        extent = points @ axes.T
        center = (extent.min(0) + extent.max(0)) / 2
        x, y, z = (extent - center).T
        sideways = np.maximum(np.abs(x), np.abs(y)) / np.tan(np.radians(field_of_view / 2))
        distance = margin * (sideways.max() if orthographic else (sideways + z).max())
        # The eye must lie before the subject; a subject of a single point has no size to keep away from.
        distance = max(distance, 1.01 * z.max()) or 1.0
        target = center @ axes
        return cls(_vector(target + distance * back), _vector(target), up, field_of_view, orthographic)

    @property
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """The unit vectors right, up and back (from the target to the eye) of the picture, as rows."""
        back = np.subtract(self.eye, self.target)
        back = back / np.linalg.norm(back)
        right = np.cross(self.up, back)
        right = right / np.linalg.norm(right)
        return np.stack([right, np.cross(back, right), back])

    def project(self, points: Float[np.ndarray, "n d"], *, height: int, width: int) -> Float[np.ndarray, "n 3"]:
        """Column, row and nearness of points in a picture; pixel (i, j) has its centre at column j + 1/2, row i + 1/2.

        Nearness is affine on the image of a plane, and greater is nearer: 1/depth in perspective, -depth otherwise.
        Points level with or behind a pinhole get the nearness -infinity.
        """
        if points.shape[1] == 2:
            points = np.pad(points, ((0, 0), (0, 1)))
        x, y, back = self.axes @ (points - np.array(self.eye)).T
        if self.orthographic:
            scale, nearness = np.full_like(x, 1 / self._reach), back
        else:
            nearness = np.where(back < 0, -1 / np.where(back < 0, back, -1.0), -np.inf)
            scale = np.where(back < 0, nearness, 0.0) / self._reach
        pixels = min(height, width) / 2
        return np.stack([width / 2 + pixels * scale * x, height / 2 - pixels * scale * y, nearness], axis=1)

    def rays(
        self, columns: Float[np.ndarray, " n"], rows: Float[np.ndarray, " n"], *, height: int, width: int
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        r"""Origins o and directions v of the rays through points of a picture: $o + z\,v$ is seen there at the depth z.

        Columns and rows are counted as `project` counts them. Directions have unit length along the view, not in space.
        """
        x = (2 * columns - width) / min(height, width) * self._reach
        y = (height - 2 * rows) / min(height, width) * self._reach
        right, up, back = self.axes
        sideways = x[:, None] * right + y[:, None] * up
        eye, view = np.array(self.eye, dtype=np.float64), np.broadcast_to(-back, sideways.shape)
        return (
            (eye + sideways, view.copy()) if self.orthographic else (np.broadcast_to(eye, view.shape), view + sideways)
        )

    def footprint(self, *, height: int, width: int) -> float:
        """The side of a pixel at the depth 1, or at every depth if rays are parallel."""
        return 2 * self._reach / min(height, width)

    @property
    def _reach(self) -> float:
        """Half of what the shorter side of the picture spans at the depth 1, or at every depth if rays are parallel."""
        distance = np.linalg.norm(np.subtract(self.eye, self.target)) if self.orthographic else 1.0
        return float(distance * np.tan(np.radians(self.field_of_view / 2)))

    def depth(self, nearness: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """The distance from the eye along the view direction."""
        return -nearness if self.orthographic else 1 / nearness


def _vector(values: np.ndarray) -> Vector:
    x, y, z = values.tolist()
    return x, y, z
