"""A distance read from a table."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.shapes.shape import Samples, Solid


class Tabulated(Solid):
    """A solid whose distance is interpolated linearly between exact values on a grid.

    A look-up costs a thousandth of an exact distance to a large mesh. Where the surface is smooth the error is about
    kappa h^2 / 8 for the grid spacing h; at a crease it is of order h. Beyond the grid the value at its side is used.

    Args:
        solid: The shape; it is evaluated at the grid points only.
        resolution: Grid points along the longest side.
        margin: How far the grid reaches beyond the box of the shape, as a part of its longest side.

    Raises:
        ValueError: If `resolution` is below 2.
    """

    def __init__(self, solid: Solid, *, resolution: int = 64, margin: float = 0.3) -> None:
        if resolution < 2:
            raise ValueError(f"Tabulated(resolution={resolution}): a grid needs at least 2 points a side.")
        self.solid = solid
        self._grid = solid.box.expanded(margin * max(solid.box.size))
        spacing = max(self._grid.size) / (resolution - 1)
        counts = [max(2, round(side / spacing) + 1) for side in self._grid.size]
        axes = [
            torch.linspace(a, b, n, dtype=torch.float64)
            for a, b, n in zip(self._grid.lower, self._grid.upper, counts, strict=True)
        ]
        points = torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1).reshape(-1, self._grid.space)
        # The sampler takes the axes in reverse: the last coordinate of a query runs along the first axis of the table.
        self._table = solid.distance(points).reshape(1, 1, *counts)

    @property
    def box(self) -> Box:
        return self.solid.box

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        return self.solid.sample(n, generator=generator)

    def distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        d = x.shape[1]
        center, size = (torch.tensor(v, dtype=torch.float64) for v in (self._grid.center, self._grid.size))
        unit = (x.double().cpu() - center) / (size / 2)
        query = unit.flip(1).reshape(1, -1, *[1] * (d - 1), d)
        found = F.grid_sample(self._table, query, align_corners=True, padding_mode="border")
        return found.reshape(-1).to(x)
