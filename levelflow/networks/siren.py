"""Sinusoidal networks."""

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


class SIREN(Field):
    r"""A sinusoidal network $f(x, t) = w \cdot h_L + b$, $h_l = \sin(\omega (W_l h_{l-1} + b_l))$, $h_0 = (x, t)$.

    It is made for points in [-1, 1]^d and times in [-1, 1]; `fit` and `solve` place it in the units of a shape.

    Args:
        space: The number d of space coordinates.
        time: The number k of times or parameters.
        width: Neurons of a hidden layer.
        depth: Hidden layers.
        omega: The frequency. Weights start at U(-1/n, 1/n) in the first layer and U(-s, s), s = sqrt(6/n) / omega,
            in the others, for n inputs of the layer. The papers take 30 with Adam; with our optimiser motion is learnt
            better with 10 and detail with 15: the defaults with and without times.
        time_scale: By how much smaller the weights of the times start: evolutions are smoother in time than in space.
        generator: Source of the initial weights; a new one with seed 0 if left out.
        dtype: Of the weights.

    Raises:
        ValueError: If a size or the frequency is not positive.

    Reference:
        Sitzmann et al., Implicit Neural Representations with Periodic Activation Functions, NeurIPS 2020, Sec. 3.2;
        Novello et al., Neural Implicit Surface Evolution, ICCV 2023, Sec. 4.3.
    """

    def __init__(
        self,
        space: int = 3,
        time: int = 0,
        *,
        width: int = 128,
        depth: int = 3,
        omega: float | None = None,
        time_scale: float = 0.5,
        generator: torch.Generator | None = None,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        if omega is None:
            omega = 10.0 if time else 15.0
        if min(space, width, depth) < 1 or time < 0 or not omega > 0:
            raise ValueError(
                f"SIREN(space={space}, time={time}, width={width}, depth={depth}, omega={omega}): "
                "space, width, depth and omega must be positive, and time at least 0."
            )
        generator = generator or torch.Generator().manual_seed(0)
        self.space, self.times = space, time
        self.width, self.depth, self.omega = width, depth, float(omega)
        sizes = [space + time] + [width] * depth
        # Not torch's own initial weights, which would use up its global generator.
        skip = nn.utils.skip_init
        self.hidden = nn.ModuleList(skip(nn.Linear, a, b, dtype=dtype) for a, b in pairwise(sizes))
        self.last = skip(nn.Linear, width, 1, dtype=dtype)
        with torch.no_grad():
            for i, layer in enumerate([*self.hidden, self.last]):
                n = layer.in_features
                bound = 1 / n if i == 0 else math.sqrt(6 / n) / omega
                layer.weight.uniform_(-bound, bound, generator=generator)
                if i == 0:
                    layer.weight[:, space:] *= time_scale
                layer.bias.uniform_(-1 / math.sqrt(n), 1 / math.sqrt(n), generator=generator)

    def push(self, jet: Jet) -> Jet:
        jet = jet.to(self.last.weight)
        for weight, bias in self._hidden():
            jet = jet.affine(weight, bias).pointwise(sine)
        return jet.affine(self.last.weight, self.last.bias).component(0)

    def jet(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None, *, order: int = 1) -> Jet:
        x, t = (part.to(self.last.weight.dtype) for part in self._inputs(x, t))
        return chain_jet(x, t, self._hidden(), (self.last.weight, self.last.bias), sine, order=order)

    def forward(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None) -> Tensor:
        return self.jet(x, t, order=0).value

    def at(self, *t: float | None) -> SIREN:
        self._check_times(t)
        return sliced(self, *t)

    def _hidden(self) -> Sequence[tuple[Tensor, Tensor]]:
        """Weights and biases of the hidden layers with the frequency folded in."""
        layers = cast(Iterable[nn.Linear], self.hidden)
        return [(self.omega * layer.weight, self.omega * layer.bias) for layer in layers]


def sliced(network: SIREN, *t: float | None) -> SIREN:
    r"""The network of space alone at a fixed time: $g(x) = f(x, t)$, exact to rounding.

    The columns U of the times leave the first layer and move into its bias, $\sin(\omega (W x + b + U t))$; all else is
    copied. With several times or parameters, those that are None stay.

    Args:
        network: The network f.
        t: The value of each of its times or parameters, or None.

    Raises:
        ValueError: If the number of values is not that of the times, or one is no finite number.

    Reference:
        Novello et al., Neural Implicit Surface Evolution, ICCV 2023, supplement, Prop. 3.1.
    """
    if len(t) != network.times:
        raise ValueError(
            f"sliced: {len(t)} value(s) are given and the network depends on {network.times} time(s); "
            "give one for each, None for what is to stay."
        )
    fixed = {network.space + i: value for i, value in enumerate(t) if value is not None}
    if not all(map(math.isfinite, fixed.values())):
        raise ValueError(f"sliced: the times {list(t)} must be finite numbers.")
    free = [i for i in range(network.space + network.times) if i not in fixed]
    last = network.last.weight
    found = SIREN(
        network.space, t.count(None), width=network.width, depth=network.depth, omega=network.omega, dtype=last.dtype
    )
    state = {name: value.detach().clone() for name, value in network.state_dict().items()}
    weight = state["hidden.0.weight"]
    state["hidden.0.weight"] = weight[:, free]
    state["hidden.0.bias"] += weight[:, list(fixed)] @ weight.new_tensor(list(fixed.values()))
    found.load_state_dict(state)
    return found.to(last.device)


def sine(u: Tensor, order: int) -> tuple[Tensor, ...]:
    """sin u and its first `order` derivatives."""
    s = torch.sin(u)
    return (s, torch.cos(u), -s)[: order + 1] if order else (s,)
