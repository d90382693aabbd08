"""Jets, and how maps push them: value, first and second derivatives at a batch of points.

Two ways to the same numbers stand here. The plain one pushes every derivative forward through affine and pointwise
layers; it is short and is the oracle of the tests. The other, `chain_jet`, pushes the value and d first derivatives
forward, runs one adjoint vector back, and sums the Hessian over the layers; it is what training uses. Both are
ordinary differentiable tensor code, so a residual built from a jet needs a single backward pass.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import torch
from jaxtyping import Float
from torch import Tensor

Activation = Callable[[Tensor, int], tuple[Tensor, ...]]
"""A pointwise function and its derivatives: `activation(u, order)` returns (s(u), s'(u), ...), order + 1 tensors."""


@dataclass(frozen=True)
class Jet:
    """Value and derivatives of a map at n points, in d space coordinates followed by k times or parameters.

    For a scalar field the trailing axes `*m` are absent: `value` is (n,), `first` is (n, d + k), `second` is (n, d, d).

    Attributes:
        value: (n, *m).
        first: (n, d + k, *m), the derivatives in space, then in time; absent in a jet of order 0.
        second: (n, d, d, *m), the second derivatives in space; absent below order 2.
        space: The number d of space coordinates.
        curvature: The jet of a field that stands for the total curvature, beside that of f, where an equation of
            fourth order needs it.
    """

    value: Tensor
    first: Tensor | None
    second: Tensor | None
    space: int
    curvature: Jet | None = None

    @property
    def order(self) -> int:
        """The highest derivative that the jet carries: 0, 1 or 2."""
        return 0 if self.first is None else 1 if self.second is None else 2

    @property
    def gradient(self) -> Tensor:
        """The derivatives in space, (n, d)."""
        return self._first()[:, : self.space]

    @property
    def dt(self) -> Tensor:
        """The derivatives in the times or parameters, (n, k)."""
        return self._first()[:, self.space :]

    @property
    def hessian(self) -> Tensor:
        """The second derivatives in space, (n, d, d)."""
        if self.second is None:
            raise ValueError(f"This jet has order {self.order} and no Hessian; ask for it with jet(x, t, order=2).")
        return self.second

    def along(self, i: int) -> Jet:
        """The jet in space and in one of the times or parameters, as if the others were fixed."""
        first = None if self.first is None else torch.cat([self.gradient, self.dt[:, i : i + 1]], dim=1)
        return Jet(self.value, first, self.second, self.space, self.curvature)

    def affine(self, weight: Float[Tensor, "m_out m_in"], bias: Float[Tensor, " m_out"] | None = None) -> Jet:
        """The jet of W u + b."""
        value = self.value @ weight.T
        return Jet(
            value if bias is None else value + bias,
            None if self.first is None else self.first @ weight.T,
            None if self.second is None else self.second @ weight.T,
            self.space,
        )

    def pointwise(self, activation: Activation) -> Jet:
        """The jet of s(u), by the chain rule: s' u_i, and s' u_ij + s'' u_i u_j."""
        s = activation(self.value, self.order)
        first, second = None, None
        if self.first is not None:
            first = s[1][:, None] * self.first
        if self.second is not None:
            du = self.gradient
            second = s[1][:, None, None] * self.second + s[2][:, None, None] * du[:, :, None] * du[:, None, :]
        return Jet(s[0], first, second, self.space)

    def component(self, i: int) -> Jet:
        """The jet of one component of a vector-valued map."""
        return Jet(
            self.value[..., i],
            None if self.first is None else self.first[..., i],
            None if self.second is None else self.second[..., i],
            self.space,
        )

    def components(self, start: int, stop: int | None = None) -> Jet:
        """The jet of some components of a vector-valued map, as a vector."""
        return Jet(
            self.value[..., start:stop],
            None if self.first is None else self.first[..., start:stop],
            None if self.second is None else self.second[..., start:stop],
            self.space,
        )

    def beside(self, other: Jet) -> Jet:
        """The jet of (u, v) from those of the vectors u and v, of the same order."""
        return Jet(
            torch.cat([self.value, other.value], dim=-1),
            None if self.first is None else torch.cat([self.first, other._first()], dim=-1),
            None if self.second is None else torch.cat([self.second, other.hessian], dim=-1),
            self.space,
        )

    def to(self, like: Tensor) -> Jet:
        """The jet with the dtype and on the device of a tensor."""
        return Jet(
            self.value.to(like),
            None if self.first is None else self.first.to(like),
            None if self.second is None else self.second.to(like),
            self.space,
        )

    def __add__(self, other: Jet) -> Jet:
        order = min(self.order, other.order)
        return Jet(
            self.value + other.value,
            self._first() + other._first() if order > 0 else None,
            self.hessian + other.hessian if order > 1 else None,
            self.space,
        )

    def __mul__(self, other: Jet) -> Jet:
        """The jet of a product, by Leibniz' rule: (f g)_ij = f_ij g + f_i g_j + f_j g_i + f g_ij."""
        order = min(self.order, other.order)
        first, second = None, None
        if order > 0:
            first = self._first() * other.value[:, None] + self.value[:, None] * other._first()
        if order > 1:
            cross = self.gradient[:, :, None] * other.gradient[:, None, :]
            second = (
                self.hessian * other.value[:, None, None]
                + cross
                + cross.transpose(1, 2)
                + self.value[:, None, None] * other.hessian
            )
        return Jet(self.value * other.value, first, second, self.space)

    def _first(self) -> Tensor:
        if self.first is None:
            raise ValueError("This jet has order 0 and no derivatives; ask for them with jet(x, t, order=1).")
        return self.first


def identity(x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], *, order: int) -> Jet:
    """The jet of the map (x, t) -> (x, t), from which every other jet is pushed."""
    _require_order(order)
    n, d = x.shape
    size = d + t.shape[1]
    return Jet(
        torch.cat([x, t], dim=1),
        torch.eye(size, dtype=x.dtype, device=x.device).expand(n, size, size) if order > 0 else None,
        x.new_zeros(n, d, d, size) if order > 1 else None,
        d,
    )


