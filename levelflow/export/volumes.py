"""The values of a field on a grid, as raw volumes that every program can read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from levelflow.boxes import Box
from levelflow.export.snapshots import check_times
from levelflow.fields import Field
from levelflow.shapes.writing import replace_file

_POINTS_AT_ONCE = 1 << 16


@dataclass(frozen=True)
class Grid:
    """Points at equal steps along each axis: lower + spacing (i, j, k).

    Attributes:
        lower: The least corner, in the units of the field.
        spacing: The step, a length.
        counts: The number of points along each axis.
    """

    lower: tuple[float, ...]
    spacing: float
    counts: tuple[int, ...]

    @classmethod
    def over(cls, box: Box, *, resolution: int) -> Grid:
        """The grid with that many cells along the longest side of a box, and with the box in its middle.

        Raises:
            ValueError: If the resolution is below 2.
        """
        if resolution < 2:
            raise ValueError(f"Grid.over(resolution={resolution}): at least 2 cells are needed along the longest side.")
        spacing = max(box.size) / resolution
        cells = [max(1, int(np.ceil(side / spacing - 1e-9))) for side in box.size]
        lower = tuple(middle - spacing * n / 2 for middle, n in zip(box.center, cells, strict=True))
        return cls(lower, spacing, tuple(n + 1 for n in cells))

    def points(self, index: np.ndarray) -> Float[np.ndarray, "n d"]:
        """Positions of grid indices (n, d)."""
        return np.array(self.lower) + self.spacing * index


@dataclass(frozen=True, eq=False)
class Volume:
    """The values of a field on a grid at one time.

    Attributes:
        time: When.
        values: f, as float32; the axes are x, y, z, or x, y.
        grid: Where the points are.
    """

    time: float
    values: np.ndarray
    grid: Grid

    @property
    def is_empty(self) -> bool:
        """Never: a field has values whether or not it has a surface."""
        return False


def volumes(field: Field, times: Sequence[float] = (), *, resolution: int = 128) -> Iterator[Volume]:
    """The values of a field on a grid over its box, one time after another, as they are asked for.

    Args:
        field: A field of space and one time, or a static one, with a box.
        times: The times in increasing order; none for a static field, whose one volume has the time 0.
        resolution: Cells along the longest side of the box.

    Raises:
        ValueError: If the field has no box, or the times are not its own, or not in order.
    """
    times = check_times(field, times, call="volumes")
    if field.box is None:
        raise ValueError("volumes(f): the field has no box of its own, and nothing says where the grid is to be.")
    grid = Grid.over(field.box, resolution=resolution)
    index = np.indices(grid.counts).reshape(len(grid.counts), -1).T
    for t in times:
        values = values_at(field, grid.points(index), t)
        yield Volume(t, values.astype(np.float32).reshape(grid.counts), grid)


def values_at(field: Field, x: Float[np.ndarray, "n d"], t: float) -> Float[np.ndarray, " n"]:
    """f at points (n, d) and one time, in float64."""
    out = np.empty(len(x))
    with torch.no_grad():
        for start in range(0, len(x), _POINTS_AT_ONCE):
            rows = slice(start, start + _POINTS_AT_ONCE)
            points = torch.tensor(x[rows], dtype=torch.float64, device=field.device)
            out[rows] = field(points, points.new_full((len(points), field.times), t)).double().cpu().numpy()
    return out


def write_npz(volume: Volume, path: str | Path) -> None:
    """Writes `values`, `lower`, `spacing` and `time` as numpy arrays; point (i, j, k) is at lower + spacing (i, j, k).

    Raises:
        FileNotFoundError: If the folder does not exist.
    """
    import io

    data = io.BytesIO()
    np.savez(
        data,
        values=volume.values,
        lower=np.array(volume.grid.lower),
        spacing=np.array(volume.grid.spacing),
        time=np.array(volume.time),
    )
    replace_file(Path(path), data.getvalue())


def write_mhd(volume: Volume, path: str | Path) -> None:
    """Writes a MetaImage: a header `wave.mhd` and the float32 values `wave.raw`, x running fastest.

    The header comes last, so that where it is, the values are. The format has no place for the time but a comment.

    Raises:
        FileNotFoundError: If the folder does not exist.

    Reference:
        Kitware, ITK MetaIO documentation.
    """
    path = Path(path)
    raw = path.with_suffix(".raw")
    d = len(volume.grid.counts)
    header = {
        "ObjectType": "Image",
        "NDims": d,
        "Comment": f"written by levelflow, time = {volume.time!r}",
        "BinaryData": True,
        "BinaryDataByteOrderMSB": False,
        "CompressedData": False,
        "TransformMatrix": " ".join(str(int(v)) for v in np.eye(d, dtype=int).reshape(-1)),
        "Offset": " ".join(map(repr, volume.grid.lower)),
        "ElementSpacing": " ".join([repr(volume.grid.spacing)] * d),
        "DimSize": " ".join(map(str, volume.grid.counts)),
        "ElementType": "MET_FLOAT",
        "ElementDataFile": raw.name,
    }
    replace_file(raw, volume.values.astype("<f4").tobytes(order="F"))
    replace_file(path, "".join(f"{key} = {value}\n" for key, value in header.items()).encode())
