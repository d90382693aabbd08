"""Minimal surfaces, where motion by mean curvature comes to rest: films that are held, and one that fills space."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator

import torch
from torch import Tensor

from levelflow import equations
from levelflow.boxes import Box
from levelflow.networks.periodic import Periodic
from levelflow.networks.siren import SIREN
from levelflow.solving import solve
from levelflow.suite.solids import Level, Tube, Turned
from levelflow.suite.suite import POINTS, Row, Suite, along, at_origin, change, radii, seeded, unit

P_AREA = 2.345103
"""The area of Schwarz's P surface in a cubic cell of side 1, its conventional cell (genus 3): 3 K(1/4) / K(3/4), with
the complete elliptic integral K of the parameter."""


def catenoid(suite: Suite) -> Iterator[Row]:
    r"""A film between two rings of rate 1: a bulge of a catenoid that is held beyond |z| = h comes to rest without it.

    The relative error of the radius, $r = a \cosh(z / a)$, when less than 3e-4 of the bulge is left.
    """
    if suite.solver is not solve:
        return
    a, h = 0.4, 0.25

    def bulging(z: Tensor) -> Tensor:
        return a * torch.cosh(z / a) + 0.08 * (1 - (z / h) ** 2).clamp_min(0) ** 2

    def held(x: Tensor) -> Tensor:
        return ((h - x[:, 2].abs()) / 0.05).clamp(0, 1)

    motion = equations.Regional(equations.MeanCurvature(1.0), held)
    field, seconds = suite.solve(motion, at={0.0: Turned(bulging, 0.5)}, until=0.25)
    for part in (0.0, 0.5, 1.0):
        exact = a * math.cosh(part * h / a)
        error = (radii(field.at(0.25), height=part * h) / exact - 1).abs().max()
        yield Row(f"catenoid, {part:.1f} of the way to a ring, radius", float(error), 0.01, seconds)


def rings(suite: Suite) -> Iterator[Row]:
    """A film between two rings as far from each other as they are wide, too far for a catenoid: it pinches off.

    A cylinder of radius 0.4 that is held beyond |z| = 0.4, of rate 1: the radius of the neck, relative, the time of the
    pinch, and how far the two films that are left have come, each towards its ring. The truths are those of a front of
    the profile r(z, t) with the same mask and, after the pinch, of a grid (to 0.002), in tests/axisymmetric.py. With a
    catenoid half the distance is at most 0.6627 of the radius.
    """
    if suite.solver is not solve:
        return
    radius, half, pinch, neck, film = 0.4, 0.4, 0.114624, 0.273302, 0.376

    def held(x: Tensor) -> Tensor:
        return ((half - x[:, 2].abs()) / 0.05).clamp(0, 1)

    motion = equations.Regional(equations.MeanCurvature(1.0), held)
    field, seconds = suite.solve(motion, at={0.0: Tube(radius, 0.0, half + 0.2)}, until=0.2)
    error = (radii(field.at(0.05), height=0.0) / neck - 1).abs().max()
    yield Row("rings too far apart, t = 0.05, radius of the neck", float(error), 0.01, seconds)
    found = change(lambda t: at_origin(field, t) < 0, 0.0, 0.2)
    yield Row("rings too far apart, pinch, time", abs(found / pinch - 1), 0.01, seconds)
    inside = torch.tensor([[0.0, 0.0, 0.5], [0.0, 0.0, -0.5]], dtype=torch.float64)
    off = 0.5 - along(field.at(0.2), inside, -2 * inside) - film
    yield Row("rings too far apart, t = 0.2, the two films", float(off.abs().max()) / unit(field), 0.01, seconds)


def scherk(suite: Suite) -> Iterator[Row]:
    r"""Scherk's surface $z = \log(\cos x / \cos y)$, held beyond |x|, |y| = 1, comes to rest without a bump of 0.3.

    The greatest error of its height, when 2e-3 of it is left.
    """
    if suite.solver is not solve:
        return
    box = Box((-1.25,) * 3, (1.25,) * 3)

    def height(x: Tensor) -> Tensor:
        return torch.log(torch.cos(x[:, 0]) / torch.cos(x[:, 1]))

    def bumpy(x: Tensor) -> Tensor:
        return x[:, 2] - height(x) - 0.3 * (1 - x[:, :2] ** 2).clamp_min(0).prod(1) ** 2

    def held(x: Tensor) -> Tensor:
        return ((1 - x[:, :2].abs().amax(1)) / 0.1).clamp(0, 1)

    motion = equations.Regional(equations.MeanCurvature(1.0), held)
    field, seconds = suite.solve(motion, at={0.0: Level(bumpy, box)}, until=2.0, box=box)
    x = 2 * torch.rand(2000, 3, generator=seeded(), dtype=torch.float64) - 1
    x[:, 2] = height(x) - 0.5
    found = along(field.at(2.0), x, torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64).expand(2000, 3)) - 0.5
    yield Row("Scherk's surface, height", float(found.abs().max()) / unit(field), 0.01, seconds)


def periodic(suite: Suite) -> Iterator[Row]:
    r"""Schwarz's P surface in its cell of side 2, from a surface of its symmetry whose area is a tenth greater.

    The start changes its sign with a step of half a period along all axes, so that both sides stay as large; without
    that the surface is unstable. The relative error of the area, and the greatest sum of the principal curvatures, in
    units of 1 / half the side of the cell; at the start it is 4.7.
    """
    from levelflow.curvature import total_curvature
    from levelflow.extraction import extract

    if suite.solver is not solve:
        return
    box = Box((-1.0,) * 3, (1.0,) * 3)

    def bent(x: Tensor) -> Tensor:
        c, double = torch.cos(math.pi * x), torch.cos(2 * math.pi * x)
        return c.sum(1) + 0.6 * c.prod(1) + 0.3 * (c * double.roll(-1, dims=1)).sum(1)

    network = Periodic(SIREN(6, 1), axes=(0, 1, 2))
    field, seconds = suite.solve(equations.MeanCurvature(1.0), network, at={0.0: Level(bent, box)}, until=0.2, box=box)
    now = field.at(0.2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that the surface goes on beyond its cell is the point of the row
        surface = extract(now, resolution=96, refine=3)
    yield Row("Schwarz's P surface, area", abs(surface.area / (4 * P_AREA) - 1), 0.005, seconds)
    points = surface.sample(POINTS, generator=seeded()).points
    with torch.no_grad():
        kappa = total_curvature(now.jet(points, order=2)).abs().max()
    yield Row("Schwarz's P surface, curvature", float(kappa), 0.1, seconds)
