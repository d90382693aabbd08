"""Which triangle is seen in each pixel, and where on it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from levelflow.rendering.camera import Camera
from levelflow.rendering.hits import Hits, towards_eye
from levelflow.shapes.mesh import Mesh

_FRAGMENTS_AT_ONCE = 1 << 21
# In pixels: neighbours round the end of a shared span differently, and must leave no hole between them.
_OVERLAP = 1e-9
# The cosine between a face's normal and a vertex's below which there is an edge to be seen.
_CREASE = 0.75


@dataclass(frozen=True)
class Raster:
    """The covered pixels of a picture, p of them, and what is seen there.

    Attributes:
        height: Rows of the picture.
        width: Columns.
        pixels: The covered pixels, row * width + column, in increasing order.
        faces: The face seen in each.
        barycentric: Where on the face the pixel's centre looks (corrected for perspective).
        depth: The distance from the eye along the view direction.
    """

    height: int
    width: int
    pixels: Int[np.ndarray, " p"]
    faces: Int[np.ndarray, " p"]
    barycentric: Float[np.ndarray, "p 3"]
    depth: Float[np.ndarray, " p"]

    @property
    def mask(self) -> Bool[np.ndarray, "h w"]:
        """Whether each pixel is covered."""
        return self.place(np.ones(len(self.pixels), bool), background=False)

    def interpolate(self, corners: Float[np.ndarray, "m 3 c"]) -> Float[np.ndarray, "p c"]:
        """Values given at the three corners of each face, at each covered pixel."""
        return np.einsum("pi,pic->pc", self.barycentric, corners[self.faces])

    def place(self, values: np.ndarray, *, background: float | bool | np.ndarray) -> np.ndarray:
        """The picture (h, w, ...) that has the given values at the covered pixels."""
        picture = np.empty((self.height * self.width, *values.shape[1:]), values.dtype)
        picture[:] = background
        picture[self.pixels] = values
        return picture.reshape(self.height, self.width, *values.shape[1:])


def rasterise(mesh: Mesh, camera: Camera, *, height: int, width: int) -> Raster:
    """The nearest triangle at the centre of each pixel, by a z-buffer over the exact spans of each triangle's rows.

    Triangles that reach behind a pinhole are left out. The cost is that of the pixels covered, however large or
    small the triangles are.

    Raises:
        ValueError: If the mesh is not made of triangles.
    """
    if mesh.faces.shape[1] != 3:
        raise ValueError(f"rasterise(mesh): its faces have {mesh.faces.shape[1]} vertices; triangles are needed.")
    points = camera.project(mesh.vertices, height=height, width=width)[mesh.faces]
    planes, valid = _planes(points)
    best = np.full(height * width, -np.inf)
    face = np.zeros(height * width, np.int64)
    for candidates in _batches(points, valid, height, width):
        pixels, owners, nearness = _fragments(points, planes, candidates, height, width)
        np.maximum.at(best, pixels, nearness)
        nearest = nearness >= best[pixels]
        face[pixels[nearest]] = owners[nearest]
    pixels = np.flatnonzero(best > -np.inf)
    faces, nearness = face[pixels], best[pixels]
    position = np.stack([pixels % width + 0.5, pixels // width + 0.5, np.ones(len(pixels))], axis=1)
    barycentric = np.einsum("pic,pc->pi", planes[faces], position)
    if not camera.orthographic:
        barycentric *= points[faces, :, 2] / nearness[:, None]
    return Raster(height, width, pixels, faces, barycentric, camera.depth(nearness))


def hits_on(raster: Raster, mesh: Mesh, camera: Camera, *, samples: int) -> Hits:
    """What a raster sees of a mesh, as samples of a picture whose pixels are `samples` times as large.

    Normals are those of the vertices, between them; at creases those of the faces.
    """
    faces = mesh.face_normals
    corners = mesh.vertex_normals[mesh.faces]
    crease = (corners * faces[:, None]).sum(2) < _CREASE
    normals = raster.interpolate(np.where(crease[..., None], faces[:, None], corners))
    normals /= np.sqrt(np.einsum("pc,pc->p", normals, normals)).clip(min=1e-300)[:, None]
    points = raster.interpolate(mesh.vertices[mesh.faces])
    towards = towards_eye(camera, points)
    rows, columns = raster.pixels // raster.width // samples, raster.pixels % raster.width // samples
    width = raster.width // samples
    return Hits(
        raster.height // samples,
        width,
        rows * width + columns,
        np.full(len(points), 1 / samples**2),
        points,
        normals,
        raster.depth,
        towards,
        np.einsum("pc,pc->p", faces[raster.faces], towards) < 0,
    )


def _planes(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The barycentric coordinates as affine functions of column and row, (m, 3, 3), and which faces have them."""
    x, y = points[..., 0], points[..., 1]
    x1, x2, y1, y2 = np.roll(x, -1, 1), np.roll(x, -2, 1), np.roll(y, -1, 1), np.roll(y, -2, 1)
    twice_area = ((x1 - x) * (y2 - y) - (x2 - x) * (y1 - y))[:, :1]
    valid = np.isfinite(points[..., 2]).all(1) & (np.abs(twice_area[:, 0]) > 1e-12)
    planes = np.stack([y1 - y2, x2 - x1, x1 * y2 - x2 * y1], axis=2)
    return planes / np.where(valid, twice_area[:, 0], 1.0)[:, None, None], valid


