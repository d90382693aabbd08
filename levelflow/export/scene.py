"""How the numbers of a field stand in a scene: which way is up, how long a unit is, how time becomes frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from jaxtyping import Float

from levelflow.export.snapshots import Snapshot


class Up(Enum):
    """The axis that points up."""

    Y = "Y"
    Z = "Z"


@dataclass(frozen=True)
class Scene:
    """What a format for films wants to know and a field does not.

    The first time is frame 0 and the last frame n - 1; the times in between keep their proportions, so that evenly
    spaced times are whole frames.

    Attributes:
        up: The axis of the field that points up.
        metres_per_unit: The length of one unit of the field.
        fps: Frames per second.

    Raises:
        ValueError: If a length or rate is not positive.
    """

    up: Up = Up.Y
    metres_per_unit: float = 1.0
    fps: float = 24.0

    def __post_init__(self) -> None:
        for name in ("metres_per_unit", "fps"):
            value = getattr(self, name)
            if not 0 < value < float("inf"):
                raise ValueError(f"Scene({name}={value:g}): give a positive number.")

    def frames(self, times: Sequence[float]) -> tuple[float, ...]:
        """The frame of each time, from 0 to n - 1."""
        if len(times) < 2:
            return (0.0,) * len(times)
        first, last = times[0], times[-1]
        return tuple(round((t - first) / (last - first) * (len(times) - 1), 9) for t in times)

    def seconds_per_time(self, times: Sequence[float]) -> float:
        """How many seconds of film a unit of time takes."""
        return (len(times) - 1) / self.fps / (times[-1] - times[0]) if len(times) > 1 else 1 / self.fps


def kept(snapshots: Sequence[Snapshot], *, call: str) -> list[Snapshot]:
    """The snapshots that are not empty.

    Raises:
        ValueError: If there are none, or they hold curves in the plane.
    """
    found = [snapshot for snapshot in snapshots if snapshot.mesh is not None]
    if not found:
        raise ValueError(f"{call}: none of the {len(snapshots)} snapshots holds a surface; there is nothing to write.")
    if any(snapshot.mesh.faces.shape[1] != 3 for snapshot in found if snapshot.mesh is not None):
        raise ValueError(f"{call}: this format holds surfaces, no curves in the plane; write .ply or .pvd files.")
    return found


def origin(snapshots: Sequence[Snapshot]) -> Float[np.ndarray, " d"]:
    """The point from which float32 coordinates lose nothing: zero, unless the shape is far from there."""
    points = np.concatenate([s.mesh.vertices for s in snapshots if s.mesh is not None])
    low, high = points.min(0), points.max(0)
    far = max(np.abs(low).max(), np.abs(high).max()) > 16 * (high - low).max()
    return (low + high) / 2 if far else np.zeros_like(low)
