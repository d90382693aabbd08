"""The Laplacian of a mesh, by cotangents and with its mass matrix, on any triangles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import igl
import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import splu

from levelflow.shapes import simplices
from levelflow.shapes.simplices import Faces, Points

# By how much two sides of a triangle are longer than the third, at least, and what they get where they are not; and how
# long a segment is: shares of the mean length of all sides. On thinner triangles libigl flips edges for ever, and still
# does after 1e-4.
_THIN, _SLACK, _SHORT = 1e-8, 1e-3, 1e-6


@dataclass(frozen=True, eq=False)
class Laplacian:
    r"""The Laplace-Beltrami operator of a mesh, $\Delta = -M^{-1} L$.

    The cotangent weights are those of the intrinsic Delaunay triangulation, which has the same vertices and edges that
    are straight on the mesh: inside a surface none is negative, however bad the triangles. Triangles without area get
    some first, from the same small length added to all sides; nothing is added if no triangle needs it. In the plane
    the weights are those of linear elements on the segments.

    Attributes:
        stiffness: L, sparse (n, n), symmetric and positive semi-definite; without unit for surfaces, 1 / length for
            curves.
        mass: The diagonal of M, (n,): the area (length) around each vertex, as Voronoi cells; 0 for a vertex of no
            face.

    Reference:
        Meyer et al., Discrete Differential-Geometry Operators for Triangulated 2-Manifolds (2003); Fisher et al.,
        Intrinsic Delaunay triangulations (2007); Sharp and Crane, A Laplacian for Nonmanifold Triangle Meshes (2020),
        Sec. 4.5.
    """

    stiffness: Any
    mass: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, vertices: Points, faces: Faces) -> Laplacian:
        """The Laplacian of triangles in space, or of segments in the plane."""
        n, faces = len(vertices), simplices.without_degenerate(faces)
        used, numbers = np.unique(faces, return_inverse=True)
        corners = vertices[faces]
        # The side i of a triangle is opposite to its corner i.
        sides = (
            corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]] if faces.shape[1] == 3 else corners[:, 1:] - corners[:, :1]
        )
        lengths = np.linalg.norm(sides, axis=2)
        scale = float(lengths.mean()) if len(lengths) else 0.0
        if not scale > 0:
            return cls(coo_matrix((n, n)).tocsc(), np.zeros(n))
        build = _of_triangles if faces.shape[1] == 3 else _of_segments
        stiffness, own = build(lengths / scale, numbers.reshape(faces.shape))
        stiffness, mass = stiffness.tocoo(), np.zeros(n)
        mass[used] = own * scale ** (faces.shape[1] - 1)
        weights = stiffness.data * scale ** (faces.shape[1] - 3)
        return cls(coo_matrix((weights, (used[stiffness.row], used[stiffness.col])), shape=(n, n)).tocsc(), mass)

    def screened(
        self, area: float, *, held: Bool[np.ndarray, " n"]
    ) -> Callable[[Float[np.ndarray, "n k"]], Float[np.ndarray, "n k"]]:
        r"""What solves $(M + a L)\, u = b$ for u, given b.

        Args:
            area: a, at least 0, in length^2.
            held: Where u is 0, whatever b is; so it is at vertices of no face.
        """
        free = np.flatnonzero(~held & (self.mass > 0))
        if not len(free):
            return np.zeros_like
        matrix = (diags(self.mass) + area * self.stiffness).tocsc()[free][:, free]
        factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})

        def solve(load: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
            solution = np.zeros_like(load)
            solution[free] = factors.solve(load[free])
            return solution

        return solve


def boundary(faces: Faces, n: int) -> Bool[np.ndarray, " n"]:
    """Which of n vertices lie on the boundary of an open mesh: on an edge of one face, or at the end of a curve."""
    faces = simplices.without_degenerate(faces)
    numbers = simplices.ridge_numbers(faces, n)
    single = np.bincount(numbers)[numbers] == 1
    ends = np.zeros(n, dtype=bool)
    ends[simplices.ridges(faces)[0][single]] = True
    return ends


def _of_triangles(lengths: Float[np.ndarray, "m 3"], faces: Faces) -> tuple[Any, Float[np.ndarray, " n"]]:
    slack = (lengths.sum(1) - 2 * lengths.max(1)).min()
    lengths, faces, *_ = igl.intrinsic_delaunay_triangulation(lengths + (_SLACK - slack) * (slack < _THIN), faces)
    mass = igl.massmatrix_intrinsic(lengths, faces, igl.MASSMATRIX_TYPE_VORONOI)
    return -igl.cotmatrix_intrinsic(lengths, faces), mass.diagonal()


def _of_segments(lengths: Float[np.ndarray, "m 1"], faces: Faces) -> tuple[Any, Float[np.ndarray, " n"]]:
    lengths = np.maximum(lengths[:, 0], _SHORT)
    ends, others = faces.T
    weights = np.repeat([[-1.0], [-1.0], [1.0], [1.0]], len(faces), axis=1) / lengths
    rows, columns = np.concatenate([ends, others, ends, others]), np.concatenate([others, ends, ends, others])
    return coo_matrix((weights.reshape(-1), (rows, columns))), np.bincount(faces.reshape(-1), np.repeat(lengths / 2, 2))
