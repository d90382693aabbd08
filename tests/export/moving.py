"""Moving surfaces whose place, velocity and topology are known exactly."""

import torch

from levelflow import Box
from tests.fields import Explicit

START, GROWTH = 0.5, 0.25


def radius(t):
    """Of `growing` at a time; the sphere is born at t = -2."""
    return START + GROWTH * t


def growing(center=(0.0, 0.0, 0.0), *, steepness=3.0, space=3):
    """A sphere r = 0.5 + 0.25 t around a point; f is no distance, |grad f| is `steepness`."""
    middle = torch.tensor(center[:space], dtype=torch.float64)

    def f(x, t):
        return steepness * (torch.linalg.vector_norm(x - middle, dim=1) - radius(t[:, 0]))

    box = Box(center[:space], center[:space]).expanded(1.0).during((-4.0, 1.0))
    return Explicit(f, space, 1, box=box)


def splitting():
    """One body that becomes two at t = 0.375, along x: y^2 + z^2 + (x^2 - 1/4)^2 = (1 - t) / 10."""

    def f(x, t):
        return x[:, 1] ** 2 + x[:, 2] ** 2 + (x[:, 0] ** 2 - 0.25) ** 2 - 0.1 * (1 - t[:, 0])

    return Explicit(f, 3, 1, box=Box((-1.0, -0.5, -0.5), (1.0, 0.5, 0.5), ((0.0, 0.8),)))