def chain_jet(
    x: Float[Tensor, "n d"],
    t: Float[Tensor, "n k"],
    hidden: Sequence[tuple[Tensor, Tensor]],
    output: tuple[Tensor, Tensor],
    activation: Activation,
    *,
    order: int,
) -> Jet:
    r"""The jet of a network $w \cdot s(W_L \cdots s(W_1 (x, t) + b_1) \cdots + b_L) + b$, by the adjoint Hessian.

    With $u_l$ the argument of layer l, $P_l = \partial u_l / \partial x$ and $a_l = \partial f / \partial s(u_l)$,

    $$\nabla^2 f = \sum_l P_l^\top \operatorname{diag}(a_l\, s''(u_l))\, P_l .$$

    Per hidden layer this takes 1 + d matrix products forward and one back, where pushing all planes takes
    1 + (d + k) + d^2, and ordinary backward through it needs no second differentiation.

    Args:
        x: Points.
        t: Times or parameters; k may be 0.
        hidden: Weight (m_out, m_in) and bias (m_out,) of each hidden layer.
        output: Weight (1, m) and bias (1,) of the last, affine layer.
        activation: The pointwise function s and its derivatives.
        order: 0, 1 or 2.
    """
    _require_order(order)
    d = x.shape[1]
    u = torch.cat([x, t], dim=1)
    slopes: list[Tensor] = []
    bends: list[Tensor] = []
    planes: list[Tensor] = []
    for layer, (weight, bias) in enumerate(hidden):
        if order > 1 and layer == 0:
            # The same for every point: the columns of the weight.
            planes.append(weight.T[:d])
        elif order > 1 and layer == 1:
            # diag(slopes) P W^T with the product of what is shared taken first.
            shared = (planes[0].T[:, :, None] * weight.T[:, None]).flatten(1)
            planes.append((slopes[0] @ shared).unflatten(1, (d, -1)))
        elif order > 1:
            planes.append((slopes[-1][:, None] * planes[-1]) @ weight.T)
        s = activation(torch.addmm(bias, u, weight.T), order)
        u = s[0]
        slopes += s[1:2]
        bends += s[2:3]
    value = torch.addmm(output[1], u, output[0].T)[:, 0]
    if order == 0:
        return Jet(value, None, None, d)

    adjoint = output[0].expand_as(u)
    hessian: Tensor | None = None
    for layer in range(len(hidden) - 1, -1, -1):
        if order > 1:
            term = weighted_squares(adjoint * bends[layer], planes[layer])
            hessian = term if hessian is None else hessian + term
        adjoint = (adjoint * slopes[layer]) @ hidden[layer][0]
    return Jet(value, adjoint, hessian, d)


def _require_order(order: int) -> None:
    if order not in (0, 1, 2):
        raise ValueError(f"jet(order={order}): the order must be 0 (value), 1 (gradient) or 2 (Hessian).")


def weighted_squares(weights: Float[Tensor, "n m"], planes: Tensor) -> Float[Tensor, "n d d"]:
    """The matrices sum_m weights_m P_im P_jm, for planes of each point (n, d, m) or shared by all of them (d, m)."""
    if planes.ndim == 2:
        d = planes.shape[0]
        return (weights @ (planes[:, None] * planes[None]).reshape(d * d, -1).T).reshape(-1, d, d)
    return cast(Tensor, _WeightedSquares.apply(weights, planes))


class _WeightedSquares(torch.autograd.Function):
    """P diag(w) P^T for each point, with a backward pass that uses its symmetry: one small product instead of three."""

    @staticmethod
    def forward(ctx: Any, weights: Tensor, planes: Tensor) -> Tensor:
        ctx.save_for_backward(weights, planes)
        return (weights[:, None] * planes) @ planes.transpose(1, 2)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor]:
        (gradient,) = gradients
        weights, planes = ctx.saved_tensors
        turned = (gradient + gradient.transpose(1, 2)) @ planes
        return (turned * planes).sum(1) / 2, turned * weights[:, None]
