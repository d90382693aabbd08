"""What each choice in `solve` is worth: the correctness suite with one of them changed at a time.

    python benchmarks/ablations.py [VARIANT ...] [--cases sphere dumbbell] [--steps 600]

A line for each variant, with the rows of the cases: the greatest error of the rows of the same title up to its first
comma (the sphere's radius at six times is one number). Everything else is as by default, seeds included.
"""

from __future__ import annotations

import argparse
import functools
import math
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack
from unittest import mock

import torch

import levelflow.solving
import levelflow.suite.suite
from levelflow import SIREN, Budget, Cuboid
from levelflow.conditions import BAND
from levelflow.equations import LevelSetEquation
from levelflow.minimising import minimise
from levelflow.motion import Clinging, Motion
from levelflow.optimising import SOAP
from levelflow.shapes.implicit import NoSurface
from levelflow.suite import CASES, Suite, rows

Change = Callable[[], AbstractContextManager[object]]


def motion(**changed: float) -> list[Change]:
    """Other constants of the term that asks for the equation."""
    return [functools.partial(mock.patch.object, Clinging, name, value) for name, value in changed.items()]


def anywhere() -> list[Change]:
    """Walkers and samples that are not bound to the given surface."""
    return [functools.partial(mock.patch.object, Clinging, "_anywhere", Motion._anywhere)]


def network(**changed: float) -> list[Change]:
    """Another start of the network."""
    return [functools.partial(mock.patch.object, levelflow.suite.suite, "SIREN", functools.partial(SIREN, **changed))]


def optimiser(kind: Callable[..., torch.optim.Optimizer], rate: float) -> list[Change]:
    """Another optimiser."""
    other = functools.partial(minimise, optimiser=kind, rate=rate)
    return [functools.partial(mock.patch.object, levelflow.solving, "minimise", other)]


def raw() -> list[Change]:
    """The residual instead of the error of the speed."""
    return [functools.partial(mock.patch.object, LevelSetEquation, "error", LevelSetEquation.residual)]


VARIANTS: Mapping[str, list[Change]] = {
    "default": [],
    "Adam, rate 1e-3": optimiser(torch.optim.Adam, 1e-3),
    "Adam, rate 1e-4": optimiser(torch.optim.Adam, 1e-4),
    "SOAP, rate 1e-2": optimiser(SOAP, 1e-2),
    "frequency 30": network(omega=30.0),
    "frequency 15": network(omega=15.0),
    "time weights 0.1": network(time_scale=0.1),
    "time weights 1": network(time_scale=1.0),
    "raw residual": raw(),
    "walkers from anywhere": [*motion(near=0.8, noise=0.03), *anywhere()],
    "samples anywhere": [*motion(near=0.0), *anywhere()],
    "noise 0.06": motion(noise=0.06),
    "noise 0.03": motion(noise=0.03),
    "noise 0.01": motion(noise=0.01),
    "weight 1": motion(weight=1.0),
    "distance within 0.25": [functools.partial(mock.patch.object, levelflow.solving, "NARROW", BAND)],
    "errors not relative to curvature": motion(bend=0.0),
    "errors relative from radius 0.3": motion(bend=0.3),
    "knee at 0.1": motion(knee=0.1),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("variants", nargs="*", default=[], metavar="VARIANT", help=f"all by default: {list(VARIANTS)}")
    parser.add_argument("--cases", nargs="*", choices=CASES, default=["sphere", "dumbbell"])
    parser.add_argument("--steps", type=int, default=600)
    options = parser.parse_args()
    if unknown := set(options.variants) - set(VARIANTS):
        parser.error(f"there is no variant {', '.join(sorted(unknown))}; known are {', '.join(VARIANTS)}")
    suite = Suite(Cuboid((1.0, 0.6, 0.4), radius=0.1), "cuboid", Budget(options.steps))
    print(f"{options.steps} steps, {torch.get_num_threads()} threads, PyTorch {torch.__version__}")
    for name in options.variants or VARIANTS:
        errors: dict[str, float] = {}
        with ExitStack() as changed:
            for change in VARIANTS[name]:
                changed.enter_context(change())
            for case in options.cases:
                try:
                    for row in rows(suite, [case]):
                        title = ", ".join(part for part in row.title.split(", ") if not part.startswith("t = "))
                        errors[title] = max(errors.get(title, 0.0), row.error)
                except NoSurface:
                    errors[case] = math.inf
        print(f"{name:<34}" + "; ".join(f"{title} {error:.5f}" for title, error in errors.items()), flush=True)


if __name__ == "__main__":
    main()
