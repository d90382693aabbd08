"""Binary PLY with all that a snapshot knows: normals, velocities, colours and texture coordinates."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from levelflow.export.snapshots import Snapshot
from levelflow.shapes.mesh import Mesh
from levelflow.shapes.writing import replace_file


def write_ply(snapshot: Snapshot, path: str | Path) -> None:
    """Writes a snapshot as binary PLY, in the units of the field; the file appears whole or not at all.

    Vertices have the properties `x y z`, `nx ny nz`, `vx vy vz` (velocity) and `red green blue alpha`, each where it is
    known; faces have `texcoord`, the u and v of their three corners. Coordinates are float32 unless the shape is so far
    from the origin that this would move it. A curve in the plane has two coordinates, and edges.

    Raises:
        FileNotFoundError: If the folder does not exist.
        ValueError: If the snapshot is empty.
    """
    mesh = snapshot.mesh
    if mesh is None:
        raise ValueError(f"write_ply: the surface has vanished at t = {snapshot.time:g}; there is nothing to write.")
    vertices, more = _vertex_table(snapshot, mesh)
    faces, kind = _face_table(snapshot, mesh)
    header = ["ply", "format binary_little_endian 1.0", "comment written by levelflow"]
    header += [f"comment time {snapshot.time!r}", f"element vertex {len(vertices)}", *more]
    header += [f"element {'face' if mesh.faces.shape[1] == 3 else 'edge'} {len(faces)}", *kind, "end_header\n"]
    replace_file(Path(path), "\n".join(header).encode() + vertices.tobytes() + faces.tobytes())


def precision(mesh: Mesh) -> str:
    """float32, or float64 where that would lose a millionth of the size of the shape."""
    return "<f8" if np.abs(mesh.vertices).max() > 16 * max(mesh.box.size) else "<f4"


def _vertex_table(snapshot: Snapshot, mesh: Mesh) -> tuple[np.ndarray, list[str]]:
    """The records of the vertices, and the lines of the header that describe them."""
    axes = "xyz"[: mesh.vertices.shape[1]]
    real = precision(mesh)
    columns = {axis: (real, mesh.vertices[:, i]) for i, axis in enumerate(axes)}
    columns |= {f"n{axis}": ("<f4", mesh.vertex_normals[:, i]) for i, axis in enumerate(axes)}
    if snapshot.velocities is not None:
        columns |= {f"v{axis}": ("<f4", snapshot.velocities[:, i]) for i, axis in enumerate(axes)}
    if snapshot.colours is not None:
        columns |= {c: ("u1", snapshot.colours[:, i]) for i, c in enumerate(("red", "green", "blue", "alpha"))}
    table = np.empty(len(mesh.vertices), np.dtype([(name, kind) for name, (kind, _) in columns.items()]))
    for name, (_, values) in columns.items():
        table[name] = values
    words = {"<f4": "float", "<f8": "double", "u1": "uchar"}
    return table, [f"property {words[kind]} {name}" for name, (kind, _) in columns.items()]


def _face_table(snapshot: Snapshot, mesh: Mesh) -> tuple[np.ndarray, list[str]]:
    if mesh.faces.shape[1] == 2:
        return mesh.faces.astype("<i4"), ["property int vertex1", "property int vertex2"]
    kind: list[tuple] = [("size", "u1"), ("corners", "<i4", 3)]
    lines = ["property list uchar int vertex_indices"]
    if snapshot.uv is not None:
        kind += [("numbers", "u1"), ("uv", "<f4", 6)]
        lines.append("property list uchar float texcoord")
    table = np.empty(len(mesh.faces), np.dtype(kind))
    table["size"], table["corners"] = 3, mesh.faces
    if snapshot.uv is not None:
        table["numbers"], table["uv"] = 6, snapshot.uv.reshape(-1, 6)
    return table, lines
