"""A soap film between two rings: mean curvature with a fixed region comes to rest as a catenoid.

    python examples/soap_film.py [-o soap_film.png] [--steps 1200]

A cylinder is held above and below two planes. Between them it shrinks by mean curvature; in the end its neck has the
radius a of r = a cosh(z / a), which is printed beside what was found: the network rounds the creases at the rings, and
the film is a per cent too narrow.

Reference:
    Novello et al., Neural homotopies (2022), Sec. 4.2.3.
"""

import argparse
import math

import torch

from levelflow import SIREN, Budget, Camera, Cylinder, contact_sheet, equations, extract, solve

RADIUS, HALF, UNTIL = 0.5, 0.2, 0.12


def between(x: torch.Tensor) -> torch.Tensor:
    """1 between the rings, 0 beyond them."""
    return ((HALF - x[:, 2].abs()) / 0.05).clamp(0, 1)


def catenoid() -> float:
    """The greater a with a cosh(HALF / a) = RADIUS."""
    low, high = HALF, RADIUS
    for _ in range(60):
        a = (low + high) / 2
        low, high = (a, high) if a * math.cosh(HALF / a) < RADIUS else (low, a)
    return low


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", default="soap_film.png")
    parser.add_argument("--steps", type=int, default=1200)
    options = parser.parse_args()

    film = equations.Regional(equations.MeanCurvature(rate=1.0), between)
    tube = Cylinder(RADIUS, 1.0)
    field = solve(film, SIREN(time=1), at={0.0: tube}, until=UNTIL, budget=Budget(options.steps))

    times = (0.0, 0.01, 0.03, UNTIL)
    meshes = [extract(field.at(t), resolution=96) for t in times]
    points = meshes[-1].vertices
    neck = points[abs(points[:, 2]) < 0.02]
    print(f"radius of the neck: {((neck[:, :2] ** 2).sum(1) ** 0.5).mean():.4f}, of the catenoid: {catenoid():.4f}")
    camera = Camera.around(meshes[0].vertices, azimuth=30, elevation=15, up=(0.0, 0.0, 1.0))
    contact_sheet(
        meshes, [f"t = {t:g}" for t in times], options.output, camera=camera, title="a film between two rings"
    )
    print(options.output)


if __name__ == "__main__":
    main()
