"""What a given shape or field asks of a field at one time: samples with values and normals, as terms of a loss."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.fields import Field
from levelflow.minimising import Batch
from levelflow.shapes.implicit import Implicit, value_of
from levelflow.shapes.shape import Shape, Solid

Key = Shape | Field
"""What can be given at a time."""

BAND = 0.25
"""How far from the surface a distance is asked for, in normalised units. Farther out only the sign and this bound are,
so that no network capacity goes into the kinks of a distance on the medial axis."""

NARROW = 0.03
"""The band for motions by curvature forwards in time. They do the same to every field with the given zero set, and a
kink on the medial axis is gone at once: its value moves like the root of the time, which no network follows."""

MARGIN = 0.125
"""How far a box reaches beyond what is in it, as a part of its longest side: the surface then fills [-0.8, 0.8]."""


@dataclass(frozen=True)
class Sampling:
    """How many samples a training step draws, and of which kinds.

    Attributes:
        n: Samples in a step.
        space_time: The share drawn in space-time, for the equation; where there is none, as in `fit`, the others get
            it.
        surface: The share drawn on the given surfaces.
        volume: The share drawn off the given surfaces.
        given: Points prepared of each kind for every given shape, from which steps draw.

    Raises:
        ValueError: If a number is not positive, or a share is negative or all are zero.

    Reference:
        Novello et al., Neural Implicit Surface Evolution, ICCV 2023, Sec. 4.2 (50, 25 and 25 %).
    """

    n: int = 4096
    space_time: float = 0.5
    surface: float = 0.25
    volume: float = 0.25
    given: int = 100_000

    def __post_init__(self) -> None:
        shares = (self.space_time, self.surface, self.volume)
        if self.n < 4 or self.given < 4 or min(shares) < 0 or not sum(shares) > 0:
            raise ValueError(f"{self!r}: the numbers must be at least 4, and the shares non-negative and not all zero.")

    def counts(self) -> tuple[int, int, int]:
        """How many samples are drawn in space-time, on and off the given surfaces; at least one of each."""
        shares = (self.space_time, self.surface, self.volume)
        first, second, third = (max(1, round(self.n * share / sum(shares))) for share in shares)
        return first, second, third

    def shared_out(self) -> tuple[int, int]:
        """How many are drawn on and off the given surfaces where there is no equation: all of them."""
        _, on, off = self.counts()
        return round(self.n * on / (on + off)), round(self.n * off / (on + off))


@dataclass(frozen=True)
class Given:
    """Samples of a shape in normalised coordinates, drawn once, and its values.

    Attributes:
        points: On the surface, (m, d).
        normals: The outward unit normals there.
        near: Points near the surface, two thirds of them within about 0.02 and the rest within 0.1, (n, d).
        near_values: The distance (or the value of a given field) there, in normalised units, (n,).
        far: Points of the whole box, (l, d).
        far_values: The same there, (l,).
        value: The distance or value in the units of the shape, for points in its units.
    """

    points: Float[Tensor, "m d"]
    normals: Float[Tensor, "m d"]
    near: Float[Tensor, "n d"]
    near_values: Float[Tensor, " n"]
    far: Float[Tensor, "l d"]
    far_values: Float[Tensor, " l"]
    value: Callable[[Tensor], Tensor]

    @classmethod
    def of(
        cls,
        key: Key,
        box: Box,
        *,
        n: int,
        generator: torch.Generator,
        like: Tensor,
        periodic: Sequence[int] = (),
    ) -> Given:
        """Draws n surface samples and n values; samples have the dtype and device of `like`.

        For a shape without a distance, such as a point cloud, values are estimated from the surface samples. Along the
        axes that are `periodic` all repeats itself with the box: points beyond have the values of those within.
        """
        frame = box.frame
        surface = surface_of(key)
        drawn = surface.sample(n, generator=generator)
        if isinstance(key, Solid | Field):
            value = value_of(key)
        else:
            value = _estimated_distance(drawn.points, drawn.normals)
        if periodic:
            value = _repeated(value, box, periodic)
        points = frame.to_unit(drawn.points)
        spread = points.new_full((3 * n // 4, 1), 0.02)
        spread[n // 2 :] = 0.1
        near = points[: len(spread)] + spread * torch.randn(
            len(spread), box.space, generator=generator, dtype=points.dtype
        )
        if periodic:
            near = frame.to_unit(box.wrapped(frame.from_unit(near), periodic))
        near = near[box.contains(frame.from_unit(near))]
        if not len(near):
            raise ValueError(
                f"the box from {box.lower} to {box.upper} does not contain the given surface, which lies between "
                f"{surface.box.lower} and {surface.box.upper}; give a larger box, or leave it out."
            )
        far = frame.to_unit(box.uniform(n // 4, generator=generator))
        with torch.no_grad():
            near_values = value(frame.from_unit(near)) / frame.scale
            far_values = value(frame.from_unit(far)) / frame.scale
        return cls(
            points.to(like),
            drawn.normals.to(like),
            near.to(like),
            near_values.to(like),
            far.to(like),
            far_values.to(like),
            value,
        )

    def where(self, holds: Callable[[Tensor], Tensor], box: Box) -> Given:
        """The samples at whose points, in the units of the box, something holds."""

        def kept(u: Tensor) -> Tensor:
            return holds(box.frame.from_unit(u.double())).to(u.device)

        on, near, far = kept(self.points), kept(self.near), kept(self.far)
        return Given(
            self.points[on],
            self.normals[on],
            self.near[near],
            self.near_values[near],
            self.far[far],
            self.far_values[far],
            self.value,
        )


class OnSurface:
    r"""On the given surface f = 0 and grad f = n: $f^2 + w\,|\nabla f - n|^2$."""

    name = "surface"
    weight = 1.0

    def __init__(self, field: Field, given: Given, times: tuple[float, ...], *, n: int, normal: float = 0.01) -> None:
        self.field, self.given, self.times, self.n, self.normal = field, given, times, n, normal

    def sample(self, generator: torch.Generator) -> Batch:
        x, normals = pick(self.n, self.given.points, self.given.normals, generator=generator)
        return x, normals, _during(self.times, x, generator)

    def loss(self, *batch: Tensor) -> Tensor:
        x, normals, t = batch
        jet = self.field.jet(x, t, order=1)
        return jet.value**2 + self.normal * ((jet.gradient - normals) ** 2).sum(1)


class OffSurface:
    """Off the surface f = d within the band, and beyond it the right sign and a least size (`band_error`)."""

    name = "distance"
    weight = 1.0

    def __init__(self, field: Field, given: Given, times: tuple[float, ...], *, n: int, band: float = BAND) -> None:
        self.field, self.given, self.times, self.n, self.band = field, given, times, n, band

    def sample(self, generator: torch.Generator) -> Batch:
        far = self.n // 4
        x, values = pick(self.n - far, self.given.near, self.given.near_values, generator=generator)
        if far:
            rest = pick(far, self.given.far, self.given.far_values, generator=generator)
            x, values = torch.cat([x, rest[0]]), torch.cat([values, rest[1]])
        return x, values, _during(self.times, x, generator)

    def loss(self, *batch: Tensor) -> Tensor:
        x, values, t = batch
        return band_error(self.field(x, t), values, self.band) ** 2


def _during(times: tuple[float, ...], x: Float[Tensor, "n d"], generator: torch.Generator) -> Float[Tensor, "n k"]:
    """The normalised times for samples, drawn from [-1, 1] where they are free, which is NaN."""
    t = x.new_tensor(times).expand(len(x), -1)
    if not t.isnan().any():
        return t
    drawn = 2 * torch.rand(t.shape, generator=generator, dtype=t.dtype) - 1
    return torch.where(t.isnan(), drawn.to(t.device), t)


def band_error(f: Float[Tensor, " n"], values: Float[Tensor, " n"], band: float = BAND) -> Float[Tensor, " n"]:
    """f - d within the band; beyond it, by how much |f| falls short, on the right side, of the band and of |d| / 2."""
    side, size = values.sign(), values.abs()
    least = (size / 2).clamp(band, BAND)
    return torch.where(size > band, (least - f * side).clamp_min(0), f - values)


def pick(n: int, *tensors: Tensor, generator: torch.Generator) -> Batch:
    """The same n random rows of each tensor."""
    i = torch.randint(len(tensors[0]), (n,), generator=generator).to(tensors[0].device)
    return tuple(tensor[i] for tensor in tensors)


def surface_of(key: Key) -> Shape:
    """The surface that a shape is or a field stands for.

    Raises:
        TypeError: If it is neither.
    """
    if isinstance(key, Field):
        return Implicit(key)
    if isinstance(key, Shape):
        return key
    raise TypeError(
        f"{key!r} is neither a shape nor a field. Read a mesh with Mesh.read(path), or fit a field to a shape first."
    )


def box_around(boxes: Iterable[Box]) -> Box:
    """The box that a field for surfaces in the given boxes needs."""
    first, *others = boxes
    union = first.union(*others)
    return union.expanded(MARGIN * max(union.size))


def _repeated(value: Callable[[Tensor], Tensor], box: Box, axes: Sequence[int]) -> Callable[[Tensor], Tensor]:
    """Values that are known in a box, repeated with it along some axes."""
    return lambda x: value(box.wrapped(x, axes))


def _estimated_distance(
    points: Float[Tensor, "n d"], normals: Float[Tensor, "n d"], *, neighbors: int = 8
) -> Callable[[Tensor], Tensor]:
    """The signed distance as far as samples with normals tell it.

    Near the samples it is the mean height over the tangent planes of the nearest ones, farther away the distance to the
    nearest, with the sign of that height.

    Reference:
        Kolluri, Provably good moving least squares, ACM Trans. Algorithms 4 (2008).
    """
    from scipy.spatial import cKDTree

    # Points drawn with replacement repeat, and copies of one point are no neighbours of it.
    p, first = np.unique(points.cpu().numpy(), axis=0, return_index=True)
    normal = normals.cpu().numpy()[first]
    tree = cKDTree(p)
    spacing = float(np.median(tree.query(p, k=2)[0][:, 1])) if len(p) > 1 else 0.0

    def value(x: Tensor) -> Tensor:
        query = x.detach().double().cpu().numpy()
        distance, index = tree.query(query, k=min(neighbors, len(p)))
        heights = np.einsum("nkd,nkd->nk", query[:, None] - p[index], normal[index])
        weights = 1 / (distance**2 + 1e-3 * spacing**2 + 1e-300)
        height = (weights * heights).sum(1) / weights.sum(1)
        size = np.where(distance[:, 0] > 3 * spacing, distance[:, 0], np.abs(height))
        return torch.from_numpy(np.sign(height) * size).to(x)

    return value
