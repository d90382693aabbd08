"""Arithmetic on vertices and simplices: segments in the plane, triangles in space. Plain numpy, no records."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

Points = Float[np.ndarray, "n d"]
Faces = Int[np.ndarray, "m d"]


def area_vectors(vertices: Points, faces: Faces) -> Float[np.ndarray, "m d"]:
    """The outward normal of each simplex times its length (d = 2) or area (d = 3)."""
    corners = vertices[faces]
    edge = corners[:, 1] - corners[:, 0]
    if vertices.shape[1] == 2:
        return np.stack([edge[:, 1], -edge[:, 0]], 1)
    return np.cross(edge, corners[:, 2] - corners[:, 0]) / 2


def unit(vectors: Float[np.ndarray, "m d"]) -> Float[np.ndarray, "m d"]:
    """The vectors divided by their lengths; a zero vector stays zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def signed_volume(vertices: Points, faces: Faces) -> float:
    """The measure enclosed by the simplices, positive if they face outward, from Gauss's theorem.

    The sum of pyramids over the faces with their apex at the centre of the box. Where the surface is open the
    missing faces are so replaced by the cones over the holes.
    """
    apex = (vertices.max(0) + vertices.min(0)) / 2
    centroids = vertices[faces].mean(1) - apex
    return float((area_vectors(vertices, faces) * centroids).sum() / vertices.shape[1])


def vertex_normals(vertices: Points, faces: Faces) -> Points:
    """Unit normals at the vertices: the mean of the faces' normals, weighted by their angle at the vertex.

    In the plane both segments count the same. A vertex of no face, or whose faces cancel, gets a zero vector.

    Reference:
        Baerentzen, Aanaes, Signed Distance Computation Using the Angle Weighted Pseudonormal, TVCG 2005.
    """
    normals = unit(area_vectors(vertices, faces))
    d = vertices.shape[1]
    total = np.zeros_like(vertices)
    for i in range(d):
        weight = np.ones(len(faces))
        if d == 3:
            here = vertices[faces[:, i]]
            to_next, to_last = vertices[faces[:, (i + 1) % 3]] - here, vertices[faces[:, (i + 2) % 3]] - here
            sine = np.linalg.norm(np.cross(to_next, to_last), axis=1)
            weight = np.arctan2(sine, (to_next * to_last).sum(1))
        for axis in range(d):
            total[:, axis] += np.bincount(faces[:, i], weight * normals[:, axis], len(vertices))
    return unit(total)


def ridges(faces: Faces) -> tuple[Int[np.ndarray, "d*m d-1"], Int[np.ndarray, " d*m"]]:
    """The oriented boundary pieces of each simplex: sorted vertex numbers and the sign of their orientation.

    Edges of triangles, end points of segments. Piece i of the first array belongs to face i modulo m.
    """
    if faces.shape[1] == 2:
        ends = np.concatenate([faces[:, :1], faces[:, 1:]])
        return ends, np.repeat([-1, 1], len(faces))
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return np.sort(edges, axis=1), np.where(edges[:, 0] < edges[:, 1], 1, -1)


def ridge_numbers(faces: Faces, n: int) -> Int[np.ndarray, " d*m"]:
    """A number for each boundary piece, the same for the same vertices; n is the number of vertices."""
    ends, _ = ridges(faces)
    keys = ends[:, 0] if ends.shape[1] == 1 else ends[:, 0] * np.int64(n) + ends[:, 1]
    return np.unique(keys, return_inverse=True)[1].reshape(-1)


def is_watertight(faces: Faces, n: int) -> bool:
    """Whether each boundary piece belongs to exactly two faces, once in each orientation."""
    numbers = ridge_numbers(faces, n)
    return bool((np.bincount(numbers) == 2).all() and (np.bincount(numbers, ridges(faces)[1]) == 0).all())


def open_pieces(faces: Faces, n: int) -> Bool[np.ndarray, " d*m"]:
    """Which pieces of `ridges` lie on the boundary of the surface: their orientations do not cancel."""
    numbers = ridge_numbers(faces, n)
    return (np.bincount(numbers, ridges(faces)[1]) != 0)[numbers]


def open_faces(faces: Faces, n: int) -> Int[np.ndarray, " k"]:
    """The faces that have an edge on the boundary."""
    return np.unique(np.flatnonzero(open_pieces(faces, n)) % len(faces))


def face_components(faces: Faces, n: int) -> tuple[int, Int[np.ndarray, " m"]]:
    """The number of bodies and the body of each face; faces that share a vertex are of one body."""
    first = np.repeat(faces[:, 0], faces.shape[1] - 1)
    links = coo_matrix((np.ones(len(first), dtype=np.int8), (first, faces[:, 1:].reshape(-1))), shape=(n, n))
    labels = connected_components(links, directed=False)[1][faces[:, 0]]
    bodies, labels = np.unique(labels, return_inverse=True)
    return len(bodies), labels.reshape(-1)


