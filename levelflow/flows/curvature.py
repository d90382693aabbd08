"""Motion of a mesh by mean curvature, and smoothing that does not shrink it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from levelflow.flows.flow import Flow
from levelflow.flows.laplacian import Laplacian, boundary
from levelflow.shapes.mesh import Mesh


@dataclass(frozen=True)
class MeanCurvature(Flow):
    r"""Motion by mean curvature, $\partial_t x = \alpha\,\Delta x = -\alpha\,(k_1 + k_2)\, n$.

    One step is an implicit one of Euler's, $(M + \alpha\,dt\,L)\, x' = M x$, with the Laplacian $-M^{-1} L$ of the mesh
    as it is before the step. It is stable for every dt and every triangulation, of first order in dt and of second in
    the length of the edges. A sphere stays a sphere, $r(t)^2 = r_0^2 - 4\alpha t$, and a circle in the plane a circle,
    $r(t)^2 = r_0^2 - 2\alpha t$. Without the mass M the speed would depend on the size of the triangles.

    Attributes:
        rate: The coefficient $\alpha > 0$, in length^2 per unit time.
        fixed_boundary: Whether the boundary of an open mesh stands still, as a wire that holds a soap film. If not, it
            is drawn inward along the surface: right where a plane cuts off a surface that goes straight through it,
            and nowhere wrong further from it than some $\sqrt{\alpha\,dt}$.

    Raises:
        ValueError: If `rate` is not positive, or if dt is negative.

    Reference:
        Desbrun et al., Implicit Fairing of Irregular Meshes using Diffusion and Curvature Flow (1999); Mehta et al.,
        A Level Set Theory for Neural Implicit Evolution under Explicit Flows (2022), eq. 14.
    """

    rate: float
    fixed_boundary: bool = field(default=True, kw_only=True)

    def __post_init__(self) -> None:
        if not self.rate > 0:
            raise ValueError(
                f"flows.MeanCurvature(rate={self.rate:g}): the rate must be positive. To sharpen, run time backwards "
                "in a field: solve(equations.MeanCurvature(...), until=-0.1)."
            )

    def displacement(self, mesh: Mesh, dt: float, *, time: float) -> Float[np.ndarray, "n d"]:
        return _diffusion(self, mesh, self.rate, dt, fixed_boundary=self.fixed_boundary)(mesh.vertices)


@dataclass(frozen=True)
class Taubin(Flow):
    r"""Smoothing that does not shrink: diffusion at the rate $\lambda > 0$, then at the rate $\mu \le -\lambda < 0$.

    A step multiplies an eigenfunction of $-\Delta$ with the eigenvalue k by
    $(1 + |\mu|\,k\,dt) / (1 + \lambda k\,dt / 2)^2$: the smoothing is implicit, in two halves, so that no triangle is
    too small for it. What is longer than the wavelength $2 \pi / \sqrt{k_0}$, where
    $k_0 = 4\,(|\mu| - \lambda) / (\lambda^2 dt)$, is kept or grows, by at most the factor $q^2 / (2 q - 1)$ with
    $q = |\mu| / \lambda$; what is shorter goes. This is a filter made of steps, not a motion: the same time in shorter
    steps smooths less.

    Attributes:
        rate: $\lambda$, in length^2 per unit time.
        mu: $\mu$, in length^2 per unit time; a little below $-\lambda$.
        fixed_boundary: Whether the boundary of an open mesh stands still.

    Raises:
        ValueError: If `rate` is not positive, if `mu` is above -`rate`, or if dt is negative.

    Reference:
        Taubin, A signal processing approach to fair surface design (1995), Sec. 3.
    """

    rate: float
    mu: float
    fixed_boundary: bool = field(default=True, kw_only=True)

    def __post_init__(self) -> None:
        if not (self.rate > 0 and self.mu <= -self.rate):
            raise ValueError(
                f"Taubin(rate={self.rate:g}, mu={self.mu:g}): the rate must be positive and mu at most -rate, so that "
                "as much is inflated as shrinks; for example Taubin(0.33, -0.34). To shrink too, MeanCurvature(rate)."
            )

    def displacement(self, mesh: Mesh, dt: float, *, time: float) -> Float[np.ndarray, "n d"]:
        # With S = 1 / (1 + rate k dt / 2) the factor of a wave is 2 q S - (2 q - 1) S^2.
        q = -self.mu / self.rate
        diffusion = _diffusion(self, mesh, self.rate / 2, dt, fixed_boundary=self.fixed_boundary)
        once = diffusion(mesh.vertices)
        return once + (1 - 2 * q) * diffusion(mesh.vertices + once)


def _diffusion(
    flow: Flow, mesh: Mesh, rate: float, dt: float, *, fixed_boundary: bool
) -> Callable[[Float[np.ndarray, "n d"]], Float[np.ndarray, "n d"]]:
    """By how much positions of the vertices change in an implicit step of the heat equation on the mesh."""
    if not dt >= 0:
        raise ValueError(
            f"{flow!r}.displacement(mesh, {dt:g}): a mesh cannot be smoothed backwards in time; give a positive dt."
        )
    laplacian = Laplacian.of(mesh.vertices, mesh.faces)
    held = boundary(mesh.faces, len(mesh.vertices)) & fixed_boundary
    solve = laplacian.screened(rate * dt, held=held)
    return lambda x: solve(-rate * dt * (laplacian.stiffness @ x))
