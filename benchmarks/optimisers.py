"""SOAP against Adam: where the surface is after the same number of steps.

    python benchmarks/optimisers.py [--steps 600] [--seeds 2]

Two problems with known answers, at frequencies from 10 to 30 and the learning rates that suit each optimiser: a sphere
under mean curvature (greatest error of the radius at six times) and a turned rounded cuboid (mean distance at the end).
Lengths are in normalised units; the best of the rates is shown, averaged over the seeds, with the seconds of a run.
"""

from __future__ import annotations

import argparse
import functools
import math
import time
from collections.abc import Callable
from unittest import mock

import torch

import levelflow.solving
from levelflow import SIREN, Budget, Cuboid, Placed, Sphere, equations, solve
from levelflow.minimising import minimise
from levelflow.optimising import SOAP
from levelflow.shapes.implicit import Implicit

OPTIMISERS: dict[str, tuple[Callable[..., torch.optim.Optimizer], tuple[float, ...]]] = {
    "SOAP": (SOAP, (3e-3,)),
    "Adam": (torch.optim.Adam, (1e-3, 3e-3)),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--width", type=int, default=64)
    options = parser.parse_args()
    print(f"{'problem':<20}{'omega':>6}  {'optimiser':<10}{'error':>10}{'seconds':>9}")
    for title, problem in (("sphere, curvature", sphere), ("cuboid, rotation", cuboid)):
        for omega in (10.0, 30.0):
            for name, (optimiser, rates) in OPTIMISERS.items():
                errors, started = [], time.perf_counter()
                for rate in rates:
                    # `solve` takes its optimiser from `minimise`; here another one is put in its place.
                    other = functools.partial(minimise, optimiser=optimiser, rate=rate)
                    with mock.patch.object(levelflow.solving, "minimise", other):
                        runs = [
                            problem(SIREN(time=1, width=options.width, omega=omega), options.steps, seed)
                            for seed in range(options.seeds)
                        ]
                    errors.append(sum(runs) / len(runs))
                seconds = (time.perf_counter() - started) / len(rates) / options.seeds
                print(f"{title:<20}{omega:>6.0f}  {name:<10}{min(errors):>10.5f}{seconds:>9.0f}", flush=True)


def sphere(network: SIREN, steps: int, seed: int) -> float:
    """The greatest error of the radius of a shrinking sphere."""
    field = solve(
        equations.MeanCurvature(0.1), network, at={0.0: Sphere(0.5)}, until=0.5, budget=Budget(steps=steps), seed=seed
    )
    errors = []
    for i in range(6):
        radii = torch.linalg.vector_norm(_points(field, i / 10), dim=1)
        errors.append((radii - math.sqrt(0.25 - 0.04 * i)).abs().max() / field.box.frame.scale)
    return float(max(errors))


def cuboid(network: SIREN, steps: int, seed: int) -> float:
    """The mean distance of a cuboid turned by 90 degrees."""
    shape, motion = Cuboid((1.0, 0.6, 0.4), radius=0.1), equations.Transport(equations.Rotation(math.pi / 2))
    field = solve(motion, network, at={0.0: shape}, until=1.0, budget=Budget(steps=steps), seed=seed)
    points = _points(field, 1.0)
    back = motion.carry(points, torch.ones(len(points)).double(), torch.zeros(len(points)).double())
    return float(shape.distance(back).abs().mean()) / field.box.frame.scale


def _points(field: Placed, t: float) -> torch.Tensor:
    return Implicit(field.at(t)).sample(4000, generator=torch.Generator().manual_seed(1)).points


if __name__ == "__main__":
    main()
