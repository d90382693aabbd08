"""Morphs between any number of shapes: over the points of a simplicial complex."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor

from levelflow.boxes import Box
from levelflow.curvature import gradient_norm
from levelflow.equations.equation import Equation
from levelflow.equations.morph import gaps, goal_of
from levelflow.fields import Field
from levelflow.jets import Jet
from levelflow.shapes.shape import Solid

# Barycentric coordinates below this are those of a face: normalised parameters are known to float32.
_ON_FACE = 1e-5


class SimplicialMorph(Equation):
    r"""A surface for every point of a simplicial complex whose vertices are given shapes.

    In a simplex with the vertices $v_0, \dots, v_m$, in the order of their numbers, the surface approaches the last
    shape along the straight line from a point p to $v_m$,

        $D_p f \cdot (v_m - p) = |\nabla f|\,(g_m - f)$,

    which is `Morph` with the part of the way as its time. It starts on the face opposite of $v_m$, where the same holds
    for $v_{m-1}$, and so on down to the edges. Every face is thus the family of its own vertices, and simplices that
    share one fit together. Distances of concentric spheres give the barycentric mean of the radii.

    Args:
        vertices: (j, k) points of the space of parameters.
        shapes: One solid or static field for each vertex.
        simplices: The vertices of each simplex, as numbers from 0: (0, 1, 2) for a triangle. By default all vertices
            are those of one simplex.

    Raises:
        ValueError: If the numbers do not fit together, or a simplex is flat.
        TypeError: If a shape has no distance.

    Reference:
        Novello et al., Neural homotopies (2022), Sec. 8, who name such families; the equation is ours.
    """

    is_speed = True

    def __init__(
        self,
        vertices: Sequence[Sequence[float]] | Float[Tensor, "j k"],
        shapes: Sequence[Solid | Field],
        simplices: Sequence[Sequence[int]] | None = None,
    ) -> None:
        self.vertices = torch.as_tensor(vertices, dtype=torch.float64)
        if self.vertices.ndim != 2 or len(self.vertices) != len(shapes) or len(shapes) < 2:
            raise ValueError(
                f"SimplicialMorph: vertices of the shape {tuple(self.vertices.shape)} and {len(shapes)} shapes; "
                "give two or more points (j, k) and a shape for each."
            )
        self.shapes, self._goals = tuple(shapes), [goal_of(shape, call="SimplicialMorph") for shape in shapes]
        self.simplices = tuple(tuple(sorted(simplex)) for simplex in simplices or (range(len(shapes)),))
        self._inverses = [self._inverse(simplex) for simplex in self.simplices]

    def __repr__(self) -> str:
        return f"SimplicialMorph(of {len(self.shapes)} shapes over {len(self.simplices)} simplices)"

    @property
    def keys(self) -> dict[tuple[float, ...], Solid | Field]:
        """The shapes by their vertices, for `solve(at=...)`."""
        return {tuple(v): shape for v, shape in zip(self.vertices.tolist(), self.shapes, strict=True)}

    def drives(self, k: int) -> set[int]:
        return set(range(k))

    def unit(self, box: Box) -> float:
        return 0.5 / box.frame.scale

    def draw(self, n: int, *, generator: torch.Generator) -> Float[Tensor, "n k"]:
        """Parameters on all simplices and their faces: uniform on a random face of random dimension."""
        simplex = torch.randint(len(self.simplices), (n,), generator=generator)
        weights = torch.zeros(n, len(self.vertices), dtype=torch.float64)
        for i, corners in enumerate(self.simplices):
            mine = simplex == i
            m, k = int(mine.sum()), len(corners)
            taken = torch.randint(2, k + 1, (m, 1), generator=generator) if k > 1 else torch.ones(m, 1)
            rank = torch.rand(m, k, generator=generator).argsort(1).argsort(1)
            share = -torch.log1p(-torch.rand(m, k, generator=generator, dtype=torch.float64)) * (rank < taken)
            rows = torch.zeros(m, len(self.vertices), dtype=torch.float64)
            rows[:, list(corners)] = share / share.sum(1, keepdim=True)
            weights[mine] = rows
        return weights @ self.vertices

    def last(self, p: Float[Tensor, "n k"]) -> Int[Tensor, " n"]:
        """The vertex that the surface approaches at each point: the last of the face that the point lies in."""
        p = p.double().cpu()
        best, found = torch.full((len(p),), -torch.inf, dtype=torch.float64), torch.zeros(len(p), dtype=torch.long)
        for corners, inverse in zip(self.simplices, self._inverses, strict=True):
            weights = torch.cat([p, p.new_ones(len(p), 1)], dim=1) @ inverse.T
            off = torch.linalg.vector_norm(weights @ self.vertices[list(corners)] - p, dim=1)
            inside = weights.amin(1) - off
            numbers = torch.arange(len(corners)).expand(weights.shape)
            last = torch.where(weights > _ON_FACE, numbers, 0).amax(1)
            better = inside > best
            best = torch.where(better, inside, best)
            found = torch.where(better, torch.tensor(corners)[last], found)
        return found

    def residual(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, " n"]:
        rate, gap = self._rate_and_gap(x, t, jet)
        return rate - gap * gradient_norm(jet)

    def error(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, " n"]:
        rate, gap = self._rate_and_gap(x, t, jet)
        return rate / gradient_norm(jet) - gap

    def _rate_and_gap(self, x: Tensor, t: Tensor, jet: Jet) -> tuple[Tensor, Tensor]:
        """The derivative of f on the way to the last vertex, and by how much its shape's value exceeds f."""
        last = self.last(t)
        way = (self.vertices[last].to(t) - t).to(jet.value)
        return (jet.dt * way).sum(1), gaps(self._goals, last, x, jet)

    def _inverse(self, simplex: Sequence[int]) -> Float[Tensor, "m k"]:
        """What takes (p, 1) to barycentric coordinates."""
        if not simplex or min(simplex) < 0 or max(simplex) >= len(self.vertices) or len({*simplex}) < len(simplex):
            raise ValueError(
                f"SimplicialMorph: the simplex {tuple(simplex)} does not name different vertices from 0 to "
                f"{len(self.vertices) - 1}."
            )
        corners = self.vertices[list(simplex)]
        edges = corners[1:] - corners[0]
        if len(edges) and torch.linalg.matrix_rank(edges) < len(edges):
            raise ValueError(
                f"SimplicialMorph: the simplex {tuple(simplex)} is flat: its {len(simplex)} vertices need "
                f"{len(edges)} dimensions of parameters."
            )
        return torch.linalg.pinv(torch.cat([corners, corners.new_ones(len(corners), 1)], dim=1).T)
