"""How far surfaces are from each other, and how well a field satisfies what was asked of it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.fields import Field
from levelflow.jets import Jet
from levelflow.shapes.cloud import PointCloud
from levelflow.shapes.implicit import Implicit, NoSurface
from levelflow.shapes.mesh import Mesh
from levelflow.shapes.shape import Shape, Solid

Points = Float[np.ndarray, "_ _"] | Float[Tensor, "_ _"]


@runtime_checkable
class Condition(Protocol):
    """What is asked of the jets of a field, as an equation does."""

    @property
    def order(self) -> int: ...

    def residual(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Tensor: ...


class Spread(NamedTuple):
    """The mean and the greatest of some absolute values."""

    mean: float
    max: float

    @classmethod
    def of(cls, values: Tensor) -> Spread:
        """Of the absolute values of (n,) numbers."""
        values = values.detach().abs()
        return cls(float(values.mean()), float(values.max()))


@dataclass(frozen=True)
class SurfaceDistance:
    """Distances between two surfaces a and b, in their units.

    Attributes:
        there: The distances from points of a to the nearest point of b.
        back: The distances from points of b to the nearest point of a.
    """

    there: Spread
    back: Spread

    @property
    def chamfer(self) -> float:
        """The mean of the two mean distances."""
        return (self.there.mean + self.back.mean) / 2

    @property
    def hausdorff(self) -> float:
        """The greater of the two greatest distances."""
        return max(self.there.max, self.back.max)

    def __str__(self) -> str:
        return (
            f"chamfer {self.chamfer:.4g}, Hausdorff {self.hausdorff:.4g} "
            f"(there: mean {self.there.mean:.4g}, max {self.there.max:.4g}; "
            f"back: mean {self.back.mean:.4g}, max {self.back.max:.4g})"
        )


def surface_distance(
    a: Shape | Field | Points, b: Shape | Field | Points, *, n: int = 30_000, generator: torch.Generator
) -> SurfaceDistance:
    """The distances from n points of each of two surfaces, drawn uniformly by area, to the other surface.

    The nearest point is exact: on the triangles of a mesh, by the formula of a solid, the nearest of a set of points.
    To the zero set of a field it is |f| / |grad f|, correct to first order.
    The vertices of a mesh are added to its points for the greatest distance, which is a lower bound: no sample finds
    the very farthest point.

    Args:
        a: A mesh, a solid, a static field, a point cloud or points (m, d); points are taken as they are.
        b: The same.
        n: How many points are drawn from each surface.
        generator: The source of randomness.

    Raises:
        TypeError: If one of them is a shape without a distance.
        ValueError: If one lies in the plane and the other in space.
    """
    a, b = (Implicit(surface) if isinstance(surface, Field) else surface for surface in (a, b))
    points, others = _drawn(a, n, generator), _drawn(b, n, generator)
    if points.shape[1] != others.shape[1]:
        raise ValueError(
            f"surface_distance(a, b): a lies in R^{points.shape[1]} and b in R^{others.shape[1]}; "
            "give two surfaces of the same space."
        )
    return SurfaceDistance(_towards(b, points, a), _towards(a, others, b))


def accuracy(field: Field, shape: Shape, *, seed: int, n: int = 10_000) -> dict[str, float] | None:
    """The mean and greatest distance between the surface of a static field and a shape, both ways; for reports.

    None, with a warning, if the field has no surface in its box: too little training, or a shape that has vanished.
    """
    try:
        distance = surface_distance(shape, Implicit(field), n=n, generator=torch.Generator().manual_seed(seed))
    except NoSurface as error:
        warnings.warn(f"{error} Its accuracy is unknown.", stacklevel=2)
        return None
    return {"mean": distance.chamfer, "max": distance.hausdorff}


def chamfer(a: Shape | Points, b: Shape | Points, *, n: int = 30_000, generator: torch.Generator) -> float:
    r"""The chamfer distance $\frac12 (\bar d(a, b) + \bar d(b, a))$ of mean distances, in the units of the surfaces.

    Parallel surfaces at a distance h have chamfer distance h. See `surface_distance`.
    """
    return surface_distance(a, b, n=n, generator=generator).chamfer


def hausdorff(a: Shape | Points, b: Shape | Points, *, n: int = 30_000, generator: torch.Generator) -> float:
    """The Hausdorff distance, the greatest from a point of one surface to the other; see `surface_distance`."""
    return surface_distance(a, b, n=n, generator=generator).hausdorff


@dataclass(frozen=True)
class ResidualTable:
    """How close a field is to its initial condition and its equation; `print` shows it as a row of a table.

    Attributes:
        surface: |f(., t)| on the surface that was given at the time t.
        distance: |f(., t) - g| in the box, with g the signed distance; None if the shape has none.
        equation: |F| in the box and the interval of time.
    """

    surface: Spread
    distance: Spread | None
    equation: Spread

    def __str__(self) -> str:
        columns = {"on-surface": self.surface, "off-surface": self.distance, "equation": self.equation}
        known = {name: spread for name, spread in columns.items() if spread is not None}
        return "\n".join(
            (
                "".join(f"{name:<22}" for name in known).rstrip(),
                "".join(f"{'mean':<11}{'max':<11}" for _ in known).rstrip(),
                "".join(f"{spread.mean:<11.2g}{spread.max:<11.2g}" for spread in known.values()).rstrip(),
            )
        )


def residual_table(
    field: Field,
    equation: Condition,
    shape: Shape,
    *,
    time: float | tuple[float, ...],
    n: int = 1000,
    generator: torch.Generator,
) -> ResidualTable:
    r"""The three columns by which evolutions are judged, each of n new points.

    $|f(\cdot, t_0)|$ on the surface, $|f(\cdot, t_0) - g|$ at uniform points of the field's box, and $|F|$ at uniform
    points of the box and its times, or those of them that the equation draws. Small columns are necessary, not
    sufficient: a flatter f has a smaller residual.

    Args:
        field: The field f, with a box.
        equation: Its residual is F; of several equations at once, the norm.
        shape: What was given at $t_0$; its signed distance is g.
        time: $t_0$, or one value for each time and parameter.
        n: The number of points of each column.
        generator: The source of randomness.

    Raises:
        ValueError: If the field has no box, or there is not one value for each time.

    Reference:
        Novello et al., Neural Implicit Surface Evolution, ICCV 2023, Sec. 6.1, Tables 1 and 2.
    """
    times = (float(time),) if isinstance(time, int | float) else tuple(float(value) for value in time)
    if field.box is None:
        raise ValueError("residual_table(f, ...): the field has no box; set `f.box` to where it is to be judged.")
    if len(times) != field.times:
        raise ValueError(f"residual_table(time={time}): the field has {field.times} times; give one value for each.")
    device = next((tensor.device for tensor in field.parameters()), generator.device)
    on_surface = shape.sample(n, generator=generator).points.to(device)
    in_box = field.box.uniform(n, generator=generator).to(device)
    x = field.box.uniform(n, generator=generator).to(device)
    draw = getattr(equation, "draw", None)
    drawn = draw(n, generator=generator) if draw is not None else None
    t = (field.box.uniform_times(n, generator=generator) if drawn is None else drawn).to(device)
    start = x.new_tensor(times).expand(n, -1)
    with torch.no_grad():
        surface = field(on_surface, start)
        distance = field(in_box, start) - shape.distance(in_box) if isinstance(shape, Solid) else None
    residual = equation.residual(x, t, field.jet(x, t, order=equation.order))
    return ResidualTable(
        Spread.of(surface),
        None if distance is None else Spread.of(distance),
        Spread.of(residual if residual.ndim == 1 else residual.norm(dim=1)),
    )


def _drawn(a: Shape | Points, n: int, generator: torch.Generator) -> Float[np.ndarray, "n d"]:
    if isinstance(a, PointCloud):
        return a.points
    if isinstance(a, Shape):
        return a.sample(n, generator=generator).points.cpu().numpy()
    return np.asarray(a.detach().cpu() if isinstance(a, Tensor) else a, dtype=np.float64)


def _towards(b: Shape | Points, points: Float[np.ndarray, "n d"], a: Shape | Points) -> Spread:
    """The mean and greatest distance of points of a from b."""
    spread = Spread.of(torch.from_numpy(_distance(b, points)))
    if not isinstance(a, Mesh):
        return spread
    corners = a.vertices[np.unique(a.faces)]
    return Spread(spread.mean, max(spread.max, float(_distance(b, corners).max())))


def _distance(b: Shape | Points, points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
    """The unsigned distances of points from b."""
    if isinstance(b, Mesh):
        return b.closest(points).distance
    if isinstance(b, Solid):
        with torch.no_grad():
            return b.distance(torch.tensor(points)).abs().numpy()
    if isinstance(b, Implicit):
        return b.gap(torch.tensor(points)).cpu().numpy()
    if isinstance(b, Shape) and not isinstance(b, PointCloud):
        raise TypeError(
            f"surface_distance: a {type(b).__name__} has no distance. Extract a mesh from it, or give points (n, d)."
        )
    from scipy.spatial import cKDTree

    return cKDTree(_drawn(b, 0, torch.Generator())).query(points)[0]