def _batches(points: np.ndarray, valid: np.ndarray, height: int, width: int) -> Iterator[np.ndarray]:
    """Faces that may cover a pixel's centre, so many at a time that their bounding boxes have bounded areas."""
    low = np.clip(np.ceil(points[..., :2].min(1) - 0.5), 0, [width, height])
    high = np.clip(np.floor(points[..., :2].max(1) - 0.5) + 1, 0, [width, height])
    area = (high - low).clip(min=0).prod(1)
    candidates = np.flatnonzero(valid & (area > 0))
    total = np.cumsum(area[candidates])
    cuts = np.searchsorted(total, np.arange(_FRAGMENTS_AT_ONCE, total[-1] if len(total) else 0, _FRAGMENTS_AT_ONCE))
    return (part for part in np.split(candidates, cuts) if len(part))


def _fragments(
    points: np.ndarray, planes: np.ndarray, candidates: np.ndarray, height: int, width: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixel, face and nearness wherever one of the candidates covers a pixel's centre."""
    # Edges along the first axis: reducing a short last one takes numpy several times as long.
    y = np.ascontiguousarray(points[candidates, :, 1].T)
    first = np.ceil(y.min(0) - 0.5).clip(0, height).astype(np.int64)
    last = np.floor(y.max(0) - 0.5).clip(-1, height - 1).astype(np.int64)
    owner, row = _ranges(candidates, first, last)
    a, b, c = np.ascontiguousarray(planes[owner].transpose(2, 1, 0))
    offset = b * (row + 0.5) + c
    with np.errstate(divide="ignore", invalid="ignore"):
        bound = -offset / a
    left = np.where(a > 0, bound, -np.inf).max(0)
    right = np.where(a < 0, bound, np.inf).min(0)
    # An edge along the row bounds no column: it has the row on its inner side, or the row is empty.
    empty = ((a == 0) & (offset < 0)).any(0)
    start = np.ceil(left - 0.5 - _OVERLAP).clip(0, width).astype(np.int64)
    stop = np.floor(right - 0.5 + _OVERLAP).clip(-1, width - 1).astype(np.int64)
    spans, column = _ranges(np.arange(len(owner)), start, np.where(empty, start - 1, stop))
    slope = np.einsum("ric,ri->rc", planes[owner], points[owner, :, 2])
    nearness = slope[spans, 0] * (column + 0.5) + (slope[:, 1] * (row + 0.5) + slope[:, 2])[spans]
    return row[spans] * width + column, owner[spans], nearness


def _ranges(items: np.ndarray, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each item repeated for every integer from its first to its last, and those integers."""
    counts = (last - first + 1).clip(min=0)
    ends = np.cumsum(counts)
    within = np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - counts, counts)
    return np.repeat(items, counts), np.repeat(first, counts) + within
