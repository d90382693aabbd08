"""Lifting a trained network of space to one of space and time, and to another frame."""

from __future__ import annotations

import copy
from typing import cast

import numpy as np
import torch

from levelflow.boxes import Frame
from levelflow.networks.siren import SIREN


def lift(network: SIREN, *, time: int = 1, width: int | None = None, generator: torch.Generator | None = None) -> SIREN:
    """A network of space-time, at least as wide, with f(x, t) = g(x) for every t.

    The weights of g stand in the upper left of each layer and its time columns are zero. The added neurons start as
    usual, so that training can put them to use; the blocks that would feed them to those of g, or to the output, start
    at zero.

    Args:
        network: The static network g.
        time: The number of times or parameters to add.
        width: Neurons of a hidden layer; that of g if left out.
        generator: Source of the weights of the added neurons.

    Raises:
        ValueError: If the network already depends on time, or the width is smaller than that of g.

    Reference:
        Novello et al., Neural Implicit Surface Evolution, ICCV 2023, Sec. 4.4 and supplement, Prop. 2.1.
    """
    width = network.width if width is None else width
    if network.times:
        raise ValueError(f"lift: the network already depends on {network.times} time(s); lift a slice, network.at(t).")
    if width < network.width:
        raise ValueError(
            f"lift(width={width}): the network has width {network.width}; lifting cannot make it narrower."
        )
    lifted = SIREN(
        network.space,
        time,
        width=width,
        depth=network.depth,
        omega=network.omega,
        generator=generator,
        dtype=network.last.weight.dtype,
    ).to(network.last.weight.device)
    with torch.no_grad():
        n = network.width
        for new, old in zip(lifted.hidden, network.hidden, strict=True):
            assert isinstance(new, torch.nn.Linear) and isinstance(old, torch.nn.Linear)
            new.weight[:n].zero_()
            new.weight[:n, : old.in_features] = old.weight
            new.bias[:n] = old.bias
        lifted.last.weight.zero_()
        lifted.last.weight[:, :n] = network.last.weight
        lifted.last.bias.copy_(network.last.bias)
    return lifted


def replaced(network: SIREN, old: Frame, new: Frame) -> SIREN:
    r"""The network that stands in the frame `new` for what a static network stands for in the frame `old`.

    With $x = c + s u = c' + s' u'$ it is $\tilde g(u') = (s / s')\, g(u)$, exactly; the first
    and the last layer change.
    """
    moved = copy.deepcopy(network)
    first = cast(torch.nn.Linear, moved.hidden[0])
    shift = (np.array(new.center) - np.array(old.center)) / old.scale
    with torch.no_grad():
        first.bias.add_(first.weight @ first.weight.new_tensor(shift))
        first.weight.mul_(new.scale / old.scale)
        moved.last.weight.mul_(old.scale / new.scale)
        moved.last.bias.mul_(old.scale / new.scale)
    return moved
