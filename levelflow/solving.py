"""Solving an equation in space-time."""

from __future__ import annotations

import copy
import functools
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict

import torch
from torch import Tensor

from levelflow.bending import Agreement, Bending
from levelflow.boxes import Box, Until, intervals
from levelflow.conditions import BAND, NARROW, Given, Key, OffSurface, OnSurface, Sampling, surface_of
from levelflow.equations.commuting import warn_of_order
from levelflow.equations.equation import Equation
from levelflow.equations.family import Family
from levelflow.equations.volume import VolumePreserving
from levelflow.fields import Placed
from levelflow.measures import accuracy
from levelflow.minimising import DEFAULT_BUDGET, Budget, Divergence, Progress, Term, minimise
from levelflow.motion import Blend, Carried, Clinging, Diffusion, Held, Motion, Outside, Sharpening, Smoothing
from levelflow.networks.lifting import lift, replaced
from levelflow.networks.lipschitz import LipschitzMLP
from levelflow.networks.periodic import Periodic, check_cell
from levelflow.networks.siren import SIREN
from levelflow.steepness import Steepness
from levelflow.transported import reach, reach_of_family

Instant = float | tuple[float | None, ...]
"""A time, or a number for each of several parameters; None stands for all values of one."""


def solve(
    equation: Equation,
    network: SIREN | LipschitzMLP | Periodic,
    *,
    at: Mapping[float, Key] | Mapping[Instant, Key],
    until: Until = None,
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
    field, the given distances are also carried along its characteristics. To a `LipschitzMLP` its regulariser is added
    (`Steepness`); with `Unconstrained` that is all there is between the given shapes.

    Args:
        equation: The motion, in the units of the shapes.
        network: A network of space and one time, or several parameters; it is not changed. One that is `Periodic` in
            time makes a loop of the interval: what is given at one of its ends is so at both.
        at: The shapes or static fields given, by their times. With k parameters a tuple of k numbers says where a shape
            is given, with None in the place of those for all of whose values it is: {(0.0, None): shape}.
        until: The other end of the time interval, or both ends; the interval always contains the times of `at`. Time
            may run backwards from a given shape: then curvature sharpens, which is ill-posed beyond a short while.
            With k parameters, one for each.
        start: A field to start from, such as one fitted to the first shape, or a motion to go on from: its network,
            lifted to space-time and to the width and depth of `network`, replaces that one, frequency and all. Both
            are a `SIREN`.
        box: Where the field is to be valid, in the units of the shapes. If left out, the box of the shapes, carried
            along with the motion where that is possible, and a margin. Its times are not used. The cell of a network
            that is periodic in space must be given.
        budget: Steps, or seconds, of training.
        sampling: How many samples a step draws, and of which kinds.
        warm_up: The part of the budget in which the equation is not yet asked for, only its simplest guess: the given
            shape standing still, or several of them blended. Not used with `start`, nor where the characteristics
            are known, nor without an equation.
        seed: Of every random choice.
        on_step: Called with the progress after each step.
        state: Where an interrupted run goes on from (`Progress.state`).

    Returns:
        The field in the units of the shapes, over the time interval. `provenance["accuracy"]` says, for each time of
        `at`, how far its surface is from the given one.

    Raises:
        TypeError: If what is given is neither a shape nor a field.
        ValueError: If there is no time interval, the network does not fit, or shapes are given at both ends of a loop.
        Divergence: If training fails; its `field` is the last good one.

    Reference:
        Novello et al., Neural Implicit Surface Evolution, ICCV 2023, Secs. 4 and 5.
    """
    if not at:
        raise ValueError("solve(at={}): give at least one shape, such as at={0.0: shape}.")
    if not network.times:
        raise ValueError("solve: the network has 0 times; give one of space and time, SIREN(time=1).")
    instants = [_instant(key, network.times) for key in at]
    _check_driven(equation, instants, network.times)
    if equation.averages and (network.times > 1 or not isinstance(equation, VolumePreserving)):
        raise ValueError(
            f"solve: {equation!r} keeps the volume in one part only; put everything inside, VolumePreserving(a + b)."
        )
    known = [[t[i] for t in instants if not math.isnan(t[i])] for i in range(network.times)]
    ends = intervals(known, until, call="solve")
    if not 0 <= warm_up < 1:
        raise ValueError(f"solve(warm_up={warm_up:g}): give the part of the budget, at least 0 and below 1.")
    if network.loops:
        _check_loop(instants, ends[0])
    check_cell(network, box, call="solve")
    surfaces = [surface_of(key) for key in at.values()]
    if spaces := {surface.box.space for surface in surfaces} - {network.space}:
        raise ValueError(
            f"solve: the network has {network.space} space coordinates, a shape has {spaces.pop()}; "
            "give SIREN(2, 1) for curves in the plane and SIREN(3, 1) for surfaces."
        )
    sharpens = False
    for column in equation.columns:
        first = ends[column.parameter][0]
        given_at = min(known[column.parameter], default=first)
        if column.sharpens and first < given_at:
            sharpens = True
            warnings.warn(
                f"{column!r} sharpens before t = {given_at:g}, which is ill-posed: details and noise grow without "
                f"bound. It is trained back to t = {first:g}; keep such intervals short.",
                stacklevel=2,
            )
    if box is None:
        if network.times == 1 and not isinstance(equation, Family):
            box = reach(equation, {t: s for (t,), s in zip(instants, surfaces, strict=True)}, ends[0])
        else:
            box = reach_of_family(equation, surfaces, instants, ends)
        if equation.averages or equation.bends:
            box = box.cube()  # such a surface may grow where it was thin
    box = box.during(*ends)
    if isinstance(equation, Family):
        since = [min(values, default=first) for values, (first, _) in zip(known, ends, strict=True)]
        warn_of_order(equation, box, since, "Training settles between the two orders.", call="solve")
    generator = torch.Generator().manual_seed(seed)
    if start is not None:
        network = _lifted(start, network, box, generator)
    field = Placed(copy.deepcopy(network), box)
    like = next(field.parameters())
    given = [
        Given.of(key, box, n=sampling.given, generator=generator, like=like, periodic=network.periodic)
        for key in at.values()
    ]
    n, on, off = sampling.counts() if equation.columns else (0, *sampling.shared_out())
    everywhere = any(column.is_rate for column in equation.columns)
    smooths = equation.order > 1 and not sharpens and len(at) == 1 and not everywhere
    band, normal = (math.inf, 0.0) if everywhere else (NARROW, 0.001) if smooths else (BAND, 0.01)
    terms: list[Term] = []
    for instant, samples in zip(instants, given, strict=True):
        now = tuple(field.unit_times(torch.tensor([instant], dtype=torch.float64))[0].tolist())
        terms.append(OnSurface(field.field, samples, now, n=math.ceil(on / len(at)), normal=normal))
        terms.append(OffSurface(field.field, samples, now, n=math.ceil(off / len(at)), band=band))
    if isinstance(field.field, LipschitzMLP):
        terms.append(Steepness(field.field))
    if not equation.columns or start is not None or (network.times > 1 and len(at) > 1):
        warm_up = 0.0
    if equation.columns:
        terms += _motion(
            field, equation, given, instants, n=n, warm_up=warm_up, band=band, everywhere=everywhere, smooths=smooths,
            generator=generator,
        )  # fmt: skip
    bending = [p for term in terms if isinstance(term, Bending) for p in term.kappa.parameters()]
    parameters = [*field.parameters(), *bending]
    try:
        progress = minimise(parameters, terms, budget=budget, generator=generator, on_step=on_step, state=state)
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
        "accuracy": {
            ",".join(":" if math.isnan(t) else f"{t:.15g}" for t in instant): accuracy(
                field.at(*place), surface, seed=seed
            )
            for instant, place, surface in zip(instants, _filled(instants, ends), surfaces, strict=True)
        },
    }
    return field


def _motion(
    field: Placed,
    equation: Equation,
    given: Sequence[Given],
    instants: Sequence[tuple[float, ...]],
    *,
    n: int,
    warm_up: float,
    band: float,
    everywhere: bool,
    smooths: bool,
    generator: torch.Generator,
) -> list[Term]:
    """What asks for the equation: along its characteristics if it has some, else after a first guess."""
    box, alone = field.box, len(given) == 1
    if field.times == 1 and alone and equation.has_characteristics(box.space):
        ((t,),) = instants
        carried = Carried(field, equation, given[0], t, n=n, generator=generator)
        return [carried, Motion(field, equation, n=max(1, n // 4))]
    terms: list[Term] = []
    if warm_up:
        times = [0.0 if math.isnan(t) else t for t, *_ in instants]
        terms.append(Blend(field, given, times, n=n, until=warm_up, band=band))
    held = given[0].where(functools.partial(_held, equation), box)
    if alone and len(held.near):
        terms.append(Held(field, [held], [0.0], n=n // 4, band=band))
    if smooths and not field.periodic and all(column.contracts for column in equation.columns):
        outside = Outside(field, given[0], n=max(1, n // 8), generator=generator)
        terms += [outside] if len(outside.points) else []
    start = given[0].value
    if equation.bends:
        kappa, prepared = _for_curvature(field, generator), warm_up or 0.1
        terms.append(Agreement(field, equation, kappa, n=n, until=prepared))
        motion: Motion = Bending(field, equation, kappa, n=n, since=prepared, start=start)
    elif equation.order > 1 and alone and not everywhere and not equation.averages and not len(held.near):
        motion = (Clinging if smooths else Sharpening)(field, equation, given[0], n=n, since=warm_up)
    else:
        kind = Diffusion if everywhere else Smoothing if smooths else Motion
        motion = kind(field, equation, n=n, since=warm_up, start=start)
    return [*terms, *([motion.volume] if motion.volume is not None else []), motion]


def _for_curvature(field: Placed, generator: torch.Generator) -> SIREN:
    """A network for the curvature of a field, like that of the field itself."""
    network = field.field
    if not isinstance(network, SIREN):
        raise ValueError(
            f"solve: a motion of fourth order has a second network like the first, which must be a SIREN; this is a "
            f"{type(network).__name__}."
        )
    kappa = SIREN(
        network.space, network.times, width=network.width, depth=network.depth, omega=network.omega,
        generator=generator, dtype=field.dtype,
    )  # fmt: skip
    return kappa.to(field.device)


def _instant(key: Instant, k: int) -> tuple[float, ...]:
    """Where a shape is given: k numbers, NaN for those of which it is given for all values."""
    values = key if isinstance(key, tuple) else (key,)
    numbers = [value for value in values if value is not None]
    if not all(math.isfinite(value) for value in numbers):
        raise ValueError(f"solve(at={{{key!r}: ...}}): the times must be finite numbers.")
    if len(values) != k or not numbers:
        raise ValueError(
            f"solve(at={{{key!r}: ...}}): the network has {k} time(s) or parameter(s); give a number for each, or None "
            "for those for all of whose values the shape is given, such as {(0.0, None): shape}."
        )
    return tuple(math.nan if value is None else float(value) for value in values)


def _check_driven(equation: Equation, instants: Sequence[tuple[float, ...]], k: int) -> None:
    """Refuses parameters that the equation does not know, and those with which nothing says how the surface changes."""
    if (needed := 1 + max((column.parameter for column in equation.columns), default=0)) > k:
        raise ValueError(
            f"solve: {equation!r} needs {needed} parameters, and the network has {k}: SIREN(time={needed})."
        )
    driven = equation.drives(k)
    for i in set(range(k)) - driven if driven else ():
        known = {instant[i] for instant in instants if not math.isnan(instant[i])}
        if len(known) == 1:
            raise ValueError(
                f"solve: nothing says how the surface changes with parameter {i}, which is {known.pop():g} wherever a "
                "shape is given. Give a motion for each parameter, Family(...), or None in its place in `at`: then the "
                "shape is given for all of its values."
            )


def _check_loop(instants: Sequence[tuple[float, ...]], ends: tuple[float, float]) -> None:
    """Refuses shapes at both ends of a loop, which are one instant."""
    if {*ends} <= {t for (t,) in instants}:
        first, last = ends
        raise ValueError(
            f"solve: in a loop t = {first:g} and t = {last:g} are the same instant, and a shape is given at both; give "
            f"it at one of them, {{{first:g}: shape}}, and the other by until={last:g}."
        )


def _held(equation: Equation, x: Tensor) -> Tensor:
    """Whether points move with none of the times or parameters, (n,)."""
    moving = [column.held(x) for column in equation.columns if column.is_speed or column.is_rate]
    return torch.stack(moving).all(0) if moving else torch.zeros(len(x), dtype=torch.bool, device=x.device)


def _filled(instants: Sequence[tuple[float, ...]], ends: Sequence[tuple[float, float]]) -> list[tuple[float, ...]]:
    """The instants, with the middle of the interval in the place of what is free."""
    middles = [(first + last) / 2 for first, last in ends]
    return [tuple(m if math.isnan(t) else t for t, m in zip(instant, middles, strict=True)) for instant in instants]


def _lifted(start: Placed, network: SIREN | LipschitzMLP | Periodic, box: Box, generator: torch.Generator) -> SIREN:
    """The network of a field, lifted to space-time, to the size of another network and to another box."""
    if not isinstance(network, SIREN):
        raise ValueError(
            f"solve(start=...): a {type(network).__name__} cannot be lifted from another network; leave start out, or "
            f"give SIREN({network.space}, {network.times})."
        )
    inner = start.field if isinstance(start, Placed) else None
    fits = isinstance(inner, SIREN) and inner.space == network.space and inner.times in (0, network.times)
    if not isinstance(inner, SIREN) or not fits or inner.depth > network.depth or inner.width > network.width:
        raise ValueError(
            "solve(start=...): give a field from fit or solve in the same space, static or with as many times, and a "
            f"network of at most the depth and width of this one ({network.depth} layers, {network.width} wide)."
        )
    moved = replaced(inner, start.box, box)
    added = network.times - inner.times
    lifted = lift(moved, time=added, width=network.width, depth=network.depth, generator=generator)
    return lifted.to(next(network.parameters()).device)
