"""Normal and curvatures of the level sets of a field, from its jet.

With n = grad f / |grad f| pointing out, kappa = div n = k1 + k2, which is 2/r on a sphere of radius r. In the plane
there is one principal curvature, and kappa is it.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.jets import Jet


def gradient_norm(jet: Jet) -> Float[Tensor, " n"]:
    """|grad f|, differentiable everywhere: a zero gradient counts as the square root of the smallest number."""
    square = (jet.gradient * jet.gradient).sum(1)
    return square.clamp_min(torch.finfo(square.dtype).tiny).sqrt()


def normal(jet: Jet) -> Float[Tensor, "n d"]:
    """The unit normal n = grad f / |grad f|; zero where the gradient is zero."""
    return jet.gradient / gradient_norm(jet)[:, None]


def total_curvature(jet: Jet) -> Float[Tensor, " n"]:
    r"""$\kappa = \operatorname{div} n = (\Delta f - n^\top \nabla^2 f\, n) / |\nabla f|$, in 1 / length."""
    return _tangential_laplacian(jet) / gradient_norm(jet)


def mean_curvature(jet: Jet) -> Float[Tensor, " n"]:
    """The mean curvature H: (k1 + k2) / 2 in space, k in the plane; 1/r on a sphere or circle of radius r."""
    return total_curvature(jet) / (jet.space - 1)


def principal_curvatures(jet: Jet) -> Float[Tensor, "n d_minus_1"]:
    """The eigenvalues of the shape operator on the tangent space, in ascending order; shape (n, d - 1).

    They follow from the trace and the determinant, so that they are exact without an eigenvalue solver. At umbilic
    points the two agree and have no derivative of their own; that of their mean counts there for both.
    """
    kappa = total_curvature(jet)
    if jet.space == 2:
        return kappa[:, None]
    square = kappa * kappa / 4 - gauss_curvature(jet)
    discriminant = square.clamp_min(torch.finfo(square.dtype).tiny).sqrt()
    return torch.stack([kappa / 2 - discriminant, kappa / 2 + discriminant], dim=1)


def gauss_curvature(jet: Jet) -> Float[Tensor, " n"]:
    r"""$K = k_1 k_2 = n^\top \operatorname{adj}(\nabla^2 f)\, n / |\nabla f|^2$, in 1 / length^2.

    Raises:
        ValueError: If the field is not over three space coordinates.
    Reference:
        Goldman, Curvature formulas for implicit curves and surfaces, CAGD 22 (2005), eq. 4.1.
    """
    if jet.space != 3:
        raise ValueError(f"gauss_curvature: the jet has {jet.space} space coordinates; Gauss curvature needs 3.")
    n, h = normal(jet), jet.hessian
    # The rows of the adjugate of a symmetric matrix are the cross products of its other two rows.
    adjugate = torch.stack(
        [
            torch.linalg.cross(h[:, 1], h[:, 2]),
            torch.linalg.cross(h[:, 2], h[:, 0]),
            torch.linalg.cross(h[:, 0], h[:, 1]),
        ],
        dim=1,
    )
    return torch.einsum("ni,nij,nj->n", n, adjugate, n) / gradient_norm(jet) ** 2


def squared_curvature(jet: Jet) -> Float[Tensor, " n"]:
    r"""$k_1^2 + k_2^2 = \|P\,\nabla^2 f\,P\|^2 / |\nabla f|^2$, $P = I - n n^\top$, in 1 / length^2."""
    n, h = normal(jet), jet.hessian
    hn = (h * n[:, None]).sum(2)
    square = (h * h).sum((1, 2)) - 2 * (hn * hn).sum(1) + (hn * n).sum(1) ** 2
    return square / gradient_norm(jet) ** 2


def surface_laplacian(jet: Jet, of: Jet) -> Float[Tensor, " n"]:
    r"""The Laplacian of g along the level sets of f, $\Delta g - n^\top \nabla^2 g\, n - \kappa\, n \cdot \nabla g$.

    Args:
        jet: That of f, of order 2.
        of: That of g, of order 2.
    """
    n, h = normal(jet), of.hessian
    along = h.diagonal(dim1=1, dim2=2).sum(1) - ((h * n[:, None]).sum(2) * n).sum(1)
    return along - total_curvature(jet) * (n * of.gradient).sum(1)


def _tangential_laplacian(jet: Jet) -> Tensor:
    n = normal(jet)
    trace = jet.hessian.diagonal(dim1=1, dim2=2).sum(1)
    return trace - ((jet.hessian * n[:, None]).sum(2) * n).sum(1)
