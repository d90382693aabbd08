"""Three minimal surfaces, each where motion by mean curvature comes to rest.

    python examples/minimal_surfaces.py [-o minimal_surfaces.png] [--steps 800]

Two rings too far apart for a film between them: it pinches off, and a film is left on each ring. Scherk's surface,
z = log(cos x / cos y), from a bumpy one that is held at its boundary. Schwarz's P surface, which fills space, in a cell
of a network that is periodic; its area is printed beside the known one, 2.3451 for a cell of side 1.

Reference:
    Novello et al., Neural homotopies (2022), Sec. 4.2.3.
"""

import argparse
import math
import warnings
from collections.abc import Sequence

import numpy as np
import torch

from levelflow import (
    SIREN,
    Box,
    Budget,
    Camera,
    Cylinder,
    Field,
    Level,
    Periodic,
    contact_sheet,
    equations,
    extract,
    solve,
)
from levelflow.rendering.images import stack

CURVATURE = equations.MeanCurvature(rate=1.0)
CUBE = Box((-1.25,) * 3, (1.25,) * 3)
CELL = Box((-1.0,) * 3, (1.0,) * 3)


def rings(budget: Budget) -> Field:
    def between(x: torch.Tensor) -> torch.Tensor:
        return ((0.4 - x[:, 2].abs()) / 0.05).clamp(0, 1)

    held = equations.Regional(CURVATURE, between)
    return solve(held, SIREN(time=1), at={0.0: Cylinder(0.4, 1.2)}, until=0.2, budget=budget)


def height(x: torch.Tensor) -> torch.Tensor:
    return torch.log(torch.cos(x[:, 0]) / torch.cos(x[:, 1]))


def scherk(budget: Budget) -> Field:
    def bumpy(x: torch.Tensor) -> torch.Tensor:
        return x[:, 2] - height(x) - 0.6 * (1 - x[:, :2] ** 2).clamp_min(0).prod(1) ** 2

    def inside(x: torch.Tensor) -> torch.Tensor:
        return ((1 - x[:, :2].abs().amax(1)) / 0.1).clamp(0, 1)

    held = equations.Regional(CURVATURE, inside)
    return solve(held, SIREN(time=1), at={0.0: Level(bumpy, CUBE)}, until=2.0, box=CUBE, budget=budget)


def schwarz(budget: Budget) -> Field:
    def bent(x: torch.Tensor) -> torch.Tensor:
        c, double = torch.cos(math.pi * x), torch.cos(2 * math.pi * x)
        return c.sum(1) + 0.6 * c.prod(1) + 0.3 * (c * double.roll(-1, dims=1)).sum(1)

    network = Periodic(SIREN(6, 1), axes=(0, 1, 2))
    return solve(CURVATURE, network, at={0.0: Level(bent, CELL)}, until=0.2, box=CELL, budget=budget)


def row(title: str, field: Field, times: Sequence[float], box: Box) -> np.ndarray:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that the surfaces end at their boxes
        meshes = [extract(field.at(t), resolution=96, box=box) for t in times]
    camera = Camera.around(np.array([box.lower, box.upper]), azimuth=30, elevation=20, up=(0.0, 0.0, 1.0))
    return contact_sheet(meshes, [f"t = {t:g}" for t in times], title=title, camera=camera, size=300)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", default="minimal_surfaces.png")
    parser.add_argument("--steps", type=int, default=800)
    options = parser.parse_args()
    budget = Budget(options.steps)

    film, saddle, maze = rings(budget), scherk(budget), schwarz(budget)
    x = torch.rand(500, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * 2 - 1
    x[:, 2] = height(x)
    jet = saddle.at(2.0).jet(x, order=1)
    off = (jet.value.detach() / jet.gradient[:, 2].detach()).abs()
    print(f"Scherk's surface: height off by {off.max():.4f} at most")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        area = extract(maze.at(0.2), resolution=96, refine=3).area / 4
    print(f"Schwarz's P surface: area {area:.4f} for a cell of side 1, known 2.3451")
    stack(
        [
            row("a film between rings too far apart", film, (0.0, 0.08, 0.12, 0.2), film.box),
            row("Scherk's surface, held at its boundary", saddle, (0.0, 0.1, 0.4, 2.0), CUBE),
            row("Schwarz's P surface, two cells a side", maze, (0.0, 0.02, 0.06, 0.2), Box((-1.0,) * 3, (3.0,) * 3)),
        ],
        options.output,
    )
    print(options.output)


if __name__ == "__main__":
    main()
