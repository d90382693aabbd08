"""A rival: differentiable ray marching, with the call of `levelflow.evolve`. Not run by itself.

Rays are marched to the surface. Where the value of the field at the point that a ray r sees changes, the point moves
along the ray,

    dx/dtheta = -r (df/dtheta) / <grad f, r>,

and a step of time is one step of descent, as in `meshsdf.py`: only the points and how they move differ. The flow at a
point is that of the nearest point of the mesh. Points that their ray only grazes, at less than six degrees, are left
out: they would outweigh all others. Rays are parallel, their directions drawn anew for each descent unless given.

References:
    Niemeyer et al., Differentiable Volumetric Rendering, CVPR 2020; Yariv et al., Multiview Neural Surface
    Reconstruction (IDR), NeurIPS 2020; Mehta et al., A Level Set Theory for Neural Implicit Evolution under Explicit
    Flows, ECCV 2022, Sec. 5.2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import meshsdf
import numpy as np
import torch
from jaxtyping import Float
from meshsdf import GRADIENT, Followers, Optimiser
from torch import Tensor

from levelflow import Box, Field, Mesh, Placed
from levelflow.evolution import Step
from levelflow.flows import Flow

GRAZING = 0.1
"""The least size of <n, r>."""

SAMPLES, SECANT = 64, 8
"""Of a ray where it crosses the box, and steps of the secant method from the first change of sign."""


@dataclass
class Rays:
    """Views of a surface by parallel rays.

    Attributes:
        directions: Of the views; drawn anew each time if left out.
        views: How many are drawn.
        rays: How many rays a view has along each side of its picture.
        generator: The source of directions.
    """

    directions: Sequence[Sequence[float]] | None = None
    views: int = 6
    rays: int = 32
    generator: torch.Generator = field(default_factory=lambda: torch.Generator().manual_seed(0))

    def __call__(self, surface: Field, mesh: Mesh, displacement: Float[np.ndarray, "n d"]) -> Followers:
        """What the rays see of a field, and how it moves when the field changes."""
        d = surface.space
        drawn = torch.randn(self.views, d, generator=self.generator, dtype=torch.float64)
        given = drawn if self.directions is None else torch.tensor(self.directions, dtype=torch.float64)
        box = mesh.box.expanded(0.02 * max(mesh.box.size))
        seen = [march(surface, *bundle(box, r / r.norm(), self.rays), box=box) for r in given]
        x, r = (torch.cat(parts) for parts in zip(*seen, strict=True))
        with torch.no_grad():
            slope = (surface.jet(x, order=1).gradient.to(x) * r).sum(1)
        return Followers(x, r / slope[:, None], torch.from_numpy(interpolated(mesh, displacement, x.numpy())))


def bundle(box: Box, direction: Float[Tensor, " d"], n: int) -> tuple[Float[Tensor, "m d"], Float[Tensor, "m d"]]:
    """Origins and directions of parallel rays through a square (in the plane, a line) that covers a box."""
    d, half = box.space, float(np.linalg.norm(box.size)) / 2
    side = half * (2 * (torch.arange(n, dtype=torch.float64) + 0.5) / n - 1)
    across = torch.linalg.svd(direction[None]).Vh[1:]
    offsets = torch.cartesian_prod(*[side] * (d - 1)).reshape(-1, d - 1) @ across
    origins = torch.tensor(box.center, dtype=torch.float64) + offsets - half * direction
    return origins, direction.expand_as(origins)


@torch.no_grad()
def march(
    surface: Field, origins: Float[Tensor, "m d"], rays: Float[Tensor, "m d"], *, box: Box
) -> tuple[Float[Tensor, "p d"], Float[Tensor, "p d"]]:
    """Where rays first go from the outside to the inside of a field in a box, and the rays that do, not grazing."""
    lower, upper = (origins.new_tensor(side) for side in (box.lower, box.upper))
    along = torch.where(rays.abs() < 1e-12, 1e-12, rays)
    first, second = (lower - origins) / along, (upper - origins) / along
    near, far = torch.minimum(first, second).amax(1).clamp_min(0), torch.maximum(first, second).amin(1)
    crossing = near < far
    o, r, near, far = origins[crossing], rays[crossing], near[crossing], far[crossing]
    depths = near[:, None] + (far - near)[:, None] * torch.linspace(0, 1, SAMPLES, dtype=o.dtype)
    values = surface((o[:, None] + depths[..., None] * r[:, None]).reshape(-1, o.shape[1])).reshape(depths.shape).to(o)
    enters = (values[:, :-1] > 0) & (values[:, 1:] <= 0)
    hit = enters.any(1)
    o, r, i = o[hit], r[hit], enters[hit].int().argmax(1)[:, None]
    (a, b), (fa, fb) = ([of[hit].gather(1, j)[:, 0] for j in (i, i + 1)] for of in (depths, values))
    for _ in range(SECANT):
        middle = a - fa * (b - a) / (fb - fa)
        value = surface(o + middle[:, None] * r).to(o)
        outside = value > 0
        a, fa = torch.where(outside, middle, a), torch.where(outside, value, fa)
        b, fb = torch.where(outside, b, middle), torch.where(outside, fb, value)
    x = o + (a - fa * (b - a) / (fb - fa))[:, None] * r
    gradient = surface.jet(x, order=1).gradient.to(x)
    kept = (gradient * r).sum(1).abs() > GRAZING * gradient.norm(dim=1)
    return x[kept], r[kept]


def interpolated(mesh: Mesh, values: Float[np.ndarray, "n c"], x: Float[np.ndarray, "p d"]) -> np.ndarray:
    """Values at the vertices of a mesh, at the points of it that are nearest to x."""
    closest = mesh.closest(x)
    corners = mesh.vertices[mesh.faces[closest.face]]
    rows = np.concatenate([corners.transpose(0, 2, 1), np.ones((len(x), 1, corners.shape[1]))], axis=1)
    shares = np.einsum("pij,pj->pi", np.linalg.pinv(rows), np.concatenate([closest.point, np.ones((len(x), 1))], 1))
    return np.einsum("pi,pic->pc", shares, values[mesh.faces[closest.face]])


def evolve(
    field: Placed,
    flow: Flow,
    *,
    dt: float,
    steps: int,
    parts: int = 1,
    resolution: int = 96,
    substeps: int = 4,
    optimiser: Optimiser = GRADIENT,
    search: bool = True,
    directions: Sequence[Sequence[float]] | None = None,
    views: int = 6,
    rays: int = 32,
    seed: int = 0,
    on_step: Callable[[Step], None] | None = None,
) -> Placed:
    """Evolves a field by a flow of its mesh: marches rays to it, lets the flow move what they see, and descends once.

    Args:
        field: A static field in a box.
        flow: What moves the vertices, in the units of the field.
        dt: The length of a step of time.
        steps: How many steps.
        parts: Into how many parts each step is divided, each with rays, a flow and a descent of its own.
        resolution: Cells of the extraction for the flow along the longest side of the box.
        substeps: How many steps of the flow a part is for the mesh.
        optimiser: Makes what takes the descents from the weights, once.
        search: Whether each descent is as long as serves best; if not, as long as the optimiser makes it.
        directions: Of the rays, one for each view; drawn anew for each descent if left out.
        views: How many directions are drawn.
        rays: How many rays a view has along each side.
        seed: Of the directions.
        on_step: Called after each step of time.

    Returns:
        The field in space and time, with a key at each step.
    """
    seen = Rays(directions, views, rays, torch.Generator().manual_seed(seed))
    return meshsdf.evolve(
        field, flow, dt=dt, steps=steps, parts=parts, resolution=resolution, substeps=substeps, optimiser=optimiser,
        search=search, seen=seen, on_step=on_step,
    )  # fmt: skip
