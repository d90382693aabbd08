"""Exact signed distance to triangles (or to segments in the plane): closest points and winding numbers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Closest(NamedTuple):
    """The nearest point of a surface: how far it is, the face it lies on, and where it is."""

    distance: Float[np.ndarray, " n"]
    face: Int[np.ndarray, " n"]
    point: Float[np.ndarray, "n d"]


class TriangleDistance:
    """Distances to a fixed set of simplices; the search trees are built once, here.

    The distance is that of the closest point on the triangles. The sign comes from the generalised winding number
    $w(x) = \\sum_f \\Omega_f(x) / 4\\pi$, the share of the sphere of directions that the surface covers as seen
    from x: 1 inside and 0 outside a closed surface, in between near the holes of an open one. Inside means
    w > 1/2. In space the sum is the fast approximation by a tree (within 0.006 of the exact one on the meshes
    tried), in the plane it is exact.

    Args:
        vertices: Positions, (n, d) with d = 2 or 3.
        faces: Rows of vertex numbers, (m, d): segments in the plane, triangles in space, facing outward.
    Reference:
        Barill et al., Fast Winding Numbers for Soups and Clouds, SIGGRAPH 2018.
    """

    def __init__(self, vertices: Float[np.ndarray, "n d"], faces: Int[np.ndarray, "m d"]) -> None:
        # Trees in units of the mesh around its centre: the winding tree computes in float32.
        low, high = vertices.min(0), vertices.max(0)
        self._center = (low + high) / 2
        self._scale = float((high - low).max()) / 2 or 1.0
        self._vertices = np.ascontiguousarray((vertices - self._center) / self._scale, dtype=np.float64)
        self._faces = np.ascontiguousarray(faces, dtype=np.int64)
        if vertices.shape[1] == 3:
            import igl

            self._tree = igl.AABB()
            self._tree.init(self._vertices, self._faces)
            self._winding = igl.FastWindingNumberBVH()
            self._winding.init(self._vertices, self._faces)

    def closest(self, x: Float[np.ndarray, "n d"]) -> Closest:
        """The nearest points of the surface; NaN where x is not finite."""
        x, lost = self._local(x)
        if x.shape[1] == 3:
            squared, face, point = self._tree.squared_distance(self._vertices, self._faces, x)
        else:
            squared, face, point = self._closest_in_plane(x)
        squared[lost] = point[lost] = np.nan
        return Closest(np.sqrt(squared) * self._scale, face, point * self._scale + self._center)

    def winding(self, x: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        """The generalised winding number around each point; NaN where x is not finite."""
        x, lost = self._local(x)
        w = self._winding.winding_number(x) if x.shape[1] == 3 else self._winding_in_plane(x)
        w[lost] = np.nan
        return w

    def __call__(self, x: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        """The signed distance, negative inside."""
        return np.where(self.winding(x) > 0.5, -1.0, 1.0) * self.closest(x).distance

    def _local(self, x: Float[np.ndarray, "n d"]) -> tuple[np.ndarray, np.ndarray]:
        local = np.ascontiguousarray((np.asarray(x, dtype=np.float64) - self._center) / self._scale)
        lost = ~np.isfinite(local).all(1)
        local[lost] = 0.0
        return local, lost

    def _chunks(self, n: int) -> list[slice]:
        step = max(1, 1_000_000 // len(self._faces))
        return [slice(i, i + step) for i in range(0, n, step)]

    def _closest_in_plane(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        start = self._vertices[self._faces[:, 0]]
        edge = self._vertices[self._faces[:, 1]] - start
        length2 = np.maximum((edge**2).sum(1), np.finfo(np.float64).tiny)
        face, point = np.empty(len(x), dtype=np.int64), np.empty_like(x)
        for rows in self._chunks(len(x)):
            along = ((x[rows, None] - start) * edge).sum(2) / length2
            feet = start + np.clip(along, 0, 1)[:, :, None] * edge
            face[rows] = ((x[rows, None] - feet) ** 2).sum(2).argmin(1)
            point[rows] = feet[np.arange(len(feet)), face[rows]]
        return ((x - point) ** 2).sum(1), face, point

    def _winding_in_plane(self, x: np.ndarray) -> np.ndarray:
        w = np.empty(len(x))
        for rows in self._chunks(len(x)):
            a, b = (self._vertices[self._faces[:, i]] - x[rows, None] for i in (0, 1))
            turn = np.arctan2(a[:, :, 0] * b[:, :, 1] - a[:, :, 1] * b[:, :, 0], (a * b).sum(2))
            w[rows] = turn.sum(1) / (2 * np.pi)
        return w