def joined(vertices: Points, faces: Faces) -> Faces:
    """The faces with vertices at the same position made one, where that closes an edge.

    Texture seams and triangle soups store a vertex several times. Only vertices of open edges are joined, so that
    two sheets of a closed surface that merely touch stay two sheets.
    """
    boundary = np.zeros(len(vertices), dtype=bool)
    boundary[ridges(faces)[0][open_pieces(faces, len(vertices))].reshape(-1)] = True
    rows = np.flatnonzero(boundary)
    if not len(rows):
        return faces
    _, first, group = np.unique(vertices[rows] + 0.0, axis=0, return_index=True, return_inverse=True)
    target = np.arange(len(vertices))
    target[rows] = rows[first[group.reshape(-1)]]
    return target[faces]


def without_degenerate(faces: Faces) -> Int[np.ndarray, "k d"]:
    """The faces whose vertices are all different."""
    ordered = np.sort(faces, axis=1)
    return faces[(ordered[:, 1:] != ordered[:, :-1]).all(1)]


def triangulated(
    vertices: Float[np.ndarray, "n 3"], corners: Int[np.ndarray, " c"], sizes: Int[np.ndarray, " p"]
) -> Int[np.ndarray, "m 3"]:
    """Polygons, given by all their corners one after another, as triangles in the same order.

    A polygon becomes a fan from its first corner, or from its second if only that fan of a quad does not fold over;
    ears are clipped where a larger polygon is not convex. Polygons of fewer than three corners are left out.
    """
    starts = np.cumsum(sizes) - sizes
    pieces: list[np.ndarray] = []
    owners: list[np.ndarray] = []
    for size in np.unique(sizes[sizes >= 3]):
        which = np.flatnonzero(sizes == size)
        polygons = corners[starts[which, None] + np.arange(size)]
        if size == 4:
            polygons = np.where(_folds(vertices, polygons)[:, None], np.roll(polygons, -1, axis=1), polygons)
        triangles = _fan(polygons)
        if size > 4:
            for row in np.flatnonzero(_folds(vertices, polygons)):
                triangles[row] = _clip_ears(vertices, polygons[row])
        pieces.append(triangles.reshape(-1, 3))
        owners.append(np.repeat(which, size - 2))
    if not pieces:
        return np.empty((0, 3), dtype=np.int64)
    return np.concatenate(pieces)[np.argsort(np.concatenate(owners), kind="stable")]


def _fan(polygons: Int[np.ndarray, "p k"]) -> Int[np.ndarray, "p k-2 3"]:
    first = np.broadcast_to(polygons[:, :1], polygons[:, 1:-1].shape)
    return np.stack([first, polygons[:, 1:-1], polygons[:, 2:]], axis=2)


def _folds(vertices: Float[np.ndarray, "n 3"], polygons: Int[np.ndarray, "p k"]) -> Bool[np.ndarray, " p"]:
    corners = vertices[_fan(polygons)]
    areas = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    return ((areas * areas.sum(1, keepdims=True)).sum(2) < 0).any(1)


def _clip_ears(vertices: Float[np.ndarray, "n 3"], polygon: Int[np.ndarray, " k"]) -> Int[np.ndarray, "k-2 3"]:
    """Ear clipping in the plane of the polygon's area vector."""
    points = vertices[polygon]
    normal = np.cross(points, np.roll(points, -1, axis=0)).sum(0)
    u, v = [a for a in range(3) if a != np.abs(normal).argmax()]
    flat = points[:, [u, v]]
    (x, y), (x1, y1) = flat.T, np.roll(flat, -1, axis=0).T
    if (x * y1 - x1 * y).sum() < 0:
        flat = flat * [-1.0, 1.0]

    def turn(a: int, b: int, c: int) -> float:
        p, q = flat[b] - flat[a], flat[c] - flat[a]
        return float(p[0] * q[1] - p[1] * q[0])

    left, triangles = list(range(len(polygon))), []
    while len(left) > 3:
        ears = (
            i
            for i in range(len(left))
            if turn(a := left[i - 1], b := left[i], c := left[(i + 1) % len(left)]) > 0
            and all(min(turn(a, b, k), turn(b, c, k), turn(c, a, k)) < 0 for k in left if k not in (a, b, c))
        )
        i = next(ears, 0)
        triangles.append([left[i - 1], left[i], left[(i + 1) % len(left)]])
        del left[i]
    triangles.append(left)
    return polygon[np.array(triangles)]
