"""Colours and texture coordinates of a mesh, carried to the surfaces of a field by closest points."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

from levelflow.export.normal_motion import carry
from levelflow.export.snapshots import Snapshot
from levelflow.fields import Field
from levelflow.shapes.distance import TriangleDistance
from levelflow.shapes.mesh import Mesh

# Farther than this share of the size of the painted mesh, its closest point says little about a vertex.
_FAR = 0.05


class PaintWarning(UserWarning):
    """Colours were carried to where they have little meaning."""


@dataclass(frozen=True, eq=False)
class Paint:
    """A mesh with colours or texture coordinates at the corners of its triangles.

    Attributes:
        vertices: Positions, in the units of the field that is to be painted.
        faces: Triangles.
        colours: sRGB and opacity of each corner, if there are colours.
        uv: Texture coordinates of each corner, if there are some; v points up.
        name: What messages call it.
    """

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    colours: UInt8[np.ndarray, "m 3 4"] | None
    uv: Float[np.ndarray, "m 3 2"] | None
    name: str

    @classmethod
    def read(cls, path: str | Path) -> Paint:
        """Reads the colours of vertices or faces (OBJ, PLY, OFF, GLB) and the texture coordinates (OBJ, PLY, GLB).

        Images are not read: with its texture coordinates a surface wears the texture of the mesh.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If it is no mesh, or has neither colours nor texture coordinates.
        """
        import trimesh

        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"Paint.read: there is no file {str(path)!r} (looked in {Path.cwd()}).")
        try:
            mesh = trimesh.load_scene(path, process=False).to_mesh()
            faces = np.asarray(mesh.faces, dtype=np.int64)
            colours, uv = _colours(mesh), _texture(mesh)
        except Exception as error:
            raise ValueError(f"Paint.read: {path.name!r} is not a mesh that can be read: {error}.") from None
        if colours is None and uv is None:
            raise ValueError(
                f"Paint.read: {path.name!r} has neither colours nor texture coordinates; there is nothing to carry."
            )
        return cls(np.asarray(mesh.vertices, dtype=np.float64), faces, colours, uv, path.name)

    @property
    def size(self) -> float:
        """The longest side of the box around the mesh."""
        return float(np.ptp(self.vertices, axis=0).max())


def painted(
    snapshots: Iterable[Snapshot], paint: Paint, *, along: Field | None = None, time: float = 0.0
) -> Iterator[Snapshot]:
    """Snapshots with the colours and texture coordinates of the closest points of a painted mesh.

    That has a meaning where a surface is near the mesh. Elsewhere, give the field: each vertex is then carried back
    along the normal to the time of the mesh before its closest point is sought. What was born in between, in a pinch
    for example, has no place to come from, and a warning says how much that is.

    Args:
        snapshots: The surfaces; each is painted when it is asked for.
        paint: The painted mesh.
        along: The field that the snapshots are of, to carry their vertices back along.
        time: When the mesh is the surface of that field.

    Raises:
        ValueError: If a snapshot is a curve in the plane, or the field does not move, or not at that time.

    Warns:
        PaintWarning: If a vertex is far from the mesh, or cannot be carried back.
    """
    if along is not None and along.times != 1:
        raise ValueError(f"painted(along=f): the field has {along.times} times; give one that moves, or leave it out.")
    if along is not None:
        along.at(time)
    source = TriangleDistance(paint.vertices, paint.faces)
    for snapshot in snapshots:
        if snapshot.mesh is None:
            yield snapshot
            continue
        mesh = snapshot.mesh
        if mesh.faces.shape[1] != 3:
            raise ValueError("painted: a curve in the plane takes no colours from a mesh.")
        points = mesh.vertices
        if along is not None and snapshot.time != time:
            points = _back(along, snapshot, mesh, time, paint)
        found = source.closest(points)
        far = float((found.distance > _FAR * paint.size).mean())
        if far and along is None:
            warnings.warn(
                f"painted: at t = {snapshot.time:g}, {100 * far:.2g} % of the vertices are further than "
                f"{_FAR * paint.size:.3g} from {paint.name}; the colour of the closest point means little there. "
                "Carry the colours along the motion instead.",
                PaintWarning,
                stacklevel=2,
            )
        face = found.face.astype(np.int64)
        weights = _barycentric(found.point, paint.vertices[paint.faces[face]])
        yield dataclasses.replace(
            snapshot,
            colours=None if paint.colours is None else _mixed(paint.colours[face], weights),
            uv=None if paint.uv is None else _corners(paint, source, points, mesh.faces, face, weights),
        )


def painted_once(
    snapshots: Iterable[Snapshot], paint: Paint, *, along: Field | None = None, time: float = 0.0
) -> Iterator[Snapshot]:
    """Snapshots of `track`, all with the colours that `painted` gives the first: their vertices are the same points."""
    first: Snapshot | None = None
    for snapshot in snapshots:
        if first is None:
            (first,) = painted([snapshot], paint, along=along, time=time)
        yield dataclasses.replace(snapshot, colours=first.colours, uv=first.uv)


def _back(field: Field, snapshot: Snapshot, mesh: Mesh, time: float, paint: Paint) -> np.ndarray:
    """The vertices where they were at the time of the paint; those that did not arrive wherever they got to."""
    corners = mesh.vertices[mesh.faces]
    step = 4 * float(np.median(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)))
    carried = carry(field, mesh.vertices, snapshot.time, time, step=step)
    if not carried.arrived.all():
        share = 100 * float((~carried.arrived).mean())
        warnings.warn(
            f"painted: {share:.2g} % of the vertices at t = {snapshot.time:g} cannot be carried back to t = {time:g}, "
            f"where {paint.name} is: the surface there was born in between. Their colour means little.",
            PaintWarning,
            stacklevel=3,
        )
    return carried.points


def _colours(mesh: Any) -> UInt8[np.ndarray, "m 3 4"] | None:
    if mesh.visual.kind == "vertex":
        return np.asarray(mesh.visual.vertex_colors, dtype=np.uint8)[mesh.faces]
    if mesh.visual.kind == "face":
        return np.repeat(np.asarray(mesh.visual.face_colors, dtype=np.uint8)[:, None], 3, axis=1)
    return None


def _texture(mesh: Any) -> Float[np.ndarray, "m 3 2"] | None:
    uv = getattr(mesh.visual, "uv", None)
    return None if uv is None else np.asarray(uv, dtype=np.float64)[mesh.faces][:, :, :2]


def _mixed(colours: UInt8[np.ndarray, "n 3 4"], weights: Float[np.ndarray, "n 3"]) -> UInt8[np.ndarray, "n 4"]:
    return np.round((weights[:, :, None] * colours).sum(1)).clip(0, 255).astype(np.uint8)


def _corners(
    paint: Paint,
    source: TriangleDistance,
    points: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    face: Int[np.ndarray, " n"],
    weights: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "m 3 2"]:
    """Texture coordinates of the corners of faces.

    Each corner has those of its closest point, but a face across a seam would then stretch over the whole texture:
    there the triangle closest to the middle of the face, continued beyond its sides, gives all three.
    """
    assert paint.uv is not None
    own = (weights[:, :, None] * paint.uv[face]).sum(1)[faces]
    middle = source.closest(points[faces].mean(1)).face
    triangles = paint.vertices[paint.faces[middle]]
    continued = np.stack(
        [(_barycentric(points[faces[:, i]], triangles)[:, :, None] * paint.uv[middle]).sum(1) for i in range(3)],
        axis=1,
    )
    across = np.ptp(continued, axis=1).max(1) < 0.5 * np.ptp(own, axis=1).max(1)
    return np.where(across[:, None, None], continued, own)


def _barycentric(x: Float[np.ndarray, "n 3"], triangles: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Barycentric coordinates of the projections of points to the planes of triangles; the first corner if flat."""
    a, b, c = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(b, c)
    square = (normal**2).sum(1)
    p = x - a
    v = (np.cross(p, c) * normal).sum(1)
    w = (np.cross(b, p) * normal).sum(1)
    v, w = (np.divide(s, square, out=np.zeros_like(s), where=square > 0) for s in (v, w))
    return np.stack([1 - v - w, v, w], axis=1)
