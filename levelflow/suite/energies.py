"""Flows of energies and of meshes: Willmore's flow, curvature that keeps the volume, and fields that follow a mesh."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import torch

from levelflow import equations, flows
from levelflow.boxes import Box
from levelflow.curvature import mean_curvature
from levelflow.evolution import evolve
from levelflow.extraction import extract
from levelflow.fields import Field
from levelflow.shapes import Capsule, Sphere, Torus
from levelflow.solving import solve
from levelflow.suite.suite import POINTS, Row, Suite, radii, seeded

BENT_RING = {0.0: (0.25, 0.75, 7.25520), 0.001: (0.20028, 0.75082, 6.77213), 0.002: (0.16400, 0.74891, 6.50609)}
"""A torus R = 0.5, r = 0.25 under Willmore flow of rate 1: its least and greatest radius, and its energy over pi, by
times; those of a spectral front, to all digits (tests/axisymmetric.py). It tends to R = sqrt(2) r and 2 pi."""


def willmore(suite: Suite) -> Iterator[Row]:
    """Willmore flow: what stands still, a torus on its way to Clifford's, and a capsule that becomes round."""
    if suite.solver is not solve:
        return
    flow = equations.Willmore(1.0)
    field, seconds = suite.solve(flow, at={0.0: Sphere(0.4)}, until=0.002)
    error = max(float((radii(field.at(t)) / 0.4 - 1).abs().max()) for t in (0.0, 0.001, 0.002))
    yield Row("sphere, Willmore flow, radius", error, 5e-3, seconds)
    clifford = Torus(0.5, 0.5 / math.sqrt(2))
    snug = Box((-0.9,) * 3, (0.9,) * 3)
    field, seconds = suite.solve(flow, at={0.0: clifford}, until=0.002, box=snug)
    yield Row("Clifford's torus, energy", abs(_energy(field, 0.002) / (2 * math.pi**2) - 1), 5e-3, seconds)
    low, high = _rims(field, 0.002)
    yield Row("Clifford's torus, R / r", abs((high + low) / (high - low) / math.sqrt(2) - 1), 0.02, seconds)
    field, seconds = suite.solve(flow, at={0.0: Torus(0.5, 0.25)}, until=max(BENT_RING), box=snug)
    for t, (low, high, energy) in BENT_RING.items():
        found = _rims(field, t)
        error = max(abs(found[0] - low), abs(found[1] - high)) / 0.9
        yield Row(f"torus R = 2 r, Willmore flow, t = {t:g}, radii", error, 5e-3, seconds)
        yield Row(
            f"torus R = 2 r, Willmore flow, t = {t:g}, energy",
            abs(_energy(field, t) / math.pi / energy - 1),
            0.01,
            seconds,
        )
    field, seconds = suite.solve(flow, at={0.0: Capsule(0.3, 0.5)}, until=0.01)
    yield Row("capsule, Willmore flow to the end, energy", abs(_energy(field, 0.01) / (4 * math.pi) - 1), 0.01, seconds)
    r = radii(field.at(0.01))
    yield Row("capsule, Willmore flow to the end, roundness", float((r / r.mean() - 1).abs().max()), 0.02, seconds)


def volume(suite: Suite) -> Iterator[Row]:
    """Mean curvature that keeps the volume: a sphere stands still, a capsule becomes the ball of its volume."""
    if suite.solver is not solve:
        return
    motion = equations.VolumePreserving(equations.MeanCurvature(1.0))
    field, seconds = suite.solve(motion, at={0.0: Sphere(0.5)}, until=0.05)
    error = max(float((radii(field.at(t)) / 0.5 - 1).abs().max()) for t in (0.0, 0.025, 0.05))
    yield Row("sphere, curvature at its volume, radius", error, 1.5e-3, seconds)
    capsule = Capsule(0.3, 0.5)
    whole = math.pi * 0.3**2 * 0.5 + 4 / 3 * math.pi * 0.3**3
    field, seconds = suite.solve(motion, at={0.0: capsule}, until=0.25)
    found = [extract(field.at(t), resolution=144, refine=3).volume for t in (0.0, 0.05, 0.1, 0.175, 0.25)]
    yield Row("capsule, curvature at its volume, volume", max(abs(v / whole - 1) for v in found), 1e-3, seconds)
    ball = (3 * whole / (4 * math.pi)) ** (1 / 3)
    error = float((radii(field.at(0.25)) / ball - 1).abs().max())
    yield Row("capsule, curvature at its volume, end, radius", error, 0.01, seconds)


def followed(suite: Suite) -> Iterator[Row]:
    """Fields that follow the mean curvature flow of their mesh: a sphere and a torus, by the mean of their radii."""
    if suite.solver is not solve:
        return
    static, _ = suite.fit(Sphere(0.5))
    started = time.perf_counter()
    field: Field = evolve(static, flows.MeanCurvature(0.1), dt=0.0125, steps=20, seed=suite.seed)
    seconds = time.perf_counter() - started
    error = abs(float(radii(field.at(0.25)).mean()) / math.sqrt(0.25 - 4 * 0.1 * 0.25) - 1)
    yield Row("sphere, following its mesh, radius", error, 5e-3, seconds)
    slopes = _slopes(field, 0.25)
    yield Row("sphere, following its mesh, |grad f| - 1", float((slopes - 1).abs().max()), 0.05, seconds)


def _rims(field: Field, t: float) -> tuple[float, float]:
    """The least and the greatest distance of the surface from the z axis."""
    mesh = extract(field.at(t), resolution=96, refine=3)
    rho = torch.from_numpy(mesh.vertices.copy())[:, :2].norm(dim=1)
    return float(rho.min()), float(rho.max())


def _energy(field: Field, t: float) -> float:
    """The integral of H^2."""
    mesh = extract(field.at(t), resolution=96, refine=3)
    points = mesh.sample(POINTS, generator=seeded()).points
    with torch.no_grad():
        bend = mean_curvature(field.at(t).jet(points, order=2)).double()
    return float((bend**2).mean()) * mesh.area


def _slopes(field: Field, t: float) -> torch.Tensor:
    """|grad f| at the vertices of the surface."""
    mesh = extract(field.at(t), resolution=64, refine=3)
    with torch.no_grad():
        return field.at(t).jet(torch.from_numpy(mesh.vertices.copy()), order=1).gradient.norm(dim=1)
