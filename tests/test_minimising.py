"""The optimiser loop: what it finds, and that it finds the same bits again."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import pytest
import torch
from torch import Tensor, nn

from levelflow.minimising import Batch, Budget, Divergence, Progress, minimise
from levelflow.networks.siren import SIREN
from tests.fields import siren


@dataclass
class Bowl:
    """|p - goal|^2 with noise that averages out; its least value over p is at the goal."""

    parameter: nn.Parameter
    goal: float = 1.0
    weight: float = 1.0
    name: str = "bowl"
    since: float = 0.0
    until: float = 1.0
    noise: float = 0.01
    drawn: int = 0

    def sample(self, generator: torch.Generator) -> Batch:
        self.drawn += 1
        return (self.noise * torch.randn(8, generator=generator, dtype=torch.float64),)

    def loss(self, *batch: Tensor) -> Tensor:
        return (self.parameter - self.goal).square().sum() + batch[0] * self.parameter.sum()


@dataclass
class Fit:
    """A network is to have the values of sin(3 x) y."""

    network: SIREN
    n: int = 100
    name: str = "fit"
    weight: float = 1.0
    memory: dict[str, Tensor] = field(default_factory=lambda: {"drawn": torch.zeros(())})

    def sample(self, generator: torch.Generator) -> Batch:
        # What is drawn depends on the memory, as that of walkers does.
        self.memory["drawn"] = self.memory["drawn"] + 1
        x = torch.rand(self.n, 2, generator=generator, dtype=torch.float64) / (1 + self.memory["drawn"])
        return x, torch.sin(3 * x[:, 0]) * x[:, 1]

    def loss(self, *batch: Tensor) -> Tensor:
        x, values = batch
        jet = self.network.jet(x, order=2)
        return (jet.value - values) ** 2 + 1e-3 * jet.hessian.square().sum((1, 2))


@dataclass
class Scripted:
    """A loss whose values are told by a function of the step."""

    parameter: nn.Parameter
    at: Callable[[int], float]
    name: str = "scripted"
    weight: float = 1.0
    step: int = 0

    def sample(self, generator: torch.Generator) -> Batch:
        self.step += 1
        return (torch.zeros(4, dtype=torch.float64),)

    def loss(self, *batch: Tensor) -> Tensor:
        return (self.parameter * self.at(self.step)).sum() + batch[0]


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def point(*size: int) -> nn.Parameter:
    return nn.Parameter(torch.zeros(*size, dtype=torch.float64))


def fitted(
    *, steps: int = 24, seed: int = 0, state: dict | None = None, stop: int | None = None
) -> tuple[list[Tensor], dict[str, Tensor], Progress]:
    """The parameters of a network after some steps, the state after `stop` of them, and the progress."""
    network = siren(2, width=8, seed=seed if state is None else 99)
    states: dict[int, dict[str, Tensor]] = {}
    progress = minimise(
        network.parameters(),
        [Fit(network)],
        budget=Budget(steps=steps),
        generator=seeded(5 if state is None else 77),
        on_step=lambda progress: states.update({progress.step: progress.state()}) if progress.step == stop else None,
        state=state,
    )
    return [p.detach() for p in network.parameters()], states.get(stop or 0, {}), progress


def test_the_minimum_of_a_quadratic_is_found() -> None:
    p = point(3, 2)
    progress = minimise([p], [Bowl(p)], budget=Budget(steps=400), generator=seeded(), rate=0.05)
    assert (p - 1).abs().max() < 0.01
    assert progress.step == 400 and progress.spent == 1 and progress.remaining == 0


def test_weights_balance_the_terms() -> None:
    p = point(2, 2)
    terms = [Bowl(p, goal=0.0, weight=3.0, name="near"), Bowl(p, goal=1.0, weight=1.0, name="far")]
    minimise([p], terms, budget=Budget(steps=400), generator=seeded(), rate=0.05)
    assert (p - 0.25).abs().max() < 0.01


def test_losses_are_reported_unweighted() -> None:
    p = point(2, 2)
    progress = minimise([p], [Bowl(p, weight=100.0, noise=0)], budget=Budget(steps=1), generator=seeded())
    assert progress.losses == {"bowl": pytest.approx(4.0)}


def test_parameters_that_need_no_gradient_stay() -> None:
    p, fixed = point(2, 2), point(2, 2).requires_grad_(False)
    minimise([p, fixed], [Bowl(p)], budget=Budget(steps=5), generator=seeded())
    assert (fixed == 0).all() and (p != 0).all()


def test_the_chunk_does_not_change_the_gradient() -> None:
    def gradients(chunk: int | None) -> tuple[list[Tensor], float]:
        network = siren(2, width=8)
        progress = minimise(
            network.parameters(), [Fit(network)], budget=Budget(steps=1), generator=seeded(), chunk=chunk
        )
        return [p.grad for p in network.parameters() if p.grad is not None], progress.losses["fit"]

    small, whole, default = gradients(7), gradients(1000), gradients(None)
    assert len(small[0]) == 6
    for a, b, c in zip(small[0], whole[0], default[0], strict=True):
        assert torch.allclose(a, b, rtol=0, atol=1e-12)
        assert torch.equal(b, c)
    assert small[1] == pytest.approx(whole[1], rel=1e-12)


def test_the_same_seed_gives_the_same_bits() -> None:
    one, two, other = fitted()[0], fitted()[0], fitted(seed=1)[0]
    assert all(torch.equal(a, b) for a, b in zip(one, two, strict=True))
    assert not torch.equal(one[0], other[0])


@pytest.mark.parametrize("stop", [1, 10, 23])
def test_a_run_that_goes_on_from_a_state_ends_with_the_bits_of_one_without_a_break(stop: int) -> None:
    whole, state, progress = fitted(stop=stop)
    resumed, _, again = fitted(state=state)
    assert progress.step == again.step == 24
    assert all(torch.equal(a, b) for a, b in zip(whole, resumed, strict=True))


def test_taking_a_state_does_not_change_the_run_and_the_run_does_not_change_the_state() -> None:
    (plain, _, _), (watched, state, _) = fitted(), fitted(stop=5)
    assert all(torch.equal(a, b) for a, b in zip(plain, watched, strict=True))
    before = {name: value.clone() for name, value in state.items()}
    fitted(state=state)
    assert all(torch.equal(value, before[name]) for name, value in state.items())


def test_a_finished_state_goes_nowhere() -> None:
    whole, state, _ = fitted(stop=24)
    resumed, _, _ = fitted(state=state)
    assert all(torch.equal(a, b) for a, b in zip(whole, resumed, strict=True))


def test_terms_act_in_their_part_of_the_budget() -> None:
    p = point(2, 2)
    early, late = Bowl(p, name="early", until=0.25), Bowl(p, name="late", since=0.25)
    reported: list[list[str]] = []
    minimise(
        [p],
        [early, late],
        budget=Budget(steps=20),
        generator=seeded(),
        on_step=lambda progress: reported.append(sorted(progress.losses)),
    )
    assert (early.drawn, late.drawn) == (5, 15)
    assert reported == [["early"]] * 5 + [["late"]] * 15


def test_every_step_is_reported_with_what_is_spent() -> None:
    p = point(2, 2)
    spent: list[float] = []
    seconds: list[float] = []

    def note(progress: Progress) -> None:
        spent.append(progress.spent)
        seconds.append(progress.seconds)
        assert progress.remaining == pytest.approx(progress.seconds * (1 - progress.spent) / progress.spent)

    minimise([p], [Bowl(p)], budget=Budget(steps=10), generator=seeded(), on_step=note)
    assert spent == pytest.approx([i / 10 for i in range(1, 11)])
    assert seconds == sorted(seconds) and seconds[0] > 0
    assert Progress().remaining == math.inf


def test_a_budget_in_seconds_is_kept() -> None:
    p = point(2, 2)
    started = time.perf_counter()
    progress = minimise([p], [Bowl(p)], budget=Budget(seconds=0.3), generator=seeded())
    assert 0.3 <= time.perf_counter() - started < 1.0
    assert progress.spent == 1 and progress.step > 1


def test_the_seconds_before_an_interruption_count() -> None:
    states = []
    p = point(2, 2)
    budget = Budget(seconds=0.4)
    minimise(
        [p],
        [Bowl(p)],
        budget=budget,
        generator=seeded(),
        on_step=lambda progress: states.append(progress.state()) if progress.spent > 0.75 and not states else None,
    )
    started = time.perf_counter()
    minimise([p], [Bowl(p)], budget=budget, generator=seeded(), state=states[0])
    assert time.perf_counter() - started < 0.35


def test_the_budget_that_ends_first_counts() -> None:
    assert Budget(steps=10, seconds=100).spent(5, 20) == 0.5
    assert Budget(steps=10, seconds=100).spent(2, 60) == 0.6
    assert Budget(steps=10).spent(20, 1e9) == 1
    assert Budget(seconds=10).spent(10**9, 5) == 0.5


@pytest.mark.parametrize("loss", [math.nan, math.inf])
def test_a_loss_that_is_no_number_brings_back_the_last_good_state(loss: float) -> None:
    p = point(3, 2)
    hundredth: list[Tensor] = []

    def note(progress: Progress) -> None:
        if progress.step == 100:
            hundredth.append(p.detach().clone())

    term = Scripted(p, lambda step: 1.0 if step <= 130 else loss)
    with pytest.raises(
        Divergence, match=r"diverged at step 131: the loss of 'scripted' is (nan|-inf), no number\. .*last good state"
    ):
        minimise([p], [term], budget=Budget(steps=300), generator=seeded(), on_step=note)
    assert torch.equal(p, hundredth[0]) and (p != 0).all()


def test_a_gradient_that_is_no_number_is_no_good_state_either() -> None:
    p = point(3, 2)

    @dataclass
    class Kink(Scripted):
        """Finite, with a slope that is not a number from the hundredth step on."""

        def loss(self, *batch: Tensor) -> Tensor:
            zero = torch.zeros_like(self.parameter) * self.parameter if self.step >= 100 else self.parameter**2 + 1
            return zero.sqrt().sum() + batch[0]

    with pytest.raises(Divergence):
        minimise([p], [Kink(p, lambda step: 1.0)], budget=Budget(steps=300), generator=seeded())
    assert p.isfinite().all()


@pytest.mark.parametrize(
    ("budget", "message"),
    [
        ({}, r"Budget\(\): give steps or seconds"),
        ({"steps": 0}, r"Budget\(steps=0, seconds=None\): both must be positive"),
        ({"seconds": 0.0}, r"Budget\(steps=None, seconds=0.0\): both must be positive"),
        ({"steps": 5, "seconds": math.nan}, "both must be positive"),
    ],
)
def test_a_budget_is_positive(budget: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Budget(**budget)


def test_a_loss_that_blows_up_is_a_divergence() -> None:
    class Bursting(Scripted):
        def loss(self, *batch: Tensor) -> Tensor:
            return self.at(self.step) + (self.parameter**2).sum() + batch[0]

    term = Bursting(point(3, 2), lambda step: 1.0 if step <= 40 else 1e6)
    with pytest.raises(Divergence, match=r"diverged at step 41: the loss has grown from 1 to 1e\+06"):
        minimise([term.parameter], [term], budget=Budget(steps=100), generator=seeded())


def test_there_must_be_something_to_optimise() -> None:
    with pytest.raises(ValueError, match="none of the parameters requires a gradient"):
        minimise([point(1, 1).requires_grad_(False)], [], budget=Budget(steps=1), generator=seeded())
