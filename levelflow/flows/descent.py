"""Gradient descent of any energy of a mesh, and energies for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from levelflow.flows.flow import Flow
from levelflow.flows.laplacian import Laplacian, boundary
from levelflow.shapes.mesh import Mesh

Energy = Callable[[Tensor, Tensor], Tensor]
"""An energy of a mesh: a number for vertices (n, d) in float64 and faces (m, d), differentiable in the vertices."""


@dataclass(frozen=True)
class Descent(Flow):
    r"""The gradient descent of an energy, $\partial_t x = -\alpha\,(M + l^2 L)^{-1}\, \partial E / \partial x$.

    Divided by the mass M, the areas (lengths) around the vertices, the gradient is a vector field on the surface whose
    size does not depend on the triangles, as that of $\partial E / \partial x$ does. L smooths what is finer than the
    length l: with l = 0 a vertex among slivers flies off, since it has next to no mass. One step is an explicit one of
    Euler's: where the descent is like a diffusion of the rate D, keep D dt below $2 l^2$.

    Attributes:
        energy: E(vertices, faces): `area`, `dirichlet`, or a function of your own made of torch.
        rate: The coefficient $\alpha > 0$, in length^(d + 1) per unit of energy and time.
        reach: The length l; half the mean length of an edge if left out, so that it vanishes with the edges.
        fixed_boundary: Whether the boundary of an open mesh stands still.

    Raises:
        ValueError: If `rate` is not positive or `reach` negative, if the energy is not one number, does not depend on
            the vertices, or has a gradient that is not finite.

    Reference:
        Mehta et al., A Level Set Theory for Neural Implicit Evolution under Explicit Flows (2022), eq. 2; Nicolet et
        al., Large Steps in Inverse Rendering of Geometry (2021), on the metric $M + l^2 L$.
    """

    energy: Energy
    rate: float
    reach: float | None = field(default=None, kw_only=True)
    fixed_boundary: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        if not self.rate > 0:
            raise ValueError(f"Descent(rate={self.rate:g}): the rate must be positive; to climb, descend -E.")
        if self.reach is not None and not self.reach >= 0:
            raise ValueError(f"Descent(reach={self.reach:g}): the reach is a length; 0 smooths nothing.")

    def displacement(self, mesh: Mesh, dt: float, *, time: float) -> Float[np.ndarray, "n d"]:
        gradient = self._gradient(mesh)
        reach = _edge_length(mesh) / 2 if self.reach is None else self.reach
        held = boundary(mesh.faces, len(mesh.vertices)) & self.fixed_boundary
        solve = Laplacian.of(mesh.vertices, mesh.faces).screened(reach**2, held=held)
        return -self.rate * dt * solve(gradient)

    def _gradient(self, mesh: Mesh) -> Float[np.ndarray, "n d"]:
        vertices, faces = torch.tensor(mesh.vertices, requires_grad=True), torch.tensor(mesh.faces)
        with torch.enable_grad():
            energy = self.energy(vertices, faces)
            if energy.numel() != 1:
                raise ValueError(
                    f"Descent: the energy has the shape {tuple(energy.shape)}; wanted is one number for the mesh, "
                    "such as its sum."
                )
            if not energy.requires_grad:
                raise ValueError(
                    "Descent: the energy does not depend on the vertices; make it of torch operations on them, "
                    "without detach() or numpy()."
                )
            (gradient,) = torch.autograd.grad(energy.sum(), vertices, materialize_grads=True)
        if len(bad := (~gradient.isfinite().all(1)).nonzero()):
            raise ValueError(
                f"Descent: the gradient of the energy is not finite at {len(bad)} of {len(vertices)} vertices, the "
                f"first is vertex {int(bad[0])} at {tuple(mesh.vertices[int(bad[0])].tolist())}. Triangles without "
                "area divide by zero: clamp what is divided by."
            )
        return gradient.numpy()


def area(vertices: Float[Tensor, "n d"], faces: Int[Tensor, "m d"]) -> Float[Tensor, ""]:
    r"""The area of the surface, or the length of the curve, for `Descent`: motion by mean curvature at the rate of it.

    Its gradient is $L x$ with the cotangent weights of the triangles as they are.
    """
    corners = vertices[faces]
    edge = corners[:, 1] - corners[:, 0]
    if faces.shape[1] == 2:
        return torch.linalg.vector_norm(edge, dim=1).sum()
    return torch.linalg.vector_norm(torch.linalg.cross(edge, corners[:, 2] - corners[:, 0]), dim=1).sum() / 2


def dirichlet(vertices: Float[Tensor, "n d"], faces: Int[Tensor, "m d"]) -> Float[Tensor, ""]:
    r"""The Dirichlet energy of the positions, $\int \|\nabla x\|^2$, for `Descent`: twice the area, or the length.

    Lengths and angles in the integral are those of the mesh as it is and count as constant, so that the gradient is
    $2 L x$ on curves as on surfaces: descent at the rate $\alpha$ is motion by mean curvature at the rate $2\alpha$.

    Reference:
            Mehta et al., A Level Set Theory for Neural Implicit Evolution under Explicit Flows (2022), eqs. 13 and 14.
    """
    weights = Laplacian.of(vertices.detach().cpu().double().numpy(), faces.cpu().numpy()).stiffness.tocoo()
    ends, others = vertices[torch.from_numpy(weights.row).long()], vertices[torch.from_numpy(weights.col).long()]
    # Every edge appears twice, with minus its weight, and the diagonal with no difference.
    return -(vertices.new_tensor(weights.data) * (ends - others).square().sum(1)).sum() / 2


def _edge_length(mesh: Mesh) -> float:
    """The mean length of an edge, counted once for each face that has it."""
    sides = mesh.vertices[np.roll(mesh.faces, -1, axis=1)] - mesh.vertices[mesh.faces]
    return float(np.linalg.norm(sides, axis=2).mean())
