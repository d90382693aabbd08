"""The motion of a mesh by handles, and how well it went."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np
from jaxtyping import Bool, Float, Int

from levelflow.flows.densifying import BlendedMotions, Densify, Pull, untouched
from levelflow.flows.flow import Flow
from levelflow.handles import Handle, HandleWarning, selected
from levelflow.measures import Spread
from levelflow.shapes.mesh import Mesh

# How far a surface that is extracted anew may be from where its handle took it, in mean edges.
_REACH = 2.0


@dataclass(frozen=True, eq=False)
class Edit(Flow):
    """Handles go where they are to go while the time runs from 0 to 1, and the rest of the surface follows.

    In each step the vertices that the handles hold move along the paths of their handles, and `densify` says what the
    others do. The mesh of a step need not be that of the step before: a vertex is a handle's if the handle's motion so
    far, undone, takes it into the region and onto the surface as it was at first. What two handles want in different
    places by then belongs to neither.

    Args:
        surface: The surface before the edit.
        handles: What is asked of it.
        densify: `BlendedMotions` (large rotations in steps), `AsRigidAsPossible` or `ThinShell`.
        call: Who asks, for the errors.

    Attributes:
        vertices: The numbers of the vertices of the surface that each handle holds.
        untouched: Whether each vertex belongs to a body without handles.

    Raises:
        ValueError: If the handles are none, miss the surface or contradict each other; see `handles.selected`.

    Warns:
        HandleWarning: If all handles want the same, or bodies of the surface have no handle; such a body stays where it
            is.

    Reference:
        Mehta et al., A Level Set Theory for Neural Implicit Evolution under Explicit Flows, ECCV 2022, Sec. 6.3.
    """

    surface: Mesh
    handles: Sequence[Handle]
    densify: Densify = field(default_factory=BlendedMotions, kw_only=True)
    call: str = field(default="Edit", kw_only=True, repr=False)
    vertices: tuple[Int[np.ndarray, " k"], ...] = field(init=False, repr=False)
    untouched: Bool[np.ndarray, " n"] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        held = selected(self.handles, self.surface.vertices, call=self.call)
        still = untouched(self.surface, np.concatenate(held))
        object.__setattr__(self, "vertices", held)
        object.__setattr__(self, "untouched", still)
        if still.any():
            first = tuple(self.surface.vertices[still.argmax()].tolist())
            warnings.warn(
                f"{self.call}: no handle holds any of the bodies that {int(still.sum())} of {len(still)} vertices "
                f"belong to, such as the one at {first}: these bodies stay where they are. To move them, give "
                "them a handle.",
                HandleWarning,
                stacklevel=3,
            )

    def displacement(self, mesh: Mesh, dt: float, *, time: float) -> Float[np.ndarray, "n d"]:
        """By how much each vertex of the surface at a time moves until dt later.

        Raises:
            ValueError: If the step is not positive or leaves the times from 0 to 1, or no handle holds any vertex.

        Warns:
            HandleWarning: If a handle holds no vertex any more.
        """
        # Steps of 1 / n add up to 1 up to rounding.
        if not (dt > 0 and time >= 0 and time + dt <= 1 + 1e-9):
            raise ValueError(
                f"Edit.displacement(dt={dt:g}, time={time:g}): an edit runs from time 0 to 1, and this step from "
                f"{time:g} to {time + dt:g}."
            )
        return self.densify(mesh, self.pulls(mesh, time, min(time + dt, 1.0)))

    def pulls(self, mesh: Mesh, start: float, end: float) -> list[Pull]:
        """What the handles hold of a mesh at a time, and their motions from then to another time."""
        x, size = mesh.vertices, max(self.surface.box.size)
        held = np.stack([self._held(handle, x, start) for handle in self.handles])
        for number, handle in enumerate(self.handles, 1):
            if held[number - 1].any():
                continue
            warnings.warn(
                f"{self.call}: at time {start:g} handle {number} ({handle.name!r}) holds no vertex any more: the "
                "surface is not where the handle took it. Take smaller steps, or more training for each.",
                HandleWarning,
                stacklevel=3,
            )
        wanted = np.stack([_carried(handle, start, end, x) for handle in self.handles])
        first = held.argmax(0)
        gaps = np.linalg.norm(wanted - wanted[first, np.arange(len(x))], axis=2)
        held &= ~(held & (gaps > 1e-9 * size)).any(0)
        held &= first == np.arange(len(held))[:, None]
        if not held.any():
            raise ValueError(
                f"{self.call}: at time {start:g} no handle holds any of the {len(x)} vertices of the mesh; the surface "
                "is not where the handles took it. Take smaller steps, or more training for each."
            )
        return [
            Pull(np.flatnonzero(mine), partial(_carried, handle, start, end))
            for handle, mine in zip(self.handles, held, strict=True)
            if mine.any()
        ]

    def deformed(self, *, steps: int, on_step: Callable[[Mesh], None] = lambda _: None) -> Mesh:
        """The surface itself after the whole edit in equal steps, with no field and no new mesh.

        Args:
            steps: Their number.
            on_step: Called with the mesh after each step; it may raise to end the work.

        Raises:
            ValueError: If there are no steps.
        """
        if steps < 1:
            raise ValueError(f"Edit.deformed(steps={steps}): at least one step is needed.")
        mesh = self.surface
        for step in range(steps):
            x = mesh.vertices + self.displacement(mesh, 1 / steps, time=step / steps)
            mesh = Mesh(x, mesh.faces, frame=mesh.frame, name=mesh.name)
            on_step(mesh)
        return mesh

    def _held(self, handle: Handle, x: Float[np.ndarray, "n d"], time: float) -> Bool[np.ndarray, " n"]:
        origin = handle.origin(x, time)
        held = handle.region.distance(origin) <= 1e-9 * max(self.surface.box.size)
        held[held] = self.surface.closest(origin[held]).distance <= self._reach
        return held

    @cached_property
    def _reach(self) -> float:
        corners = self.surface.vertices[self.surface.faces]
        return _REACH * float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean())


def _carried(handle: Handle, start: float, end: float, x: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
    return handle.target(handle.origin(x, start), end)


def handle_error(edit: Edit, after: Mesh) -> Spread:
    """How far the surface after an edit is from where the handles want the vertices that they held before it.

    The distance is to the nearest point of the surface, whose mesh may be another one: what slides along the surface
    goes unnoticed.
    """
    x = edit.surface.vertices
    targets = [pull.carry(x[pull.vertices]) for pull in edit.pulls(edit.surface, 0.0, 1.0)]
    distance = after.closest(np.concatenate(targets)).distance
    return Spread(float(distance.mean()), float(distance.max()))


def volume_change(before: Mesh, after: Mesh) -> float:
    """The volume gained by an edit, as a part of the volume before it; in the plane the area. Negative if lost.

    Raises:
        ValueError: If there was no volume before.
    """
    if not before.volume:
        raise ValueError(f"volume_change: {before!r} encloses no volume, so no part of it can be gained or lost.")
    return after.volume / before.volume - 1


def edge_distortion(before: Mesh, after: Mesh) -> float:
    r"""The mean of $|\log(l' / l)|$ over the edges, with l and l' their lengths before and after.

    Nothing but a rigid motion has none. Edges without length are left out.

    Raises:
        ValueError: If the meshes have different faces.
    """
    if before.faces.shape != after.faces.shape or (before.faces != after.faces).any():
        raise ValueError(
            f"edge_distortion: {before!r} and {after!r} have different faces; lengths can be compared only on the same "
            "mesh with its vertices moved."
        )
    d = before.faces.shape[1]
    sides = np.concatenate([before.faces[:, [i, i - 1]] for i in range(d)])
    edges = np.unique(np.sort(sides, axis=1), axis=0)
    old, new = (np.linalg.norm(np.diff(mesh.vertices[edges], axis=1)[:, 0], axis=1) for mesh in (before, after))
    known = (old > 0) & (new > 0)
    return float(np.abs(np.log(new[known] / old[known])).mean())
