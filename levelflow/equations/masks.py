"""Masks: how much a motion counts at each place. Regions with a soft edge, and what was painted on a mesh."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.shapes.reading import read_vertex_properties

Mask = Callable[[Tensor], Tensor]
"""How much a motion counts at points (n, d): numbers (n,), 0 where nothing moves and 1 for the full speed."""

# Cells of the table of a painted mask along its longest side, at most; each soft edge gets four.
_MOST_CELLS, _CELLS_OF_EDGE = 80, 4
_COLOURS = ("red", "green", "blue")


@dataclass(frozen=True)
class BoxMask:
    """One value in an axis-aligned box, another away from it, and a soft edge around the box in between.

    Attributes:
        lower: The least corner, d numbers; -inf for a side that is open.
        upper: The greatest corner; inf for a side that is open.
        soft: The width of the edge, a length.
        inside: The value in the box, all of it.
        outside: The value further than `soft` from the box.

    Raises:
        ValueError: If the corners are not in order, or `soft` is not positive.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    soft: float
    inside: float = 1.0
    outside: float = 0.0

    def __post_init__(self) -> None:
        if len(self.lower) != len(self.upper) or not all(a < b for a, b in zip(self.lower, self.upper, strict=True)):
            raise ValueError(f"{self!r}: the lower corner is not below the upper one; give d numbers for each.")
        _check_values(self, self.soft, self.inside, self.outside)

    def __call__(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        _check_space(self, len(self.lower), x)
        beyond = (x.new_tensor(self.lower) - x).clamp_min(0) + (x - x.new_tensor(self.upper)).clamp_min(0)
        return _edge((beyond * beyond).sum(1) / self.soft**2, self.inside, self.outside)


@dataclass(frozen=True)
class SphereMask:
    """One value in a ball, in the plane a disk, another away from it, and a soft edge around it in between.

    Attributes:
        center: d numbers.
        radius: A length.
        soft: The width of the edge, a length.
        inside: The value in the ball, all of it.
        outside: The value further than `soft` from the ball.

    Raises:
        ValueError: If the centre is not finite, or `radius` or `soft` is not positive.
    """

    center: tuple[float, ...]
    radius: float
    soft: float
    inside: float = 1.0
    outside: float = 0.0

    def __post_init__(self) -> None:
        if not (all(map(math.isfinite, self.center)) and 0 < self.radius < math.inf):
            raise ValueError(f"{self!r}: give a finite centre and a positive radius.")
        _check_values(self, self.soft, self.inside, self.outside)

    def __call__(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        _check_space(self, len(self.center), x)
        square = ((x - x.new_tensor(self.center)) ** 2).sum(1)
        beyond = square.clamp_min(self.radius**2).sqrt() - self.radius
        return _edge((beyond / self.soft) ** 2, self.inside, self.outside)


@dataclass(frozen=True)
class ProductOfMasks:
    """m1 m2 ...: what one of them fixes is fixed."""

    masks: tuple[Mask, ...]

    def __call__(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return torch.stack([mask(x) for mask in self.masks]).prod(0)


@dataclass(frozen=True, eq=False)
class PaintedMask:
    """What was painted on a mesh: near it the value of the nearest vertices, from a table with a smooth interpolation.

    Between nodes the table is a cubic B-spline, whose values stay between those of the nodes and whose second
    derivatives are continuous. Beyond the table the value at its side is used.

    Attributes:
        table: Values at the nodes of a grid, one axis for each coordinate.
        box: From the first node to the last.
        name: What messages call it, such as the file that it was read from.
    """

    table: Float[Tensor, ...]
    box: Box
    name: str = ""

    def __repr__(self) -> str:
        return f"PaintedMask({self.name!r})"

    @classmethod
    def read(cls, path: str | Path, *, soft: float | None = None, by: str | None = None) -> PaintedMask:
        """The mask that a file holds; see `painted_vertices` and `of`."""
        points, values = painted_vertices(path, by=by)
        return cls.of(points, values, soft=soft, name=Path(path).name)

    @classmethod
    def of(
        cls,
        points: Float[np.ndarray, "n d"],
        values: Float[np.ndarray, " n"],
        *,
        soft: float | None = None,
        name: str = "",
    ) -> PaintedMask:
        """The mask with given values at given points.

        What is painted black, or darker than its surroundings, keeps its value up to its border; the edge lies on the
        lighter side of it.

        Args:
            points: Positions, in the units of the shape whose motion is masked.
            values: From 0, where nothing moves, to 1.
            soft: The width of the edge between values, a length; by default a twentieth of the longest side of the box
                around the points.
            name: What messages call it.

        Raises:
            ValueError: If there are no points, a number is not finite, a value is not from 0 to 1, or `soft` is not
                positive.
        """
        from scipy.ndimage import distance_transform_edt
        from scipy.spatial import cKDTree

        call = f"PaintedMask.of({name or 'points, values'})"
        if not len(points) or len(points) != len(values):
            raise ValueError(f"{call}: {len(points)} points with {len(values)} values; give one for each of several.")
        if not (np.isfinite(points).all() and np.isfinite(values).all()):
            wrong = int((~(np.isfinite(points).all(1) & np.isfinite(values))).sum())
            raise ValueError(f"{call}: {wrong} of {len(points)} vertices have a position or value that is not finite.")
        if values.min() < 0 or values.max() > 1:
            raise ValueError(
                f"{call}: the values go from {values.min():g} to {values.max():g}; a mask is 0 where nothing moves and "
                "1 for the full speed."
            )
        size = float(np.ptp(points, axis=0).max()) or 1.0
        soft = size / 20 if soft is None else soft
        if not 0 < soft < math.inf:
            raise ValueError(f"{call}: soft={soft:g}; give the positive width of the edge between values.")
        centers, least = _least(points, values, soft)
        spacing = max(soft / _CELLS_OF_EDGE, size / _MOST_CELLS)
        lower = points.min(0) - 2 * spacing
        counts = np.ceil((points.max(0) + 2 * spacing - lower) / spacing - 1e-9).astype(int) + 1
        nodes = lower + spacing * np.indices(counts).reshape(len(counts), -1).T
        # Exact near the paint; further away as at the next node that is near it, which costs little.
        distance, near = cKDTree(centers).query(nodes, distance_upper_bound=4 * spacing)
        far = np.isinf(distance).reshape(counts)
        table = np.append(least, 0.0)[near].reshape(counts)
        table = table[tuple(distance_transform_edt(far, return_distances=False, return_indices=True))]
        corner = lower + spacing * (counts - 1)
        return cls(torch.tensor(table, dtype=torch.float32), Box(tuple(lower), tuple(corner)), name)

    def __call__(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        d = self.box.space
        _check_space(self, d, x)
        table = self.table.to(x)
        last = x.new_tensor(table.shape) - 1
        cell = (x - x.new_tensor(self.box.lower)) / x.new_tensor(self.box.size) * last
        cell = torch.minimum(cell.clamp_min(0), last)
        first = torch.minimum(cell.detach().floor(), last - 1)
        s = cell - first
        weights = torch.stack(
            [(1 - s) ** 3, 3 * s**3 - 6 * s**2 + 4, 3 * (1 - s) ** 3 - 6 * (1 - s) ** 2 + 4, s**3], dim=2
        )
        found = table.reshape(-1)[self._around(first.long())].reshape(-1, *[4] * d)
        for axis in range(d):
            found = (found * (weights[:, axis] / 6).reshape(-1, 4, *[1] * (d - 1 - axis))).sum(1)
        return found

    def _around(self, first: Tensor) -> Tensor:
        """The numbers of the 4^d nodes around cells, (n, 4^d); those beyond the table are its last."""
        number = first.new_zeros(len(first), 1)
        for axis, count in enumerate(self.table.shape):
            nodes = (first[:, axis, None] + torch.arange(-1, 3, device=first.device)).clamp(0, count - 1)
            number = (number[:, :, None] * count + nodes[:, None]).reshape(len(first), -1)
        return number


def painted_vertices(
    path: str | Path, *, by: str | None = None
) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, " n"]]:
    """The positions of the vertices in a file and what is painted on them, from 0 (black) to 1 (white).

    Args:
        path: A PLY file, whose vertices have the colours red, green and blue, of which the mean is taken, or another
            property; or another mesh with colours (OBJ, GLB).
        by: The property of the vertices of a PLY file that is meant, if it is not their colour.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no mesh, or nothing is painted on it.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"painted_vertices: there is no file {str(path)!r} (looked in {Path.cwd()}).")
    if path.suffix.lower() != ".ply":
        if by is not None:
            raise ValueError(
                f"painted_vertices({path.name!r}, by={by!r}): only the vertices of a PLY file have properties."
            )
        return _coloured(path)
    points, properties = read_vertex_properties(path, call="painted_vertices")
    if by is not None and by not in properties:
        raise ValueError(
            f"painted_vertices({path.name!r}, by={by!r}): its vertices have no such property, only "
            f"{', '.join(properties) or 'positions'}."
        )
    if by is not None:
        return points, properties[by].astype(np.float64)
    if not all(colour in properties for colour in _COLOURS):
        name = next(iter(properties), "")
        others = f", only {', '.join(properties)}; one of these is the mask by={name!r} (--mask-by {name})"
        raise ValueError(
            f"painted_vertices: the vertices of {path.name!r} have no colours{others if name else ''}. "
            "Paint on them, black where nothing is to move, and export the colours of the vertices."
        )
    return points, _grey(np.stack([properties[colour] for colour in _COLOURS], axis=1))


def _coloured(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The vertices of a mesh and their colours."""
    import trimesh

    try:
        mesh = trimesh.load_scene(path, process=False).to_mesh()
        points = np.asarray(mesh.vertices, dtype=np.float64)
        kind = mesh.visual.kind
        colours = np.asarray(mesh.visual.vertex_colors) if kind in ("vertex", "face") else None
    except Exception as error:
        raise ValueError(f"painted_vertices: {path.name!r} is not a mesh that can be read: {error}.") from None
    if colours is None:
        raise ValueError(f"painted_vertices: the vertices of {path.name!r} have no colours; PLY files can hold them.")
    return points, _grey(colours[:, :3])


def _grey(colours: np.ndarray) -> Float[np.ndarray, " n"]:
    """The mean of the channels, 1 for white."""
    if colours.dtype.kind in "ui":
        white = float(np.iinfo(colours.dtype).max)
    else:
        white = 255.0 if len(colours) and colours.max() > 1 else 1.0
    return colours.astype(np.float64).mean(1) / white


def _least(
    points: Float[np.ndarray, "n d"], values: Float[np.ndarray, " n"], soft: float
) -> tuple[Float[np.ndarray, "m d"], Float[np.ndarray, " m"]]:
    """The middles of the points in small cells, and the least value within half an edge of each.

    The spline of the table is about an edge wide: what is darker keeps its value up to its border.
    """
    from scipy.spatial import cKDTree

    cells = np.floor((points - points.min(0)) / (soft / _CELLS_OF_EDGE)).astype(np.int64)
    _, cell, number = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    cell = cell.reshape(-1)
    centers = np.stack([np.bincount(cell, column) for column in points.T], axis=1) / number[:, None]
    least = np.full(len(centers), np.inf)
    np.minimum.at(least, cell, values)
    tree = cKDTree(centers)
    pairs = tree.sparse_distance_matrix(tree, soft / 2, output_type="ndarray")
    around = least.copy()
    np.minimum.at(around, pairs["i"], least[pairs["j"]])
    return centers, around


def _edge(square: Float[Tensor, " n"], inside: float, outside: float) -> Float[Tensor, " n"]:
    """From one value to the other, by the squared distance in widths of the edge; smooth at both ends."""
    s = square.clamp_max(1)
    return inside + (outside - inside) * s * s * (3 - 2 * s)


def _check_values(mask: object, soft: float, inside: float, outside: float) -> None:
    if not 0 < soft < math.inf:
        raise ValueError(f"{mask!r}: soft must be positive, the width of the edge; a network cannot follow a jump.")
    if not (math.isfinite(inside) and math.isfinite(outside)):
        raise ValueError(f"{mask!r}: the values inside and outside must be finite, such as 0 and 1.")


def _check_space(mask: object, d: int, x: Tensor) -> None:
    if x.shape[1] != d:
        raise ValueError(f"{mask!r}: the mask has {d} coordinates, the points have {x.shape[1]}.")
