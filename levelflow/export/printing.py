"""STL for printing: a solid that a printer can make, or a refusal."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from levelflow.shapes import simplices
from levelflow.shapes.mesh import Mesh


def write_stl(mesh: Mesh, path: str | Path, *, millimetres_per_unit: float = 1.0) -> None:
    """Writes the surface of a solid as binary STL, in millimetres: so do printing programs read its numbers.

    What is checked is what will be in the file: STL keeps three float32 corners for each triangle, which programs join
    again where they are equal. Triangles that this makes degenerate are left out.

    Args:
        mesh: A closed surface that faces outward.
        path: The file, which appears whole or not at all.
        millimetres_per_unit: How many millimetres a unit of the mesh is.

    Raises:
        FileNotFoundError: If the folder does not exist.
        ValueError: If the surface is not watertight, encloses no volume, or is a curve in the plane.
    """
    if mesh.faces.shape[1] != 3:
        raise ValueError("write_stl: STL holds no curves in the plane; write a .ply file.")
    corners = (mesh.vertices * millimetres_per_unit).astype(np.float32).astype(np.float64)
    _, first, numbers = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    faces = simplices.without_degenerate(first[numbers.reshape(-1)][mesh.faces])
    if not len(faces) or not simplices.is_watertight(faces, len(corners)):
        boundary = int(simplices.open_pieces(faces, len(corners)).sum())
        why = f"it is open along {boundary} edges" if boundary else "more than two triangles meet in an edge"
        raise ValueError(
            f"write_stl: the surface is not watertight, {why}, and cannot be printed. Extract it at a higher "
            "resolution, in a box that holds all of it, or write a .ply file."
        )
    solid = Mesh(corners, faces, name=mesh.name)
    if not solid.volume > 0:
        raise ValueError(
            f"write_stl: the surface encloses a volume of {solid.volume:g}; it faces inward. "
            "Turn its faces: `mesh.oriented()`."
        )
    solid.write(path)
