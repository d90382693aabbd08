"""Networks whose steepest slope is known, and can be trained to be small."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from levelflow.fields import Field
from levelflow.jets import Jet, chain_jet


class LipschitzMLP(Field):
    r"""A network $f(z) = \hat w \cdot h_L + b$, $h_l = \tanh(\hat W_l h_{l-1} + b_l)$, $h_0 = z = (x, t)$.

    Each row of $\hat W_l$ is that of $W_l$, scaled down where needed so that its absolute values add up to at most
    $e^{c_l}$, with $c_l$ learnt. That bounds the slope of each layer, so
    $|f(z) - f(z')| \le \prod_l e^{c_l}\, \max_i |z_i - z'_i|$. Added to a loss with a small weight, as `fit` and
    `solve` do, the product makes a field that is given at a few times or parameters smooth in between.

    (The paper has $\operatorname{softplus}(c_l)$, which is $c_l$ itself where it is large. Optimisers like Adam move
    every parameter at a given pace, so that bounds of some tens, as networks start with, take thousands of steps to
    fall to one; their logarithms take hundreds.)

    It is made for points in [-1, 1]^d and times in [-1, 1].

    Args:
        space: The number d of space coordinates.
        time: The number k of times or parameters.
        width: Neurons of a hidden layer.
        depth: Hidden layers.
        generator: Source of the initial weights; a new one with seed 0 if left out.
        dtype: Of the weights.

    Raises:
        ValueError: If a size is not positive.

    Reference:
        Liu et al., Learning Smooth Neural Functions via Lipschitz Regularization, SIGGRAPH 2022, Sec. 4.
    """

    def __init__(
        self,
        space: int = 3,
        time: int = 0,
        *,
        width: int = 128,
        depth: int = 4,
        generator: torch.Generator | None = None,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        if min(space, width, depth) < 1 or time < 0:
            raise ValueError(
                f"LipschitzMLP(space={space}, time={time}, width={width}, depth={depth}): "
                "space, width and depth must be positive, and time at least 0."
            )
        generator = generator or torch.Generator().manual_seed(0)
        self.space, self.times = space, time
        self.width, self.depth = width, depth
        sizes = [space + time] + [width] * depth + [1]
        # Not torch's own initial weights, which would use up its global generator.
        self.layers = nn.ModuleList(nn.utils.skip_init(nn.Linear, a, b, dtype=dtype) for a, b in pairwise(sizes))
        self.c = nn.Parameter(torch.empty(depth + 1, dtype=dtype))
        with torch.no_grad():
            for i, layer in enumerate(self._linear()):
                bound = math.sqrt(3 / layer.in_features)
                layer.weight.uniform_(-bound, bound, generator=generator)
                layer.bias.uniform_(-bound, bound, generator=generator)
                steepest = layer.weight.abs().sum(1).max()
                # The bound is the greatest row sum: at the start no row is scaled.
                self.c[i] = steepest.log()

    @property
    def lipschitz(self) -> Float[Tensor, ""]:
        r"""The regulariser $\prod_l e^{c_l}$, differentiable.

        It bounds the slope of f against the greatest coordinate difference, in space and time together: nowhere is
        $\sum_i |\partial f / \partial z_i|$ greater, and so neither is $|\nabla f|$ nor any $|\partial_t f|$.
        """
        return self.c.sum().exp()

    @property
    def slopes(self) -> Float[Tensor, " m"]:
        r"""Bounds of $|\partial f / \partial z_i|$: $|\hat w|\,|\hat W_L| \cdots |\hat W_1|$.

        One for each coordinate of (x, t). They add up to at most `lipschitz`, and tell space from time. Differentiable.
        """
        product, *rest = (weight.abs() for weight, _ in reversed(self._bounded()))
        for weight in rest:
            product = product @ weight
        return product[0]

    def push(self, jet: Jet) -> Jet:
        jet = jet.to(self.c)
        *hidden, last = self._bounded()
        for weight, bias in hidden:
            jet = jet.affine(weight, bias).pointwise(tanh)
        return jet.affine(*last).component(0)

    def jet(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None, *, order: int = 1) -> Jet:
        x, t = (part.to(self.c.dtype) for part in self._inputs(x, t))
        *hidden, last = self._bounded()
        return chain_jet(x, t, hidden, last, tanh, order=order)

    def forward(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None) -> Tensor:
        return self.jet(x, t, order=0).value

    def at(self, *t: float | None) -> LipschitzMLP:
        """The network at the given time or parameters; of several, those that are None stay.

        Their columns move into the first bias. Its bounds are no greater than those of this network.
        """
        self._check_times(t)
        sliced = LipschitzMLP(self.space, t.count(None), width=self.width, depth=self.depth, dtype=self.c.dtype)
        state = {name: value.detach().clone() for name, value in self.state_dict().items()}
        weight = self._bounded()[0][0].detach()
        free = [*range(self.space), *(self.space + i for i, value in enumerate(t) if value is None)]
        state["layers.0.weight"] = weight[:, free]
        state["layers.0.bias"] += weight[:, self.space :] @ weight.new_tensor([value or 0.0 for value in t])
        sliced.load_state_dict(state)
        return sliced.to(weight.device)

    def _linear(self) -> Iterable[nn.Linear]:
        return cast(Iterable[nn.Linear], self.layers)

    def _bounded(self) -> Sequence[tuple[Tensor, Tensor]]:
        """Weights and biases of the layers, the rows of the weights within their bounds."""
        layers = []
        for layer, bound in zip(self._linear(), self.c.exp(), strict=True):
            rows = layer.weight.abs().sum(1, keepdim=True)
            layers.append((layer.weight * (bound / torch.maximum(rows, bound)), layer.bias))
        return layers


def tanh(u: Tensor, order: int) -> tuple[Tensor, ...]:
    """tanh u and its first `order` derivatives."""
    s = torch.tanh(u)
    if not order:
        return (s,)
    slope = 1 - s * s
    return (s, slope, -2 * s * slope)[: order + 1]
