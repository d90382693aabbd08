"""Networks that map space onto itself one to one, and their inverses."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from levelflow.fields import Map
from levelflow.jets import Jet, identity, weighted_squares
from levelflow.networks.siren import sine


class InvertibleResNet(Map):
    r"""A one-to-one map $D = (1 + g_B) \circ \cdots \circ (1 + g_1)$ of $R^d$, with networks g of Lip(g) at most L < 1.

    Each $g(x, t) = W_m\, s(\cdots s(W_1 (\gamma(x), t) + b_1) \cdots) + b_m$ has the activation
    $s(u) = \sin(\omega u) / \omega$ with slopes up to 1, and the positional encoding

    $$\gamma(x) = \frac{1}{\sqrt{1 + n}} \left(x_i,\; \frac{\sin 2^j \pi x_i}{2^j \pi},\;
      \frac{\cos 2^j \pi x_i}{2^j \pi}\right)_{i \le d,\, j < n},$$

    which changes no length to first order, since $|\gamma_i'|^2 = (1 + \sum_j (\cos^2 + \sin^2)) / (1 + n) = 1$. The
    matrices are scaled down where needed to spectral norms of at most 1, the last one to at most L; the columns of the
    times in $W_1$ are free, as D is one to one in space at each time. The norms are exact, so the bound is certified up
    to rounding, during training as after it.

    The map starts as the identity. It is made for points in [-1, 1]^d and times in [-1, 1]: a deformed field is
    `Placed(Deformed(network, D), box)`, a surface moved by D itself is that of `Deformed(network, Inverse(D))`.

    Args:
        space: The number d of space coordinates.
        time: The number k of times or parameters.
        blocks: The number B of residual blocks.
        width: Neurons of a hidden layer.
        depth: Hidden layers of each block.
        frequencies: The number n of frequencies of the positional encoding.
        omega: The frequency of the activation; with a lower one g is nearly linear, as its slopes are bounded.
        lipschitz: The bound L. D changes distances by factors between (1 - L)^B and (1 + L)^B.
        generator: Source of the initial weights; a new one with seed 0 if left out.
        dtype: Of the weights.

    Raises:
        ValueError: If a size is not positive, or L is not between 0 and 0.99.

    Reference:
        Yang et al., Geometry Processing with Neural Fields, NeurIPS 2021, Sec. 5.2;
        Behrmann et al., Invertible Residual Networks, ICML 2019, Sec. 2.
    """

    def __init__(
        self,
        space: int = 3,
        time: int = 0,
        *,
        blocks: int = 6,
        width: int = 128,
        depth: int = 2,
        frequencies: int = 5,
        omega: float = 15.0,
        lipschitz: float = 0.9,
        generator: torch.Generator | None = None,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        if min(space, blocks, width, depth) < 1 or min(time, frequencies) < 0 or not omega > 0:
            raise ValueError(
                f"InvertibleResNet(space={space}, time={time}, blocks={blocks}, width={width}, depth={depth}, "
                f"frequencies={frequencies}, omega={omega}): space, blocks, width, depth and omega must be positive, "
                "time and frequencies at least 0."
            )
        if not 0 < lipschitz <= 0.99:
            raise ValueError(
                f"InvertibleResNet(lipschitz={lipschitz}): x + g(x) is one to one if the slopes of g are below 1, for "
                "certain whatever is rounded; give a bound between 0 and 0.99, and more blocks to deform more."
            )
        generator = generator or torch.Generator().manual_seed(0)
        self.space, self.times = space, time
        self.width, self.depth, self.frequencies = width, depth, frequencies
        self.omega, self.lipschitz = float(omega), float(lipschitz)
        sizes = [space * (1 + 2 * frequencies) + time] + [width] * depth + [space]
        # Not torch's own initial weights, which would use up its global generator.
        self.blocks = nn.ModuleList(
            nn.ModuleList(nn.utils.skip_init(nn.Linear, a, b, dtype=dtype) for a, b in pairwise(sizes))
            for _ in range(blocks)
        )
        with torch.no_grad():
            for block in self._linear():
                for layer in block:
                    bound = math.sqrt(3 / layer.in_features)
                    layer.weight.uniform_(-bound, bound, generator=generator)
                    layer.bias.uniform_(-1, 1, generator=generator)
                nn.init.zeros_(block[-1].weight)
                nn.init.zeros_(block[-1].bias)

    @property
    def bounds(self) -> tuple[float, float]:
        r"""The least and the greatest factor by which D can change a distance, at any time.

        These are $\prod_b (1 - L_b)$ and $\prod_b (1 + L_b)$ with the product $L_b \le L$ of the spectral norms of a
        block. The spectral norm of the Jacobian of D is at most the second, that of its inverse at most one over the
        first.
        """
        with torch.no_grad():
            steepest = torch.stack([block.lipschitz for block in self._residuals()])
        return float((1 - steepest).prod()), float((1 + steepest).prod())

    def push(self, jet: Jet) -> Jet:
        jet = jet.to(next(self.parameters()))
        moved = jet.components(0, self.space)
        for residual in self._residuals():
            moved = moved + residual.push(moved.beside(jet.components(self.space)))
        return moved

    def along(
        self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], covector: Float[Tensor, "n d"]
    ) -> tuple[Jet, Float[Tensor, "n d d"]]:
        r"""The jet of D of order 1, and $\sum_k a_k \nabla^2 D_k$ for a covector a of each point.

        By the adjoint Hessian that is 1 + d planes forward and one back; all second derivatives take $1 + d + d^2$.
        """
        jet = identity(x, t, order=1)
        moved, residuals, traces = jet.components(0, self.space), self._residuals(), []
        times = jet.components(self.space)
        for residual in residuals:
            added, trace = residual.traced(moved.beside(times))
            moved = moved + added
            traces.append(trace)
        hessian = x.new_zeros(len(x), self.space, self.space)
        for residual, trace in zip(reversed(residuals), reversed(traces), strict=True):
            back, bent = residual.adjoint(covector, trace)
            covector, hessian = covector + back[:, : self.space], hessian + bent
        return moved, hessian

    @torch.no_grad()
    def inverse(
        self, y: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None, *, tolerance: float | None = None
    ) -> Float[Tensor, "n d"]:
        r"""The points x with D(x, t) = y, by the fixed points of $x \mapsto y - g_b(x, t)$, the last block first.

        After n steps the image of x in the block is at most $L_b^n\, |g_b(y)|$ from y, wherever y is: that sets how
        many are taken, and fewer where a step is so short that they are enough. The whole is then checked:
        $|D(x, t) - y|$ is at most the tolerance at every point. The error of x is at most that over the lower of the
        `bounds`, and in general of the size of the tolerance.

        Args:
            y: Points.
            t: Times or parameters; may be left out when k = 0.
            tolerance: The greatest distance of D(x, t) to y, in units of y. If left out, what numbers of the dtype of
                the weights can give for certain: eight roundings a block, stretched as much as the later blocks may.
                Mostly about three are missed in all.

        Returns:
            The points, without derivatives; `Inverse` is the map that has them.

        Raises:
            ValueError: If a point is not finite, or the tolerance is below what the dtype can give so far from the
                origin.
        """
        y, t = (part.to(next(self.parameters())) for part in self._inputs(y, t))
        far = _greatest(y)
        if not math.isfinite(far + _greatest(t)):
            raise ValueError("InvertibleResNet.inverse: some points or times are not finite; leave them out.")
        x, stretch, allowed = y, 1.0, 0.0
        residuals = self._residuals()
        for residual in reversed(residuals):
            # What a block misses is stretched by the blocks after it; half of the tolerance is left for rounding.
            rounding = torch.finfo(y.dtype).eps * max(1.0, _greatest(x))
            share = 0.0 if tolerance is None else tolerance / (2 * len(residuals) * stretch)
            x = residual.inverse(x, t, tolerance=max(share, 2 * rounding))
            allowed += 8 * rounding * stretch
            stretch *= 1 + float(residual.lipschitz)
        missed = _greatest(self(x, t) - y)
        if not missed <= (allowed if tolerance is None else tolerance):
            raise ValueError(
                f"InvertibleResNet.inverse(tolerance={tolerance}): the points found miss by {missed:.1e}; numbers of "
                f"{y.dtype} as far as {far:.3g} from the origin allow no better. Ask for less, bring the points to "
                "[-1, 1]^d, or take network.double()."
            )
        return x

    def _linear(self) -> list[list[nn.Linear]]:
        return [list(cast(Iterable[nn.Linear], block)) for block in self.blocks]

    def _residuals(self) -> list[_Residual]:
        """The blocks with their matrices within their bounds, made once for a whole batch."""
        d, encoded = self.space, self.space * (1 + 2 * self.frequencies)
        layers = list(zip(*self._linear(), strict=True))
        weights, norms = [], []
        for i, same in enumerate(layers):
            # The same layer of all blocks at once: one decomposition of a batch of matrices.
            weight = torch.stack([layer.weight for layer in same])
            greatest = self.lipschitz if i == self.depth else 1.0
            norm = torch.linalg.matrix_norm(weight[:, :, :encoded] if i == 0 else weight, ord=2)
            weights.append(weight * (greatest / norm.clamp(min=greatest))[:, None, None])
            norms.append(norm.clamp(max=greatest))
        octaves = math.pi * 2.0 ** torch.arange(self.frequencies, dtype=torch.float64)
        waves = torch.kron(octaves.repeat(2)[:, None], torch.eye(d, d + self.times)).to(layers[0][0].weight)
        phases = torch.zeros_like(waves[:, 0])
        phases[d * self.frequencies :] = math.pi / 2
        # The columns of the times are those that were trained: they need no bound.
        times = torch.stack([layer.weight[:, encoded:] for layer in layers[0]])
        coded = weights[0][:, :, :encoded] / math.sqrt(1 + self.frequencies)
        mix = self.omega * coded[:, :, d:] / waves.sum(1)
        # With the frequency folded in, sin(omega u) / omega is a sine between layers.
        weights[0] = self.omega * torch.cat([coded[:, :, :d], times], dim=2)
        weights[-1] = weights[-1] / self.omega
        return [
            _Residual(
                (waves, phases, mix[b]),
                [
                    (weight[b], layer[b].bias if layer is layers[-1] else self.omega * layer[b].bias)
                    for weight, layer in zip(weights, layers, strict=True)
                ],
                torch.stack(norms)[:, b].prod(),
            )
            for b in range(len(self.blocks))
        ]


class Inverse(Map):
    """The inverse of an invertible network, (y, t) -> x with D(x, t) = y, with its derivatives.

    `Deformed(field, Inverse(D))` is the field that D carries along: its surface is the image of that of `field`.

    Derivatives are those of the implicit function theorem. Values and jets can be differentiated in points, times and
    weights as well, twice: two Newton steps, which change nothing beyond rounding, follow the fixed point.

    Args:
        network: The map D.
        tolerance: As in `InvertibleResNet.inverse`.
    """

    def __init__(self, network: InvertibleResNet, *, tolerance: float | None = None) -> None:
        super().__init__()
        self.network, self.tolerance = network, tolerance
        self.space, self.times = network.space, network.times

    def push(self, jet: Jet) -> Jet:
        r"""The jet of x, from those of y, t and D: $D_x x_i = y_i - D_t t_i$, $D_x x_{ij} = y_{ij} - A_{ij}$.

        A is the second derivative of D along $(x_i, t_i)$ and $(x_j, t_j)$, together with $D_t t_{ij}$: what D makes of
        the jet of (x, t) without the second derivatives of x.
        """
        jet = jet.to(next(self.parameters()))
        y, t = jet.components(0, self.space), jet.components(self.space)
        x = self.network.inverse(y.value, t.value, tolerance=self.tolerance)
        if torch.is_grad_enabled():
            # x is a constant. A Newton step from it has the right first derivatives, one from there the second as well.
            for _ in range(2):
                there = self.network.push(identity(x, t.value, order=1))
                x = x + _pulled((y.value - there.value)[:, None], there)[:, 0]
        if y.first is None or t.first is None:
            return Jet(x, None, None, jet.space)

        there = self.network.push(identity(x, t.value, order=1))
        first = _pulled(y.first - t.first @ there.dt, there)
        if y.second is None:
            return Jet(x, first, None, jet.space)
        curved = self.network.push(Jet(x, first, torch.zeros_like(y.second), jet.space).beside(t))
        rest = y.second - curved.hessian
        return Jet(x, first, _pulled(rest.flatten(1, 2), there).view_as(rest), jet.space)


@dataclass(frozen=True)
class _Residual:
    """The network g of one block, with matrices within their bounds and the frequency folded in.

    Attributes:
        waves: The frequencies (2 n d, d + k) and phases (2 n d,) of the positional encoding, and the matrix
            (width, 2 n d) by which its waves enter the first layer.
        layers: Weights and biases; the first weight is that of (x, t).
        lipschitz: The product of the spectral norms, which bounds |g(x, t) - g(x', t)| / |x - x'|.
    """

    waves: tuple[Tensor, Tensor, Tensor]
    layers: list[tuple[Tensor, Tensor]]
    lipschitz: Tensor

    def push(self, jet: Jet) -> Jet:
        """The jet of g after that of (x, t); for d components, adjoints take no fewer products than all the planes."""
        frequencies, phases, mix = self.waves
        first, *rest = self.layers
        jet = jet.affine(*first) + jet.affine(frequencies, phases).pointwise(sine).affine(mix)
        for layer in rest:
            jet = jet.pointwise(sine).affine(*layer)
        return jet

    def traced(self, jet: Jet) -> tuple[Jet, list[tuple[Tensor, Tensor, Tensor]]]:
        """The jet of g of order 1, with the derivatives s', s'' and the space derivatives before each sine."""
        frequencies, phases, mix = self.waves
        first, *rest = self.layers
        trace = []

        def through(inner: Jet) -> Jet:
            sine_, cosine = torch.sin(inner.value), torch.cos(inner.value)
            trace.append((cosine, -sine_, inner.gradient))
            return Jet(sine_, None if inner.first is None else cosine[:, None] * inner.first, None, inner.space)

        jet = jet.affine(*first) + through(jet.affine(frequencies, phases)).affine(mix)
        for layer in rest:
            jet = through(jet).affine(*layer)
        return jet, trace

    def adjoint(self, covector: Tensor, trace: list[tuple[Tensor, Tensor, Tensor]]) -> tuple[Tensor, Tensor]:
        """What a covector after g is before it, and the sum of the Hessians of the sines that it passes on its way."""
        frequencies, _, mix = self.waves
        first, *rest = self.layers
        waves, *sines = trace
        bent: Tensor | None = None
        for (weight, _), (slope, bend, planes) in zip(reversed(rest), reversed(sines), strict=True):
            covector = covector @ weight
            term = weighted_squares(covector * bend, planes)
            bent = term if bent is None else bent + term
            covector = covector * slope
        slope, bend, planes = waves
        mixed = covector @ mix
        bent = weighted_squares(mixed * bend, planes) + (0 if bent is None else bent)
        return covector @ first[0] + (mixed * slope) @ frequencies, bent

    def inverse(self, y: Tensor, t: Tensor, *, tolerance: float) -> Tensor:
        """The points x with x + g(x, t) within the tolerance of y."""
        steepest = float(self.lipschitz)
        x = y - self._value(y, t)
        moved = _greatest(x - y)
        steps = math.ceil(math.log(tolerance / moved, steepest)) if steepest * moved > tolerance else 0
        for _ in range(steps):
            x, last = y - self._value(x, t), x
            moved = _greatest(x - last)
            if steepest * moved <= tolerance:
                break
        return x

    def _value(self, x: Tensor, t: Tensor) -> Tensor:
        return self.push(Jet(torch.cat([x, t], dim=1), None, None, x.shape[1])).value


def _pulled(vectors: Float[Tensor, "n j d"], there: Jet) -> Float[Tensor, "n j d"]:
    """The vectors that the Jacobian in space of a map takes to the given ones."""
    return torch.linalg.solve(there.gradient, vectors, left=False)


def _greatest(vectors: Float[Tensor, "n d"]) -> float:
    """The length of the longest of some vectors; 0 if there are none."""
    return float(vectors.norm(dim=1).amax()) if vectors.numel() else 0.0
