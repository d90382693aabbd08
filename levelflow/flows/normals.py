"""Normals of a smooth surface at the vertices of a mesh of it."""

from __future__ import annotations

import numpy as np

from levelflow.shapes import simplices
from levelflow.shapes.mesh import Mesh
from levelflow.shapes.simplices import Points

# Sides shorter than this share of the mean have no direction to go by.
_SHORTEST = 1e-6


def smooth_normals(mesh: Mesh) -> Points:
    """Unit normals at the vertices, exact where these lie on a sphere (in the plane, on a circle).

    The `normals` given with the mesh, if there are; else the normals of the faces around, weighted by the area over
    the squared lengths of the two sides that meet at the vertex (by 1 / length in the plane). Zero at a vertex of no
    face.

    Reference:
        Max, Weights for Computing Vertex Normals from Facet Normals, J. Graphics Tools 4 (1999).
    """
    if mesh.normals is not None:
        return mesh.normals
    vertices, faces = mesh.vertices, mesh.faces
    d = faces.shape[1]
    square = ((vertices[np.roll(faces, -1, axis=1)] - vertices[faces]) ** 2).sum(2)
    long = square > _SHORTEST**2 * square.mean()
    inverse = np.divide(1.0, square, out=np.zeros_like(square), where=long)
    areas, total = simplices.area_vectors(vertices, faces), np.zeros_like(vertices)
    for i in range(d):
        weight = inverse[:, i] * inverse[:, i - 1] if d == 3 else inverse[:, i]
        for axis in range(d):
            total[:, axis] += np.bincount(faces[:, i], weight * areas[:, axis], len(vertices))
    normals = simplices.unit(total)
    return np.where(normals.any(1, keepdims=True), normals, simplices.vertex_normals(vertices, faces))
