"""Solving an equation in space-time."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict

import torch
from torch import Tensor

from levelflow.boxes import Box
from levelflow.conditions import BAND, NARROW, Given, Key, OffSurface, OnSurface, Sampling, surface_of
from levelflow.equations.equation import Equation
from levelflow.fields import Placed
from levelflow.measures import accuracy
from levelflow.minimising import DEFAULT_BUDGET, Budget, Divergence, Progress, Term, minimise
from levelflow.motion import Blend, Carried, Motion
from levelflow.networks.lifting import lift, replaced
from levelflow.networks.siren import SIREN
from levelflow.transported import reach


def solve(
    equation: Equation,
    network: SIREN,
    *,
    at: Mapping[float, Key],
    until: float | Sequence[float] | None = None,
    start: Placed | None = None,
    box: Box | None = None,
    budget: Budget = DEFAULT_BUDGET,
    sampling: Sampling = Sampling(),  # noqa: B008
    warm_up: float = 0.25,
    seed: int = 0,
    on_step: Callable[[Progress], None] | None = None,
    state: Mapping[str, Tensor] | None = None,
) -> Placed:
    r"""Solves an equation in space-time, subject to shapes given at some times.

    The network f(x, t) is trained to vanish on the given surfaces at their times, with the given distances around them,
    and to satisfy the equation near its moving zero set in between. Where the equation is a motion by a velocity
    field, the given distances are also carried along its characteristics.

    Args:
        equation: The motion, in the units of the shapes.
        network: A network of space and one time; it is not changed.
        at: The shapes or static fields given, by their times.
        until: The other end of the time interval, or both ends; the interval always contains the times of `at`. Time
            may run backwards from a given shape: then curvature sharpens, which is ill-posed beyond a short while.
        start: A field to start from, such as one fitted to the first shape, or a motion to go on from: its network,
            lifted to space-time and to the width and depth of `network`, replaces that one, frequency and all.
        box: Where the field is to be valid, in the units of the shapes. If left out, the box of the shapes, carried
            along with the motion where that is possible, and a margin.
        budget: Steps, or seconds, of training.
        sampling: How many samples a step draws, and of which kinds.
        warm_up: The part of the budget in which the equation is not yet asked for, only its simplest guess: the given
            shape standing still, or several of them blended. Not used with `start`, nor where the characteristics
            are known.
        seed: Of every random choice.
        on_step: Called with the progress after each step.
        state: Where an interrupted run goes on from (`Progress.state`).

    Returns:
        The field in the units of the shapes, over the time interval. `provenance["accuracy"]` says, for each time of
        `at`, how far its surface is from the given one.

    Raises:
        TypeError: If what is given is neither a shape nor a field.
        ValueError: If there is no time interval, or the network does not fit.
        Divergence: If training fails; its `field` is the last good one.

    Reference:
        Novello et al., Neural Implicit Surface Evolution, ICCV 2023, Secs. 4 and 5.
    """
    interval = _interval(at, until)
    if network.times != 1:
        raise ValueError(f"solve: the network has {network.times} times; give one of space and time, SIREN(time=1).")
    if not 0 <= warm_up < 1:
        raise ValueError(f"solve(warm_up={warm_up:g}): give the part of the budget, at least 0 and below 1.")
    surfaces = {t: surface_of(key) for t, key in at.items()}
    if spaces := {surface.box.space for surface in surfaces.values()} - {network.space}:
        raise ValueError(
            f"solve: the network has {network.space} space coordinates, a shape has {spaces.pop()}; "
            "give SIREN(2, 1) for curves in the plane and SIREN(3, 1) for surfaces."
        )
    if equation.sharpens and interval[0] < min(at):
        warnings.warn(
            f"{equation!r} sharpens before t = {min(at):g}, which is ill-posed: details and noise grow without bound. "
            f"It is trained back to t = {interval[0]:g}; keep such intervals short.",
            stacklevel=2,
        )
    box = (box or reach(equation, surfaces, interval)).during(interval)
    generator = torch.Generator().manual_seed(seed)
    if start is not None:
        network = _lifted(start, network, box, generator)
    field = Placed(copy.deepcopy(network), box)
    like = next(field.parameters())
    given = {t: Given.of(key, box, n=sampling.given, generator=generator, like=like) for t, key in at.items()}
    n, on, off = sampling.counts()
    band = NARROW if equation.order > 1 else BAND
    terms: list[Term] = []
    for t, samples in given.items():
        now = tuple(field.unit_times(torch.tensor([[t]], dtype=torch.float64))[0].tolist())
        terms.append(OnSurface(field.field, samples, now, n=math.ceil(on / len(at))))
        terms.append(OffSurface(field.field, samples, now, n=math.ceil(off / len(at)), band=band))
    if len(at) == 1 and equation.has_characteristics(box.space):
        ((t, samples),) = given.items()
        terms.append(Carried(field, equation, samples, t, n=n, generator=generator))
        terms.append(Motion(field, equation, n=max(1, n // 4)))
    else:
        warm_up = 0.0 if start is not None else warm_up
        if warm_up:
            terms.append(Blend(field, list(given.values()), list(given), n=n, until=warm_up, band=band))
        terms.append(Motion(field, equation, n=n, since=warm_up))
    try:
        progress = minimise(field.parameters(), terms, budget=budget, generator=generator, on_step=on_step, state=state)
    except Divergence as error:
        error.field = field
        raise
    field.provenance = {
        "verb": "solve",
        "equation": repr(equation),
        "seed": seed,
        "steps": progress.step,
        "budget": asdict(budget),
        "sampling": asdict(sampling),
        "warm_up": warm_up,
        "accuracy": {f"{t:.15g}": accuracy(field.at(t), surface, seed=seed) for t, surface in surfaces.items()},
    }
    return field


def _interval(at: Mapping[float, Key], until: float | Sequence[float] | None) -> tuple[float, float]:
    """The times from the first to the last of those given and asked for."""
    ends = () if until is None else until if isinstance(until, Sequence) else (until,)
    times = [float(t) for t in (*at, *ends)]
    if not at:
        raise ValueError("solve(at={}): give at least one shape, such as at={0.0: shape}.")
    if not all(math.isfinite(t) for t in times):
        raise ValueError(f"solve: the times {times} must be finite numbers.")
    if min(times) == max(times):
        raise ValueError(f"solve: all is given at t = {times[0]:g}; say how far to go with until=...")
    return min(times), max(times)


def _lifted(start: Placed, network: SIREN, box: Box, generator: torch.Generator) -> SIREN:
    """The network of a field, lifted to space-time, to the size of another network and to another box."""
    inner = start.field if isinstance(start, Placed) else None
    fits = isinstance(inner, SIREN) and inner.space == network.space and inner.times <= 1
    if not isinstance(inner, SIREN) or not fits or inner.depth > network.depth or inner.width > network.width:
        raise ValueError(
            "solve(start=...): give a field from fit or solve in the same space, with at most one time and a network "
            f"of at most the depth and width of this one ({network.depth} layers, {network.width} wide)."
        )
    moved = replaced(inner, start.box, box)
    lifted = lift(moved, time=1 - inner.times, width=network.width, depth=network.depth, generator=generator)
    return lifted.to(next(network.parameters()).device)
