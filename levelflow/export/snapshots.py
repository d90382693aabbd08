"""The surfaces of a field at some times, with what a picture in motion needs: normals and velocities."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from levelflow.export.normal_motion import slopes
from levelflow.extraction import EmptyLevelSet, extract
from levelflow.fields import Field
from levelflow.shapes.mesh import Mesh


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The surface at one time.

    Attributes:
        time: When.
        mesh: The surface in the units of the field, its `normals` those of the field; None when it has vanished.
        velocities: The normal part of the velocity of each vertex, in lengths per time; None if the field stands still.
        colours: sRGB and opacity of each vertex, if it was painted.
        uv: Texture coordinates of the corners of each triangle, if it was painted with them; v points up.
    """

    time: float
    mesh: Mesh | None
    velocities: Float[np.ndarray, "n d"] | None = None
    colours: UInt8[np.ndarray, "n 4"] | None = None
    uv: Float[np.ndarray, "m 3 2"] | None = None

    @property
    def is_empty(self) -> bool:
        """Whether the surface has vanished."""
        return self.mesh is None


def snapshots(
    field: Field, times: Sequence[float] = (), *, resolution: int = 128, refine: int = 3
) -> Iterator[Snapshot]:
    """The surfaces of a field, one after another, as they are asked for.

    A time at which the surface has vanished gives an empty snapshot.

    Args:
        field: A field of space and one time, or a static one.
        times: The times in increasing order, in the interval of the field; none for a static field, whose one snapshot
            has the time 0.
        resolution: Cells along the longest side of the box.
        refine: Steps that move each vertex onto the surface itself.

    Raises:
        EmptyLevelSet: After the last time, if there was a surface at none of them.
        ValueError: If the times are not those of the field, or not in order.
    """
    times = check_times(field, times, call="snapshots")
    empty: list[EmptyLevelSet] = []
    for t in times:
        try:
            mesh = extract(field.at(t) if field.times else field, resolution=resolution, refine=refine)
        except EmptyLevelSet as error:
            empty.append(error)
            yield Snapshot(t, None)
        else:
            yield on_surface(field, mesh, t)
    if len(empty) == len(times):
        raise EmptyLevelSet(f"snapshots: there is no surface at any of the times {list(times)}. {empty[-1]}")


def on_surface(field: Field, mesh: Mesh, t: float) -> Snapshot:
    """The snapshot whose vertices are given: the field adds their normals and velocities."""
    local = slopes(field, mesh.vertices, t)
    normals = np.where(np.linalg.norm(local.normals, axis=1, keepdims=True) > 0.5, local.normals, mesh.vertex_normals)
    return Snapshot(
        t,
        Mesh(mesh.vertices, mesh.faces, normals=normals, name=mesh.name),
        local.velocities if field.times else None,
    )


def check_times(field: Field, times: Sequence[float], *, call: str) -> tuple[float, ...]:
    """The times at which to look at a field; the only one of a static field is 0.

    Raises:
        ValueError: If they are not those of the field, or not in increasing order.
    """
    times = tuple(float(t) for t in times)
    if field.times > 1:
        raise ValueError(
            f"{call}: the field has {field.times} times or parameters; fix all but the time: give a field of one."
        )
    if not field.times:
        if times:
            raise ValueError(f"{call}(times={list(times)}): the field does not depend on time; leave the times out.")
        return (0.0,)
    if not times:
        between = f" from {field.box.times[0][0]:g} to {field.box.times[0][1]:g}" if field.box is not None else ""
        raise ValueError(f"{call}: the field moves{between}; say at which times it is wanted.")
    if any(not a < b for a, b in zip(times, times[1:], strict=False)):
        raise ValueError(f"{call}(times={list(times)}): the times must increase; sort them and leave out doubles.")
    for t in times:
        field.at(t)
    return times
