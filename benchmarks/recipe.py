"""A rival: the published recipe for neural evolutions. How long does each take to a given error of the surface?

    python benchmarks/recipe.py [PROBLEM ...] [--seconds 600] [--every 10] [--width 128] [--points 10000] [--mesh FILE]

The recipe is trained for the given time, and the surface measured every few seconds of it. Its best error and the first
time it was reached are noted, and so are two and four times that error. Then `levelflow.solve` runs with its default
settings and 50, 100, 200, 400, 800 and 1200 steps until it is at or below the best; each level has the seconds of the
shortest run that meets it, preparation included. Time for measuring does not count. Threads are those of
OMP_NUM_THREADS.

The recipe is written from the papers, not from their code: a SIREN of frequency 30, its weights those of a fitted
static field where one shape is given; Adam with the rate 1e-4; a quarter of each batch on the surface and a quarter in
the volume at the given time, the rest in space-time; the sum of squares of distances, normals and the raw residual, by
nested automatic differentiation. The box and the interval of time are normalised as for `levelflow.solve`, and
distances are those of the shape, not of the fitted field.

References:
    Novello et al., Neural Implicit Surface Evolution, ICCV 2023, Sec. 4 and supplement.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

import levelflow
from levelflow import SIREN, Box, Budget, Cuboid, Field, Mesh, Placed, Sampling, Sphere
from levelflow.boxes import interval
from levelflow.conditions import Given, Key, pick, surface_of
from levelflow.equations import Equation, LevelSetEquation, MeanCurvature, Morph, Rotation, Transport
from levelflow.equations.equation import Motions
from levelflow.jets import Jet
from levelflow.measures import accuracy
from levelflow.networks.lifting import lift
from levelflow.shapes.implicit import NoSurface
from levelflow.shapes.shape import Solid
from levelflow.suite.suite import mean_distance, radii
from levelflow.transported import reach

OMEGA = 30.0
RATE = 1e-4
STEPS = (50, 100, 200, 400, 800, 1200)
"""Budgets that ours is given in turn."""


@dataclass(frozen=True)
class Weights:
    """Weights of the squares in the loss: of distances, of one minus the cosine of normals, and of the residual."""

    distance: float
    normal: float
    residual: float


CURVATURE = Weights(2e3, 1e1, 1e3)
TRANSPORT = Weights(5e3, 5e2, 1e3)
MORPH = Weights(1e4, 1e1, 1e1)


def solve(
    equation: Equation,
    network: SIREN,
    *,
    at: Mapping[float, Key],
    until: float | Sequence[float] | None = None,
    box: Box | None = None,
    budget: Budget = Budget(seconds=600),  # noqa: B008
    sampling: Sampling = Sampling(n=10_000),  # noqa: B008
    fitting: float = 0.1,
    seed: int = 0,
    on_step: Callable[[int, float, Placed], None] | None = None,
    **ignored: object,
) -> Placed:
    """Trains a field by the published recipe, behind the call of `levelflow.solve`.

    Args:
        equation: A motion, or a sum of motions.
        network: Gives the coordinates, the width and the depth; weights and frequency are the recipe's.
        at: As for `levelflow.solve`.
        until: As for `levelflow.solve`; negative times sharpen.
        box: As for `levelflow.solve`.
        budget: Steps, or seconds, those of the fit included.
        sampling: The batch.
        fitting: The part of the budget in which a static field of half the width is fitted to the shape, if only one
            is given; the network starts from it.
        seed: Of every random choice.
        on_step: Called after each step but those of the fit, with the steps, the seconds and the field as it stands.
        ignored: What only `levelflow.solve` takes.

    Raises:
        TypeError: If the equation is no motion by curvature, velocities, morphs and speeds of first order.
    """
    motions = equation.motions if isinstance(equation, Motions) else (equation,)
    if not all(isinstance(m, LevelSetEquation) and (m.order < 2 or isinstance(m, MeanCurvature)) for m in motions):
        raise TypeError(f"recipe.solve: {equation!r} is no sum of motions by curvature, velocities, speeds of order 1.")
    clock = Clock(budget)
    ends = interval(at, until, call="solve")
    surfaces = {t: surface_of(key) for t, key in at.items()}
    box = (box or reach(equation, surfaces, ends)).during(ends)
    generator = torch.Generator().manual_seed(seed)
    like = network.last.weight
    given = {t: Given.of(key, box, n=sampling.given, generator=generator, like=like) for t, key in at.items()}
    weights = TRANSPORT
    for kind, others in ((Morph, MORPH), (MeanCurvature, CURVATURE)):
        weights = others if any(isinstance(m, kind) for m in motions) else weights

    def train(field: Placed, spent: float) -> None:
        descent = torch.optim.Adam(field.parameters(), lr=RATE)
        while clock.spent < spent:
            descent.zero_grad(set_to_none=True)
            loss(field, motions, given, weights, sampling, generator).backward()
            descent.step()
            clock.tick()
            if on_step is not None and field.times:
                with clock.stopped() as seconds:
                    on_step(clock.steps, seconds, field)

    new = {"depth": network.depth, "omega": OMEGA, "generator": generator, "dtype": like.dtype}
    if len(at) == 1 and fitting:
        static = SIREN(network.space, width=max(1, network.width // 2), **new)
        train(Placed(static, box.during()), fitting)
        start = lift(static, width=network.width, generator=generator)
    else:
        start = SIREN(network.space, 1, width=network.width, time_scale=1.0, **new)
    field = Placed(start, box)
    train(field, 1.0)
    field.provenance = {
        "verb": "recipe",
        "equation": repr(equation),
        "steps": clock.steps,
        "seconds": clock.seconds,
        "accuracy": {f"{t:.15g}": accuracy(field.at(t), surface, seed=seed) for t, surface in surfaces.items()},
    }
    return field


class Clock:
    """The part of a budget that is used up; it can be stopped."""

    def __init__(self, budget: Budget) -> None:
        self.budget, self.steps, self._started = budget, 0, time.perf_counter()

    @property
    def seconds(self) -> float:
        return time.perf_counter() - self._started

    @property
    def spent(self) -> float:
        return self.budget.spent(self.steps, self.seconds)

    def tick(self) -> None:
        self.steps += 1

    @contextmanager
    def stopped(self) -> Iterator[float]:
        """Takes no time off the budget; gives the seconds used so far."""
        stopped = time.perf_counter()
        yield stopped - self._started
        self._started += time.perf_counter() - stopped


def loss(
    field: Placed,
    motions: Sequence[LevelSetEquation],
    given: Mapping[float, Given],
    weights: Weights,
    sampling: Sampling,
    generator: torch.Generator,
) -> Tensor:
    """The loss of a batch in normalised coordinates: of a static field without the equation."""
    n, on, off = sampling.counts()
    on, off = math.ceil(on / len(given)), math.ceil(off / len(given))
    surface = [pick(on, g.points, g.normals, generator=generator) for g in given.values()]
    volume = [pick(off, g.far, g.far_values, generator=generator) for g in given.values()]
    moments = torch.tensor(list(given), dtype=torch.float64)
    now = torch.cat([moments.repeat_interleave(on), moments.repeat_interleave(off)])[:, None]
    x, normal = (torch.cat(part) for part in zip(*surface, strict=True))
    off_surface, distance = (torch.cat(part) for part in zip(*volume, strict=True))
    distance = torch.cat([torch.zeros_like(x[:, 0]), distance])
    x = torch.cat([x, off_surface])
    t = field.unit_times(now.expand(-1, field.times)).to(x)
    if field.times:
        half = torch.tensor(field.box.size, dtype=torch.float64) / 2 / field.box.frame.scale
        anywhere = 2 * torch.rand(n, field.space + 1, generator=generator, dtype=torch.float64) - 1
        x, t = torch.cat([x, (anywhere[:, :-1] * half).to(x)]), torch.cat([t, anywhere[:, -1:].to(x)])
    value, first, kappa = nested(field.field, x, t, order=max((m.order for m in motions if field.times), default=1))
    off_angle = 1 - F.cosine_similarity(first[: len(normal), : field.space], normal, dim=1)
    total = weights.distance * ((value[: len(distance)] - distance) ** 2).sum() / len(x)
    total = total + weights.normal * off_angle.sum() / len(x)
    if field.times:
        total = total + weights.residual * (residual(field, motions, x, t, value, first, kappa) ** 2).mean()
    return total


def nested(
    field: Field, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], *, order: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Value, first derivatives and, with order 2, div n, each differentiated from the one before; zeros without."""
    d = x.shape[1]
    z = torch.cat([x, t], dim=1).requires_grad_()
    value = field(z[:, :d], z[:, d:])
    (first,) = torch.autograd.grad(value.sum(), z, create_graph=True)
    if order < 2:
        return value, first, torch.zeros_like(value)
    normal = first[:, :d] / torch.linalg.vector_norm(first[:, :d], dim=1, keepdim=True)
    columns = [torch.autograd.grad(normal[:, i].sum(), z, create_graph=True)[0][:, i] for i in range(d)]
    return value, first, torch.stack(columns).sum(0)


