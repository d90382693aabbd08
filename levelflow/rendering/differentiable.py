"""Pictures of meshes that can be differentiated, by every vertex: what moves a silhouette changes the picture."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from levelflow.rendering.camera import Camera
from levelflow.rendering.rasterising import rasterise
from levelflow.shapes.mesh import Mesh

# Vertices nearer to a pinhole than this, or behind it, bound no silhouette; their faces are not seen either.
_NEAREST = 1e-9


def differentiable_image(
    vertices: Float[Tensor, "n 3"],
    faces: Int[Tensor, "m 3"],
    colours: Float[Tensor, "n c"],
    camera: Camera,
    *,
    height: int,
    width: int,
    background: Float[Tensor, " c"] | float = 0.0,
) -> Float[Tensor, "h w c"]:
    r"""A picture of triangles whose derivatives in the vertices and the colours are those of what it shows.

    Which triangle is seen at the centre of a pixel is found without derivatives; colours are interpolated there with
    them, corrected for perspective. A silhouette is antialiased: where it cuts the line between the centres of two
    neighbouring pixels at the share $a$ of the way from the near to the far side, the far pixel takes $a - 1/2$ of the
    near colour, or the near pixel $1/2 - a$ of the far one. So the picture is continuous as an edge moves across
    centres of pixels, and its sum changes by the area that the edge sweeps. An edge that is nearer to upright cuts
    lines along rows only, and the others lines along columns only: with both, its motion would count twice.

    The derivative at one instant depends a little on where edges lie within their pixels: a long edge along the rows or
    columns of a shaded surface shows it most. It averages out over a motion, and with resolution.

    Parts thinner than a pixel that cover no centre are not seen and have no derivative; nor has the hiding of a
    silhouette behind another, or the motion of an intersection of triangles.

    Args:
        vertices: Positions; where the derivative is wanted, with `requires_grad`.
        faces: Triangles.
        colours: What is seen at each vertex: colours, normals from `vertex_normals`, or any other numbers.
        camera: From where.
        height: Rows of the picture.
        width: Columns.
        background: Where there is no surface.

    Returns:
        The picture, with the dtype and the device of the vertices.

    Raises:
        ValueError: If a size is not positive, or there is not one colour for each vertex.

    Reference:
        Laine et al., Modular Primitives for High-Performance Differentiable Rendering, ACM TOG 39 (2020), Sec. 3.4.
    """
    if height < 1 or width < 1:
        raise ValueError(f"differentiable_image(height={height}, width={width}): a picture has at least one pixel.")
    if len(colours) != len(vertices):
        raise ValueError(
            f"differentiable_image: {len(colours)} colours for {len(vertices)} vertices; give one for each."
        )
    fixed = Mesh(vertices.detach().double().cpu().numpy(), faces.cpu().numpy())
    raster = rasterise(fixed, camera, height=height, width=width)
    points = _projected(vertices, camera, height, width)
    pixels = torch.from_numpy(raster.pixels).to(vertices.device)
    corners = faces[torch.from_numpy(raster.faces).to(faces.device)]
    seen = _interpolated(points[corners], colours[corners], pixels, width, perspective=not camera.orthographic)
    bare = torch.as_tensor(background, dtype=vertices.dtype, device=vertices.device).expand(colours.shape[1])
    picture = bare.expand(height * width, -1).index_put((pixels,), seen)

    edges = _silhouettes(fixed, camera)
    depth = raster.place(raster.depth, background=np.inf)
    flat = points.detach().double().cpu().numpy()
    change = torch.zeros_like(picture)
    for axis in (0, 1):
        cuts = _cuts(flat, fixed, edges, camera, depth, axis)
        if len(cuts[0]):
            change = change + _blended(points, colours, picture, camera, width, axis, *cuts)
    return (picture + change).reshape(height, width, -1)


def vertex_normals(vertices: Float[Tensor, "n 3"], faces: Int[Tensor, "m 3"]) -> Float[Tensor, "n 3"]:
    """Unit normals at the vertices, the mean over the faces weighted by their areas, differentiable in the vertices."""
    a, b, c = vertices[faces].unbind(1)
    areas = torch.linalg.cross(b - a, c - a)
    sums = torch.zeros_like(vertices).index_add(0, faces.T.reshape(-1), areas.repeat(3, 1))
    return torch.nn.functional.normalize(sums, dim=1, eps=1e-30)


def _projected(vertices: Tensor, camera: Camera, height: int, width: int) -> Tensor:
    """`Camera.project` with derivatives."""
    axes = vertices.new_tensor(camera.axes)
    x, y, back = ((vertices - vertices.new_tensor(camera.eye)) @ axes.T).unbind(1)
    scale = torch.ones_like(back) if camera.orthographic else -1 / back.clamp(max=-_NEAREST)
    scale = scale / camera.footprint(height=height, width=width)
    nearness = back if camera.orthographic else -1 / back.clamp(max=-_NEAREST)
    return torch.stack([width / 2 + scale * x, height / 2 - scale * y, nearness], dim=1)


def _interpolated(corners: Tensor, colours: Tensor, pixels: Tensor, width: int, *, perspective: bool) -> Tensor:
    """Colours (p, c) at the centres of pixels, of triangles with projected corners (p, 3, 3) and colours (p, 3, c)."""
    centres = torch.stack([pixels % width + 0.5, pixels // width + 0.5], dim=1).to(corners)
    a, b, c = (corners[:, i, :2] - centres for i in range(3))
    weights = torch.stack([_cross(b, c), _cross(c, a), _cross(a, b)], dim=1)
    if perspective:
        weights = weights * corners[..., 2]
    return ((weights / weights.sum(1, keepdim=True))[..., None] * colours).sum(1)


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _silhouettes(mesh: Mesh, camera: Camera) -> np.ndarray:
    """Edges that part a face turned to the eye from one turned away, or have one face: (e, 3), its third corner last.

    The third corner is that of a face that is seen there; it tells on which side of the edge the surface lies.
    """
    normals = np.cross(*(mesh.vertices[mesh.faces[:, k]] - mesh.vertices[mesh.faces[:, 0]] for k in (1, 2)))
    middle = mesh.vertices[mesh.faces].mean(1)
    towards = camera.axes[2] if camera.orthographic else np.array(camera.eye) - middle
    front = (normals * towards).sum(1) > 0
    corners = np.concatenate([mesh.faces[:, [0, 1, 2]], mesh.faces[:, [1, 2, 0]], mesh.faces[:, [2, 0, 1]]])
    facing = np.tile(front, 3)
    low, high = corners[:, :2].min(1), corners[:, :2].max(1)
    _, edge, count = np.unique(low * len(mesh.vertices) + high, return_inverse=True, return_counts=True)
    fronts = np.bincount(edge, facing)
    outline = (count == 1) | ((fronts > 0) & (fronts < count))
    # One face of each: one that is turned to the eye if there is one.
    chosen = np.full(len(count), -1)
    chosen[edge[::-1]] = np.arange(len(edge))[::-1]
    chosen[edge[facing]] = np.flatnonzero(facing)
    return corners[chosen[outline]]


def _cuts(
    points: np.ndarray, mesh: Mesh, edges: np.ndarray, camera: Camera, depth: np.ndarray, axis: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where visible silhouettes cut the lines between neighbouring centres, along rows (axis 0) or columns (axis 1).

    Returns:
        The edges, as pairs of vertices (k, 2); the near pixels (k,) and the far ones.
    """
    # With rows and columns exchanged the second case is the first.
    across, along = (0, 1) if axis == 0 else (1, 0)
    z = depth if axis == 0 else depth.T
    height, width = z.shape
    a, b, third = (points[edges[:, k]] for k in range(3))
    steep = np.abs(b[:, along] - a[:, along]) > np.abs(b[:, across] - a[:, across])
    steep |= (np.abs(b[:, along] - a[:, along]) == np.abs(b[:, across] - a[:, across])) & (axis == 0)
    if not camera.orthographic:
        steep &= np.maximum(a[:, 2], b[:, 2]) < 1 / _NEAREST
    index = np.flatnonzero(steep)
    a, b, third = a[index], b[index], third[index]
    low, high = np.minimum(a[:, along], b[:, along]), np.maximum(a[:, along], b[:, along])
    first = np.ceil(low - 0.5).clip(0, height).astype(np.int64)
    count = (np.ceil(high - 0.5).clip(0, height).astype(np.int64) - first).clip(min=0)
    owner = np.repeat(np.arange(len(index)), count)
    row = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count - first, count)
    a, b, third = a[owner], b[owner], third[owner]
    share = (row + 0.5 - a[:, along]) / (b[:, along] - a[:, along])
    cut = a[:, across] + share * (b[:, across] - a[:, across])
    line = a[:, across] + (third[:, along] - a[:, along]) / (b[:, along] - a[:, along]) * (b[:, across] - a[:, across])
    surface_is_before = third[:, across] < line
    left = np.floor(cut - 0.5).astype(np.int64)
    inside = (left >= 0) & (left < width - 1)
    left, row, owner, share, cut, before = (
        values[inside] for values in (left, row, owner, share, cut, surface_is_before)
    )
    near, far = np.where(before, left, left + 1), np.where(before, left + 1, left)
    own = camera.depth(a[inside, 2] + share * (b[inside, 2] - a[inside, 2]))
    # The surface is seen on its side, and on the other something farther than the edge.
    seen = (z[row, near] < z[row, far]) & (own < z[row, far])
    owner, row, near, far, own, cut = (values[seen] for values in (owner, row, near, far, own, cut))
    # Of several cuts of one line the outermost is the outline.
    out = np.where(far > near, cut, -cut)
    order = np.lexsort((-out, far, near, row))
    key = np.stack([row, near, far], axis=1)[order]
    kept = order[np.append(True, (key[1:] != key[:-1]).any(1))] if len(order) else order
    row, near, far = row[kept], near[kept], far[kept]
    pairs = edges[index[owner[kept]], :2]
    if axis == 0:
        return pairs, row * width + near, row * width + far
    return pairs, near * height + row, far * height + row


