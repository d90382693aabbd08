r"""What it costs to deform a thin elastic shell that is the zero set of a field.

A map D takes the deformed surface to the one at rest, which is the zero set of f: the deformed one is that of
$G = f \circ D$. All densities are functions of the jet of D at points x of the deformed surface, and of the gradient of
f at D(x); no parametrisation is needed, and no Hessian of f. With n the unit normal at rest, $m \propto J^\top n$ that
of the deformed surface, J the Jacobian of D and $P = 1 - m m^\top$ the projection on the tangent plane.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.jets import Jet


@dataclass(frozen=True)
class Shell:
    r"""How much a surface resists stretching and bending.

    The energy of a deformation is the integral of $k_S\,L_S + k_B\,L_B + k_T\,L_T$ over the deformed surface, with the
    densities of `stretching`, `bending` and `thickening`. Lengths count in half the longest side of the box of the
    field, so that a shape deforms alike in all units; beyond a distance of $\sqrt{k_B / k_S}$ stretching rules.

    Attributes:
        stretch: $k_S$.
        bend: $k_B$.
        thicken: $k_T$; without it a deformed distance is no distance, and bending is made cheap by thick shells.

    Raises:
        ValueError: If a coefficient is negative or not finite.
    """

    stretch: float = 0.1
    bend: float = 1e-3
    thicken: float = 0.1

    def __post_init__(self) -> None:
        if not all(0 <= k < math.inf for k in (self.stretch, self.bend, self.thicken)):
            raise ValueError(
                f"`Shell(stretch={self.stretch:g}, bend={self.bend:g}, thicken={self.thicken:g})`: the coefficients "
                "must be numbers that are not negative; 0 leaves one out."
            )

    @property
    def order(self) -> int:
        """The derivatives of the map that the energy needs; 0 if nothing is resisted."""
        return 2 if self.bend else 1 if self.stretch or self.thicken else 0

    def density(
        self, deformation: Jet, gradient: Float[Tensor, "n d"], bent: Float[Tensor, "n d d"] | None = None
    ) -> Float[Tensor, " n"]:
        r"""The energy for each unit of area of the surface at rest.

        Args:
            deformation: The jet of D at points of the deformed surface, of the order of the shell or above.
            gradient: The gradient of f at the points that D takes them to.
            bent: $\sum_k n_k \nabla^2 D_k$ with the unit normal n at rest, if it is known; order 1 is enough then.
        """
        total = gradient.new_zeros(len(gradient))
        if self.stretch:
            total = total + self.stretch * stretching(deformation, gradient)
        if self.bend:
            total = total + self.bend * bending(deformation, gradient, bent)
        if self.thicken:
            total = total + self.thicken * thickening(deformation, gradient)
        return total / area_element(deformation, gradient) if self.order else total


def stretching(deformation: Jet, gradient: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    r"""$L_S = |P^\top (1 - J^\top J)\, P|_F^2$: how much lengths in the tangent plane change, for each unit of area.

    Rotations and translations cost nothing. A surface made s times as large, $J = 1/s$, costs
    $(d - 1)\,(1 - s^{-2})^2$.

    Args:
        deformation: The jet of D at points of the deformed surface.
        gradient: The gradient of f at the points that D takes them to; of any length but zero.

    Reference:
        Yang et al., Geometry Processing with Neural Fields, NeurIPS 2021, eq. 5.
    """
    columns = deformation.gradient
    change = torch.eye(columns.shape[1]).to(columns) - columns @ columns.transpose(1, 2)
    return _tangential_square(change, _deformed_normal(deformation, gradient))


def bending(
    deformation: Jet, gradient: Float[Tensor, "n d"], bent: Float[Tensor, "n d d"] | None = None
) -> Float[Tensor, " n"]:
    r"""$L_B = |P^\top (\nabla^2 G - J^\top \nabla^2 f\, J)\, P|_F^2$: how much curvatures change, by unit of area.

    This is for $|\nabla f| = 1$ on the surface; other fields count as if they were divided by it. By the chain rule the
    difference is $\sum_k \partial_k f\, \nabla^2 D_k$. Affine maps cost nothing, and a plate that is rolled up to a
    cylinder of radius r costs $r^{-2}$.

    Args:
        deformation: The jet of D at points of the deformed surface, of order 2.
        gradient: The gradient of f at the points that D takes them to; of any length but zero.
        bent: $\sum_k n_k \nabla^2 D_k$ with the unit normal n at rest, if it is known; order 1 is enough then.

    Reference:
        Yang et al., Geometry Processing with Neural Fields, NeurIPS 2021, eq. 7.
    """
    if bent is None:
        bent = (deformation.hessian @ _unit(gradient)[:, None, :, None])[..., 0]
    return _tangential_square(bent, _deformed_normal(deformation, gradient))


def thickening(deformation: Jet, gradient: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    r"""$L_T = (|\nabla G| - 1)^2$: how much the shell becomes thicker or thinner, for each unit of area.

    This is for $|\nabla f| = 1$ as well; then the deformed field is a distance near its surface where nothing is
    charged. The published energies leave it free.

    Args:
        deformation: The jet of D at points of the deformed surface.
        gradient: The gradient of f at the points that D takes them to; of any length but zero.
    """
    return (_length((deformation.gradient @ _unit(gradient)[:, :, None])[..., 0]) - 1) ** 2


def area_element(deformation: Jet, gradient: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    r"""$|\det (J P + n\, m^\top)|$: the area at rest for each unit of area of the deformed surface.

    The integral of a density over the deformed surface is that of the density over this, on the surface at rest.

    Args:
        deformation: The jet of D at points of the deformed surface.
        gradient: The gradient of f at the points that D takes them to; of any length but zero.

    Reference:
        Yang et al., Geometry Processing with Neural Fields, NeurIPS 2021, eq. 8.
    """
    # By the rule for cofactors it is |det J| |J^-T m|, and J^T n = |J^T n| m.
    pulled = (deformation.gradient @ _unit(gradient)[:, :, None])[..., 0]
    return _determinant(deformation.gradient).abs() / _length(pulled)


def _deformed_normal(deformation: Jet, gradient: Tensor) -> Float[Tensor, "n d"]:
    """The unit normal m of the deformed surface."""
    return _unit((deformation.gradient @ gradient[:, :, None])[..., 0])


def _tangential_square(matrix: Float[Tensor, "n d d"], normal: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    """The squared Frobenius norm of P A P, for symmetric A."""
    across = (matrix @ normal[:, :, None])[..., 0]
    along = (across * normal).sum(1)
    tangential = (
        matrix
        - across[:, :, None] * normal[:, None]
        - normal[:, :, None] * across[:, None]
        + along[:, None, None] * normal[:, :, None] * normal[:, None]
    )
    return (tangential * tangential).sum((1, 2))


def _determinant(matrix: Float[Tensor, "n d d"]) -> Float[Tensor, " n"]:
    if matrix.shape[1] == 2:
        return matrix[:, 0, 0] * matrix[:, 1, 1] - matrix[:, 0, 1] * matrix[:, 1, 0]
    return torch.linalg.det(matrix)


def _unit(vectors: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
    return vectors / _length(vectors)[:, None]


def _length(vectors: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    square = (vectors * vectors).sum(1)
    return square.clamp_min(torch.finfo(square.dtype).tiny).sqrt()
