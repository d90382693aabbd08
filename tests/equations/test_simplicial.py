"""Concentric circles over simplices: the radius is the barycentric mean of those at the vertices."""

from __future__ import annotations

import math

import pytest
import torch

from levelflow import SIREN, Box, Budget, Circle, Sampling, solve
from levelflow.equations import Morph, SimplicialMorph
from levelflow.shapes import PointCloud
from tests.fields import Explicit

TRIANGLE = ((0.0, 0.0), (2.0, 0.0), (0.0, 1.0))
CIRCLES = (Circle(0.3), Circle(0.5), Circle(0.7))


def mean_radius(x, t):
    """The distance to the circle of radius 0.3 + 0.1 s + 0.4 t, which has the given radii at the vertices."""
    return torch.linalg.vector_norm(x, dim=1) - (0.3 + 0.1 * t[:, 0] + 0.4 * t[:, 1])


def test_radii_are_barycentric_means_on_every_face(generator):
    morph = SimplicialMorph(TRIANGLE, CIRCLES)
    t = morph.draw(400, generator=generator)
    x = 2 * torch.rand(400, 2, generator=generator, dtype=torch.float64) - 1
    jet = Explicit(mean_radius, 2, 2).jet(x, t, order=1)
    for error in (morph.residual(x, t, jet), morph.error(x, t, jet)):
        assert error.detach().abs().max() < 1e-12
    other = SimplicialMorph(TRIANGLE, (Circle(0.3), Circle(0.5), Circle(0.6)))
    assert other.error(x, t, jet).detach().abs().max() > 0.01


def test_samples_lie_on_all_faces_and_each_approaches_its_last_vertex(generator):
    square = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
    morph = SimplicialMorph(square, (*CIRCLES, Circle(0.4)), ((0, 1, 2), (0, 2, 3)))
    t = morph.draw(4000, generator=generator)
    assert ((t > -1e-9) & (t < 1 + 1e-9)).all()
    last = morph.last(t)
    upper, diagonal = t[:, 1] > t[:, 0] + 1e-9, (t[:, 0] - t[:, 1]).abs() < 1e-9
    left, top, bottom = t[:, 0] < 1e-9, t[:, 1] > 1 - 1e-9, t[:, 1] < 1e-9
    assert (last[upper] == 3).all() and (last[diagonal] == 2).all() and (last[bottom & ~diagonal] == 1).all()
    assert min(int(edge.sum()) for edge in (diagonal, left, top, bottom)) > 100
    assert int((~diagonal & ~left & ~top & ~bottom & (t[:, 0] < 1 - 1e-9)).sum()) > 1000


def test_an_edge_is_a_morph_of_its_ends(generator):
    """On the edge from one vertex to another the error is that of `Morph` with the part of the way as time."""
    start, end = Circle(0.4, center=(-0.2, 0.0)), Circle(0.5, center=(0.3, 0.0))
    edge, morph = SimplicialMorph(((0.0,), (1.0,)), (start, end)), Morph(end)
    t = torch.rand(200, 1, generator=generator, dtype=torch.float64)
    x = 2 * torch.rand(200, 2, generator=generator, dtype=torch.float64) - 1
    field = Explicit(lambda x, t: (1 - t[:, 0]) * start.distance(x) + t[:, 0] * end.distance(x) ** 2, 2, 1)
    jet = field.jet(x, t, order=1)
    assert torch.allclose(edge.residual(x, t, jet), (1 - t[:, 0]) * morph.residual(x, t, jet))
    assert torch.allclose(edge.error(x, t, jet), morph.error(x, t, jet))
    assert edge.unit(Box((-2.0, -1.0), (2.0, 1.0), ((0.0, 1.0),))) == 0.25


def test_a_family_over_a_triangle_is_solved():
    morph = SimplicialMorph(TRIANGLE, CIRCLES)
    field = solve(morph, SIREN(2, 2, width=32, depth=2), at=morph.keys, budget=Budget(250), sampling=Sampling(1024))
    assert field.box.times == ((0.0, 2.0), (0.0, 1.0))
    angles = torch.linspace(0, 2 * math.pi, 30, dtype=torch.float64)
    circle = torch.stack([angles.cos(), angles.sin()], dim=1)
    for s, t in (*TRIANGLE, (1.0, 0.0), (1.0, 0.5), (0.0, 0.5), (2 / 3, 1 / 3)):
        assert field.at(s, t)(circle * (0.3 + 0.1 * s + 0.4 * t)).abs().max() < 0.02


@pytest.mark.parametrize(
    ("vertices", "shapes", "simplices", "message"),
    [
        (TRIANGLE, CIRCLES[:2], None, r"vertices of the shape \(3, 2\) and 2 shapes"),
        (((0.0, 0.0),), CIRCLES[:1], None, "give two or more points"),
        (TRIANGLE, CIRCLES, ((0, 3),), r"the simplex \(0, 3\) does not name different vertices from 0 to 2"),
        (TRIANGLE, CIRCLES, ((0, 0, 1),), r"the simplex \(0, 0, 1\) does not name"),
        (((0.0,), (1.0,), (2.0,)), CIRCLES, None, r"the simplex \(0, 1, 2\) is flat: its 3 vertices need 2 dimensions"),
    ],
)
def test_what_is_no_complex_is_refused(vertices, shapes, simplices, message):
    with pytest.raises(ValueError, match=message):
        SimplicialMorph(vertices, shapes, simplices)


def test_a_cloud_is_no_target(unchecked, generator):
    drawn = Circle(0.5).sample(100, generator=generator)
    cloud = PointCloud(drawn.points.numpy(), drawn.normals.numpy())
    with pytest.raises(TypeError, match="a target of type PointCloud has no distance"):
        SimplicialMorph(((0.0,), (1.0,)), (Circle(0.5), cloud))