def _blended(
    points: Tensor,
    colours: Tensor,
    picture: Tensor,
    camera: Camera,
    width: int,
    axis: int,
    pairs: np.ndarray,
    near: np.ndarray,
    far: np.ndarray,
) -> Tensor:
    """What antialiasing adds to the picture (h * w, c) where edges cut the lines between near and far pixels."""
    across, along = (0, 1) if axis == 0 else (1, 0)
    ends = torch.from_numpy(pairs).to(points.device)
    a, b = points[ends].unbind(1)
    one, other = (torch.from_numpy(pixels).to(points.device) for pixels in (near, far))
    centre = [one % width + 0.5, one // width + 0.5]
    share = (centre[along] - a[:, along]) / (b[:, along] - a[:, along])
    cut = a[:, across] + share * (b[:, across] - a[:, across])
    step = (other % width - one % width) if axis == 0 else (other // width - one // width)
    reach = (((cut - centre[across]) * step).clamp(0, 1) - 0.5)[:, None]
    if not camera.orthographic:
        share = share * b[:, 2] / ((1 - share) * a[:, 2] + share * b[:, 2])
    at_cut = torch.lerp(colours[ends[:, 0]], colours[ends[:, 1]], share[:, None])
    # Beyond the middle the far pixel takes of the edge's colour; before it, the near pixel of the far one.
    change = reach * (torch.where(reach > 0, at_cut, picture[one]) - picture[other])
    return torch.zeros_like(picture).index_add(0, torch.where(reach[:, 0] > 0, other, one), change)
