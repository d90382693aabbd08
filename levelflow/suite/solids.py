"""Solids of revolution for the suite."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from levelflow.boxes import Box
from levelflow.shapes.shape import Samples, Solid


class Turned(Solid):
    """The solid of revolution of a profile r(z) about the z axis, cut to |z| <= reach.

    The distance is that to the profile in its half plane, to a fine polygon of it: exact to 1e-6 of the radius.

    Args:
        profile: r(z) for heights (n,) up to twice the reach.
        reach: The greatest height.
    """

    def __init__(self, profile: Callable[[Tensor], Tensor], reach: float) -> None:
        self.profile, self.reach = profile, reach
        z = torch.linspace(-2 * reach, 2 * reach, 4001, dtype=torch.float64)
        self._polygon = torch.stack([profile(z), z], dim=1)

    @property
    def box(self) -> Box:
        r = float(self.profile(torch.linspace(-self.reach, self.reach, 2001, dtype=torch.float64)).max())
        return Box((-r, -r, -self.reach), (r, r, self.reach))

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        """Uniform in z and in the angle."""
        u = torch.rand(n, 2, generator=generator, dtype=torch.float64)
        z, angle = (2 * u[:, 0] - 1) * self.reach, 2 * math.pi * u[:, 1]
        slope = (self.profile(z + 1e-5) - self.profile(z - 1e-5)) / 2e-5
        up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
        around = torch.stack([torch.cos(angle), torch.sin(angle), torch.zeros(n, dtype=torch.float64)], dim=1)
        normals = around - slope[:, None] * up
        points = self.profile(z)[:, None] * around + z[:, None] * up
        return Samples(points, normals / torch.linalg.vector_norm(normals, dim=1, keepdim=True))

    def distance(self, x: Tensor) -> Tensor:
        from scipy.spatial import cKDTree

        p = torch.stack([torch.linalg.vector_norm(x[:, :2], dim=1), x[:, 2]], dim=1).double().cpu()
        nearest = torch.from_numpy(cKDTree(self._polygon.numpy()).query(p.numpy())[1])
        best = torch.full((len(p),), torch.inf, dtype=torch.float64)
        for i in (nearest.clamp_min(1) - 1, nearest.clamp_max(len(self._polygon) - 2)):
            start, along = self._polygon[i], self._polygon[i + 1] - self._polygon[i]
            part = (((p - start) * along).sum(1) / (along * along).sum(1)).clamp(0, 1)
            best = torch.minimum(best, torch.linalg.vector_norm(p - start - part[:, None] * along, dim=1))
        return (best * (p[:, 0] - self.profile(p[:, 1])).sign()).to(x)


class Tube(Turned):
    """The solid of revolution of $r(z) = r_0 - a \\cos \\pi z$."""

    def __init__(self, radius: float, depth: float, reach: float) -> None:
        super().__init__(lambda z: radius - depth * torch.cos(math.pi * z), reach)
