"""Solids of a formula, against those with an exact distance."""

import math

import pytest
import torch

from levelflow import Box, Level, Torus
from levelflow.shapes import Circle

SQUARE = Box((-1.0, -1.0), (1.0, 1.0))


def disc(x):
    """Not a distance: its gradient is 2 |x|."""
    return (x * x).sum(1) - 0.25


def test_the_distance_is_right_to_first_order(generator):
    solid, circle = Level(disc, SQUARE), Circle(0.5)
    points, normals = circle.sample(200, generator=generator)
    errors = []
    for step in (0.04, 0.02):
        near = points + step * normals
        errors.append(float((solid.distance(near) - circle.distance(near)).abs().max()))
    assert errors[1] < 5e-4 and math.log2(errors[0] / errors[1]) > 1.9
    assert solid.distance(points).abs().max() < 1e-15
    x = SQUARE.uniform(200, generator=generator)
    assert torch.equal(solid.distance(x).sign(), circle.distance(x).sign())
    assert (
        solid.distance(torch.zeros(1, 2)).isfinite().all() and solid.distance(torch.zeros(1, 2)).dtype == torch.float32
    )


def test_samples_lie_on_the_surface_nearly_uniformly_with_its_normals(generator):
    ring = Torus(0.6, 0.25)
    box = Box((-1.0,) * 3, (1.0,) * 3)
    solid = Level(lambda x: ((x * x).sum(1) + 0.36 - 0.0625) ** 2 - 4 * 0.36 * (x[:, :2] ** 2).sum(1), box)
    points, normals = solid.sample(8000, generator=generator)
    assert points.shape == normals.shape == (8000, 3) and solid.box == box
    assert ring.distance(points).abs().max() < 1e-9
    assert torch.allclose(ring.distance(points + 0.1 * normals), torch.full((8000,), 0.1).double())
    outer = (points[:, :2].norm(dim=1) > 0.6).double().mean()
    exact = 0.5 + 0.25 / (0.6 * math.pi)
    assert abs(outer - exact) < 0.03


def test_the_surface_ends_at_the_sides_of_the_box(generator):
    box = Box((-0.4, -1.0), (0.4, 1.0))
    points, _ = Level(disc, box).sample(500, generator=generator)
    assert box.contains(points).all() and points[:, 0].abs().max() > 0.39


def test_a_box_without_a_surface_is_refused(generator):
    with pytest.raises(ValueError, match=r"Level.sample: the formula has \(almost\) no zero in the box from \(2.0"):
        Level(disc, Box((2.0, 2.0), (3.0, 3.0))).sample(10, generator=generator)
