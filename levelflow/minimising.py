"""The one optimiser loop: terms in, better parameters out."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from dataclasses import field as default
from typing import Any, NoReturn, Protocol, runtime_checkable

import torch
from torch import Tensor, nn

from levelflow.optimising import SOAP

Batch = tuple[Tensor, ...]

_BLOWN_UP = 1e4
"""How many times its size in the first ten steps a loss may reach before training counts as diverged."""


@runtime_checkable
class Term(Protocol):
    """One part of a loss: where it is sampled, and what it charges there.

    A term may have attributes `since` and `until`, the part of the budget in which it acts, `spent`, which is set to
    the part that is used up before each of its samples, and `memory`, tensors that belong to its state.
    """

    name: str
    weight: float

    def sample(self, generator: torch.Generator) -> Batch:
        """A batch: tensors that agree in their first axis."""

    def loss(self, *batch: Tensor) -> Tensor:
        """The non-negative loss of each sample, (n,). It must not depend on the other samples of the batch."""


@dataclass(frozen=True)
class Budget:
    """How long to train: a number of steps, or seconds, whichever ends first.

    Attributes:
        steps: Optimiser steps; None for as many as the seconds allow.
        seconds: Wall-clock time; None for no limit. A budget in seconds takes a different number of steps on each run,
            so only a budget in steps gives the same bits again.

    Raises:
        ValueError: If neither is given, or one is not positive.
    """

    steps: int | None = None
    seconds: float | None = None

    def __post_init__(self) -> None:
        if self.steps is None and self.seconds is None:
            raise ValueError("Budget(): give steps or seconds.")
        if (self.steps is not None and self.steps < 1) or (self.seconds is not None and not self.seconds > 0):
            raise ValueError(f"Budget(steps={self.steps}, seconds={self.seconds}): both must be positive.")

    def spent(self, steps: int, seconds: float) -> float:
        """The part that is used up, from 0 to 1."""
        parts = [steps / self.steps] if self.steps else []
        parts += [seconds / self.seconds] if self.seconds else []
        return min(1.0, max(parts))


DEFAULT_BUDGET = Budget(steps=1200)
"""What `fit` and `solve` take if nothing is said: about a minute on two cores."""


@dataclass
class Progress:
    """Where a minimisation stands; given to `on_step` after each step.

    Attributes:
        step: Steps done.
        spent: The part of the budget that is used up, from 0 to 1.
        seconds: Seconds used, those before an interruption included.
        losses: The unweighted mean loss of each term, smoothed over recent steps.
    """

    step: int = 0
    spent: float = 0.0
    seconds: float = 0.0
    losses: dict[str, float] = default(default_factory=dict)
    _state: Callable[[], dict[str, Tensor]] = dict

    @property
    def remaining(self) -> float:
        """Seconds left at the present rate."""
        return self.seconds * (1 - self.spent) / self.spent if self.spent else math.inf

    def state(self) -> dict[str, Tensor]:
        """Everything needed to go on from here, as tensors: give it to `minimise(state=...)`."""
        return self._state()


class Divergence(RuntimeError):
    """The loss is no longer a number; the parameters are those of the last good state.

    Attributes:
        field: The field at that state, when `fit` or `solve` was at work.
    """

    field: Any = None


def minimise(
    parameters: Iterable[nn.Parameter],
    terms: Sequence[Term],
    *,
    budget: Budget,
    generator: torch.Generator,
    rate: float = 3e-3,
    optimiser: Callable[..., torch.optim.Optimizer] = SOAP,
    chunk: int | None = None,
    on_step: Callable[[Progress], None] | None = None,
    state: Mapping[str, Tensor] | None = None,
) -> Progress:
    """Minimises the weighted sum of the mean losses of the terms by SOAP, with a linear rise and a cosine decay.

    A batch is worked through in chunks that stay in the cache of a CPU; gradients add up, so they do not depend
    on the chunk beyond rounding.

    Args:
        parameters: What is optimised, in place.
        terms: The parts of the loss.
        budget: Steps or seconds.
        generator: Source of every sample.
        rate: The largest learning rate; it decays to a hundredth of it.
        optimiser: What takes the steps, made from the parameters and `lr`.
        chunk: Samples worked on at once; all of them on a GPU and 1024 on a CPU if left out.
        on_step: Called after each step.
        state: Where to go on from, as returned by `Progress.state`.

    Raises:
        ValueError: If there is nothing to optimise.
        Divergence: If a loss or gradient is no number or a loss has blown up; the parameters return to the
            last good state.
    """
    parameters = [p for p in parameters if p.requires_grad]
    if not parameters:
        raise ValueError("minimise: none of the parameters requires a gradient; there is nothing to optimise.")
    chunk = chunk or (1024 if parameters[0].device.type == "cpu" else 1 << 20)
    descent = optimiser(parameters, lr=rate)
    progress = Progress()
    if state is not None:
        _restore(state, parameters, descent, terms, generator, progress)
    good = [p.detach().clone() for p in parameters]
    before_acting: tuple[str, ...] = ()
    since, reference = 0, 0.0
    progress._state = lambda: _state(parameters, descent, terms, generator, progress)
    before, started = progress.seconds, time.perf_counter()

    progress.spent = budget.spent(progress.step, progress.seconds)
    while progress.spent < 1:
        for group in descent.param_groups:
            group["lr"] = rate * _schedule(progress.step, progress.spent)
        descent.zero_grad(set_to_none=True)
        total = 0.0
        acting: tuple[str, ...] = ()
        for term in terms:
            if not getattr(term, "since", 0.0) <= progress.spent < getattr(term, "until", 1.0):
                progress.losses.pop(term.name, None)
                continue
            if hasattr(term, "spent"):
                term.spent = progress.spent
            loss = _accumulate(term, term.sample(generator), chunk)
            if not math.isfinite(loss):
                _revert(parameters, good, f"step {progress.step + 1}: the loss of '{term.name}' is {loss:g}, no number")
            memory = progress.losses.get(term.name, loss)
            progress.losses[term.name] = memory + 0.02 * (loss - memory)
            total += term.weight * loss
            acting += (term.name,)
        if acting != before_acting:
            before_acting, since = acting, progress.step
        if progress.step < since + 10:
            reference = max(total, reference if progress.step > since else 1e-6)
        elif total > _BLOWN_UP * reference:
            _revert(
                parameters, good, f"step {progress.step + 1}: the loss has grown from {reference:.2g} to {total:.2g}"
            )
        slopes = [p.grad.sum() for p in parameters if p.grad is not None]
        if slopes and not math.isfinite(torch.stack(slopes).sum().item()):
            _revert(parameters, good, f"step {progress.step + 1}: the gradient is no number")
        if progress.step % 100 == 0:
            good = [p.detach().clone() for p in parameters]
        descent.step()
        progress.step += 1
        progress.seconds = before + time.perf_counter() - started
        progress.spent = budget.spent(progress.step, progress.seconds)
        if on_step is not None:
            on_step(progress)
    return progress


def _accumulate(term: Term, batch: Batch, chunk: int) -> float:
    """Adds the gradient of the weighted mean loss of a batch to the parameters; returns the unweighted mean."""
    n, total = len(batch[0]), 0.0
    for parts in zip(*(tensor.split(chunk) for tensor in batch), strict=True):
        loss = term.loss(*parts).sum() / n
        (term.weight * loss).backward()
        total += loss.item()
    return total


def _revert(parameters: Sequence[nn.Parameter], good: Sequence[Tensor], what: str) -> NoReturn:
    """Brings back the last good state, and says so."""
    with torch.no_grad():
        for p, last in zip(parameters, good, strict=True):
            p.copy_(last)
    raise Divergence(
        f"Training diverged at {what}. The field is back at its last good state; "
        "lower the learning rate, or shorten the time interval."
    )


def _schedule(step: int, spent: float) -> float:
    """A linear rise over the first 50 steps, then half a cosine down to one hundredth."""
    return min(1.0, (step + 1) / 50) * (0.01 + 0.99 * (1 + math.cos(math.pi * spent)) / 2)


def _state(
    parameters: Sequence[nn.Parameter],
    descent: torch.optim.Optimizer,
    terms: Sequence[Term],
    generator: torch.Generator,
    progress: Progress,
) -> dict[str, Tensor]:
    state = {
        "generator": generator.get_state(),
        "progress": torch.tensor([progress.step, progress.seconds], dtype=torch.float64),
    }
    for i, p in enumerate(parameters):
        state[f"parameter.{i}"] = p.detach().clone()
        for name, value in descent.state.get(p, {}).items():
            state[f"optimiser.{i}.{name}"] = value.detach().clone()
    for i, term in enumerate(terms):
        for name, value in getattr(term, "memory", {}).items():
            state[f"term.{i}.{name}"] = value.clone()
    return state


def _restore(
    state: Mapping[str, Tensor],
    parameters: Sequence[nn.Parameter],
    descent: torch.optim.Optimizer,
    terms: Sequence[Term],
    generator: torch.Generator,
    progress: Progress,
) -> None:
    generator.set_state(state["generator"])
    progress.step, progress.seconds = int(state["progress"][0]), float(state["progress"][1])
    with torch.no_grad():
        for i, p in enumerate(parameters):
            p.copy_(state[f"parameter.{i}"])
            prefix = f"optimiser.{i}."
            descent.state[p] = {
                name.removeprefix(prefix): value.clone() if name.endswith(".step") else value.to(p.device).clone()
                for name, value in state.items()
                if name.startswith(prefix)
            }
    for i, term in enumerate(terms):
        memory = getattr(term, "memory", {})
        for name in memory:
            memory[name] = state[f"term.{i}.{name}"].to(memory[name].device).clone()
