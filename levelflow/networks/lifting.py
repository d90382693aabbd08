"""Lifting a trained network of space to one of space and time."""

from __future__ import annotations

import torch

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