def residual(
    field: Placed,
    motions: Sequence[LevelSetEquation],
    x: Float[Tensor, "n d"],
    t: Float[Tensor, "n k"],
    value: Float[Tensor, " n"],
    first: Float[Tensor, "n m"],
    kappa: Float[Tensor, " n"],
) -> Float[Tensor, " n"]:
    r"""The raw residual $f_t + v\,|\nabla f|$ in the coordinates of the network.

    A morph has the form of the original, $f_t - \frac12 (g - f)\, e^{-f^2}\, |\nabla f|$, which does not know when to
    arrive: only the shapes given at its ends tell it.
    """
    scale, (begin, end) = field.box.frame.scale, field.box.times[0]
    half = (end - begin) / 2
    norm = torch.linalg.vector_norm(first[:, : field.space], dim=1)
    jet = field.in_units(Jet(value, first, None, field.space))
    points, times = field.box.frame.from_unit(x), field.times_in_units(t)
    change = first[:, field.space]
    for motion in motions:
        if isinstance(motion, MeanCurvature):
            change = change - motion.rate * half / scale**2 * kappa * norm
        elif isinstance(motion, Morph):
            _, remaining, _ = motion._next(times)
            gap = -motion.speed(points, times, jet) * remaining / scale
            change = change - 0.5 * gap * torch.exp(-(value**2)) * norm
        else:
            change = change + motion.speed(points, times, jet) * half / scale * norm
    return change


