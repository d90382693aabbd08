"""The regulariser of Lipschitz networks as a term of a loss."""

from __future__ import annotations

import torch

from levelflow.minimising import Budget, Term, minimise
from levelflow.steepness import Steepness
from tests.fields import lipschitz


def test_the_term_is_the_bound_and_lowers_it() -> None:
    network = lipschitz(2, 1)
    term, generator = Steepness(network), torch.Generator().manual_seed(0)
    assert isinstance(term, Term)
    before = network.lipschitz.detach()
    (loss,) = term.loss(*term.sample(generator)).detach()
    assert torch.equal(loss, before)
    minimise(network.parameters(), [term], budget=Budget(steps=200), generator=generator)
    assert network.lipschitz < 0.8 * before
