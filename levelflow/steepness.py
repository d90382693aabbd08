"""How steep a Lipschitz network may be anywhere, as a term of a loss."""

from __future__ import annotations

from torch import Tensor

from levelflow.minimising import Batch
from levelflow.networks.lipschitz import LipschitzMLP


class Steepness:
    r"""The bound $\prod_l e^{c_l}$ of all slopes of a `LipschitzMLP`, in space and time together.

    It is no mean over samples, so its one sample stands for all. A distance in normalised units has a bound of at least
    1, and a network starts with one of some thousands. A greater weight makes smoother ways between the given shapes,
    and rounds these (docs/keyframes.md).

    Reference:
        Liu et al., Learning Smooth Neural Functions via Lipschitz Regularization, SIGGRAPH 2022, Sec. 4.
    """

    name = "steepness"
    weight = 1e-4

    def __init__(self, network: LipschitzMLP) -> None:
        self.network = network

    def sample(self, generator: object) -> Batch:
        return (self.network.c.detach()[:1],)

    def loss(self, *batch: Tensor) -> Tensor:
        return self.network.lipschitz.expand(len(batch[0]))