@dataclass(frozen=True)
class Problem:
    """An evolution whose answer is known.

    Attributes:
        title: What is compared.
        equation: The motion.
        at: The given shapes.
        until: The end of the time interval.
        error: The error of the surface of a field.
    """

    title: str
    equation: Equation
    at: Mapping[float, Solid]
    until: float | None
    error: Callable[[Placed], float]


def problems(solid: Solid, name: str) -> dict[str, Problem]:
    """What the script compares; the solid is the one that is rotated."""

    def radius(field: Placed) -> float:
        exact = [(i / 10, math.sqrt(0.25 - 0.04 * i)) for i in range(6)]
        return max(float((radii(field.at(t)) / r - 1).abs().max()) for t, r in exact)

    def ends(field: Placed) -> float:
        exact = ((0.0, 0.4), (1.0, 0.8))
        return max(float((radii(field.at(t)) - r).abs().max()) for t, r in exact) / field.box.frame.scale

    rotation = Transport(Rotation(math.pi / 2, center=solid.box.center))

    def distance(field: Placed) -> float:
        return max(mean_distance(field, t, solid, rotation) for t in (0.0, 0.5, 1.0))

    return {
        "sphere": Problem(
            "sphere, mean curvature, greatest radius error", MeanCurvature(0.1), {0.0: Sphere(0.5)}, 0.5, radius
        ),
        "rotation": Problem(f"{name} turned by 90 degrees, mean distance", rotation, {0.0: solid}, 1.0, distance),
        "morph": Problem(
            "concentric spheres morphed, radius at the ends", Morph(Sphere(0.8)),
            {0.0: Sphere(0.4), 1.0: Sphere(0.8)}, None, ends,
        ),
    }  # fmt: skip


