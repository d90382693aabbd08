"""Lifting a network of space to one of space and time, wider or deeper, and to another frame."""

from __future__ import annotations

import copy
from typing import cast

import torch
from torch import nn

from levelflow.boxes import Box
from levelflow.networks.siren import SIREN


def lift(
    network: SIREN,
    *,
    time: int = 1,
    width: int | None = None,
    depth: int | None = None,
    slope: float = 0.1,
    generator: torch.Generator | None = None,
) -> SIREN:
    r"""A network of space-time, as wide and deep or more so, with f(x, t) = g(x) for every t.

    The weights of g stand in the upper left of each layer and its time columns are zero. The added neurons start as
    usual, so that training can put them to use; the blocks that would feed them to those of g, or to the output, start
    at zero. To this point f is g exactly.

    Added layers stand between the hidden layers of g and its output. They repeat the neurons $h$ of its last layer as
    $\sin(\lambda h)$, then $\sin(\sin(\lambda h))$ and so on, by the weights $\lambda / \omega$, $1 / \omega$, ... and
    no bias, and the output divides by $\lambda$. For m added layers and output weights w,

    $$|f - g| \le \frac{m \lambda^2}{6} \sum_i |w_i|, \qquad
      |\nabla f - \nabla g| \le \frac{m \lambda^2}{2} \sum_i |w_i|\,|\nabla h_i|,$$

    $$\|\nabla^2 f - \nabla^2 g\| \le m \lambda^2 \sum_i |w_i| (\|\nabla^2 h_i\| / 2 + |\nabla h_i|^2).$$

    Rounding sets no lower limit to $\lambda$, as nothing is subtracted: in float32, f is as close to g as g is to its
    own value from 1e-3 down to 1e-37. Training does: when it moves a weight of an added layer by $\delta$, f moves by
    up to $\omega \delta |w_i| / \lambda$. From 0.1 up, training goes on from g as from any other network, and at 0.01
    its first steps undo what g has learnt. At 0.1 the change of f is about the error of a fit.

    Args:
        network: The network g. One that has times already is made wider or deeper with `time=0`.
        time: The number of times or parameters to add.
        width: Neurons of a hidden layer; that of g if left out.
        depth: Hidden layers; as many as g has if left out.
        slope: The number $\lambda$ of added layers; 1e-3 for a network that is not trained any further.
        generator: Source of the weights of the added neurons.

    Raises:
        ValueError: If a time would be added to a network that has one, the width or depth is smaller than that of g,
            or the slope is not in (0, 1].

    Reference:
        Novello et al., Neural Implicit Surface Evolution, ICCV 2023, Sec. 4.4 and supplement, Sec. 2.
    """
    width = network.width if width is None else width
    depth = network.depth if depth is None else depth
    if time < 0 or (time and network.times):
        raise ValueError(
            f"lift(time={time}): the network depends on {network.times} time(s); give time=0 for a wider or deeper "
            "one, or lift a slice of it, sliced(network, t)."
        )
    if width < network.width:
        raise ValueError(
            f"lift(width={width}): the network has width {network.width}; lifting cannot make it narrower."
        )
    if depth < network.depth:
        raise ValueError(
            f"lift(depth={depth}): the network has depth {network.depth}; lifting cannot make it shallower."
        )
    if not 0 < slope <= 1:
        raise ValueError(f"lift(slope={slope:g}): give a number above 0 and at most 1, such as 0.1.")
    lifted = SIREN(
        network.space,
        network.times + time,
        width=width,
        depth=depth,
        omega=network.omega,
        generator=generator,
        dtype=network.last.weight.dtype,
    ).to(network.last.weight.device)
    n, added = network.width, depth - network.depth
    with torch.no_grad():
        for layer, new in enumerate(cast(list[nn.Linear], lifted.hidden)):
            new.weight[:n].zero_()
            if layer < network.depth:
                old = cast(nn.Linear, network.hidden[layer])
                new.weight[:n, : old.in_features] = old.weight
                new.bias[:n] = old.bias
            else:
                new.weight[:n, :n].fill_diagonal_((slope if layer == network.depth else 1.0) / network.omega)
                new.bias[:n].zero_()
        lifted.last.weight.zero_()
        lifted.last.weight[:, :n] = network.last.weight / (slope if added else 1.0)
        lifted.last.bias.copy_(network.last.bias)
    return lifted


def lifting_error(network: SIREN, *, depth: int, slope: float = 0.1) -> float:
    r"""The bound $m \lambda^2 / 6 \sum_i |w_i|$ of how far values of a network lifted to a depth are from its own."""
    return (depth - network.depth) * slope**2 / 6 * network.last.weight.detach().abs().sum().item()


def replaced(network: SIREN, old: Box, new: Box) -> SIREN:
    r"""The network that stands in the box `new` for what a network stands for in the box `old`.

    With $x = c + s u = c' + s' u'$ it is $\tilde g(u') = (s / s')\, g(u)$, exactly, and the same for times; the first
    and the last layer change.
    """
    moved = copy.deepcopy(network)
    first = cast(nn.Linear, moved.hidden[0])
    (center, size), (new_center, new_size) = (_placement(box, network.times) for box in (old, new))
    with torch.no_grad():
        shift = [(b - a) / s for a, b, s in zip(center, new_center, size, strict=True)]
        first.bias.add_(first.weight @ first.weight.new_tensor(shift))
        first.weight.mul_(first.weight.new_tensor([b / a for a, b in zip(size, new_size, strict=True)]))
        moved.last.weight.mul_(old.frame.scale / new.frame.scale)
        moved.last.bias.mul_(old.frame.scale / new.frame.scale)
    return moved


def _placement(box: Box, times: int) -> tuple[list[float], list[float]]:
    """The place that becomes the origin, and what becomes 1, for each space coordinate and each of the first times."""
    center, scale, intervals = box.frame.center, box.frame.scale, box.times[:times]
    return (
        [*center, *((a + b) / 2 for a, b in intervals)],
        [scale] * len(center) + [(b - a) / 2 or 1.0 for a, b in intervals],
    )