def measured(problem: Problem, field: Placed) -> float:
    """The error, infinite where there is no surface."""
    try:
        error = problem.error(field)
    except NoSurface:
        return math.inf
    return error if math.isfinite(error) else math.inf


def recorded(
    problem: Problem, network: SIREN, *, points: int, seconds: float, every: float
) -> list[tuple[float, float]]:
    """Seconds and errors of the recipe on its way, with a batch of so many points."""
    record: list[tuple[float, float]] = []

    def on_step(step: int, at: float, field: Placed) -> None:
        if at >= every * (1 + len(record)):
            record.append((at, measured(problem, field)))

    field = solve(
        problem.equation,
        network,
        at=problem.at,
        until=problem.until,
        budget=Budget(seconds=seconds),
        sampling=Sampling(n=points),
        on_step=on_step,
    )
    return [*record, (field.provenance["seconds"], measured(problem, field))]


def ours(problem: Problem, network: SIREN, error: float) -> list[tuple[float, float]]:
    """Seconds and errors of runs of growing budgets, up to the first that is at or below the error."""
    runs = []
    for steps in STEPS:
        started = time.perf_counter()
        field = levelflow.solve(
            problem.equation, network, at=problem.at, until=problem.until, budget=Budget(steps=steps)
        )
        runs.append((time.perf_counter() - started, measured(problem, field)))
        if runs[-1][1] <= error:
            break
    return runs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problems", nargs="*", help="sphere, rotation, morph; all if none is named")
    parser.add_argument("--seconds", type=float, default=600, help="training time of the recipe for each problem")
    parser.add_argument("--every", type=float, default=10, help="seconds of training between measurements")
    parser.add_argument("--width", type=int, default=128, help="of both networks")
    parser.add_argument("--depth", type=int, default=3, help="of both networks")
    parser.add_argument("--points", type=int, default=10_000, help="in a batch of the recipe")
    parser.add_argument("--mesh", type=Path, help="what is rotated instead of a rounded cuboid")
    options = parser.parse_args()
    solid: Solid = Mesh.read(options.mesh) if options.mesh else Cuboid((1.0, 0.6, 0.4), radius=0.1)
    known = problems(solid, options.mesh.stem if options.mesh else "cuboid")
    if unknown := [name for name in options.problems if name not in known]:
        parser.error(f"{', '.join(unknown)}: no such problem; choose from {', '.join(known)}.")
    size = f"{options.depth} hidden layers of {options.width}"
    print(f"{size}, {torch.get_num_threads()} threads, PyTorch {torch.__version__}")
    print(f"{'problem':<48}{'error':>10}{'recipe':>9}{'ours':>9}{'ratio':>8}   seconds; its error and steps")
    for name in options.problems or known:
        problem, network = known[name], SIREN(time=1, width=options.width, depth=options.depth)
        record = recorded(problem, network, points=options.points, seconds=options.seconds, every=options.every)
        best = min(error for _, error in record)
        runs = ours(problem, network, best)
        for level in (4 * best, 2 * best, best):
            theirs = next(seconds for seconds, error in record if error <= level)
            met = next((i for i, (_, error) in enumerate(runs) if error <= level), None)
            if met is None:
                rest = f"{'-':>9}{'-':>8}   not reached: {min(e for _, e in runs):.5f} at best"
            else:
                seconds, error = runs[met]
                rest = f"{seconds:>9.0f}{theirs / seconds:>8.1f}   {error:.5f} after {STEPS[met]} steps"
            print(f"{problem.title:<48}{level:>10.5f}{theirs:>9.0f}{rest}", flush=True)


if __name__ == "__main__":
    main()
