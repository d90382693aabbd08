import math

import pytest
import torch
from scipy.special import ellipk

from levelflow import Box, Budget, Cuboid, Sampling
from levelflow.shapes import Cylinder
from levelflow.suite import CASES, Row, Suite, Tube, rows
from levelflow.suite.cases import _enright
from levelflow.suite.films import P_AREA
from levelflow.suite.parameters import _Quadric
from tests.fields import Explicit, points


def test_a_tube_without_waves_has_the_distance_of_a_cylinder(generator):
    x = torch.rand(500, 3, generator=generator, dtype=torch.float64) * 2 - 1
    x[:, 2] *= 0.5
    near = Cylinder(0.4, 20.0).distance(x)
    assert torch.allclose(Tube(0.4, 0.0, 1.0).distance(x), near, atol=1e-12)


def test_samples_of_a_tube_lie_on_it_and_their_normals_are_the_gradients_of_the_distance(generator):
    tube = Tube(0.3, 0.1, 1.0)
    points, normals = tube.sample(300, generator=generator)
    assert tube.distance(points).abs().max() < 1e-5
    step = 1e-3
    assert (tube.distance(points + step * normals) - step).abs().max() < 2e-5
    assert torch.allclose(normals.norm(dim=1), torch.ones(300).double())


def test_enrights_field_is_free_of_divergence_and_odd_in_time(generator):
    x = torch.rand(50, 3, generator=generator, dtype=torch.float64).requires_grad_()
    t = torch.full((50, 1), 0.4, dtype=torch.float64)
    v = _enright(x, t)
    divergence = sum(torch.autograd.grad(v[:, i].sum(), x, retain_graph=True)[0][:, i] for i in range(3))
    assert divergence.abs().max() < 1e-12
    assert torch.allclose(_enright(x, 3 - t), -v)


def test_the_quadric_of_the_heat_equation_has_the_jet_of_its_formula():
    box = Box((-1.0,) * 3, (1.0,) * 3)
    explicit = Explicit(lambda x, t: ((x**2).sum(1) - 0.7**2) / (2 * 0.7), 3)
    x, _ = points(explicit)
    found, expected = (field.jet(x, order=2) for field in (_Quadric(0.7, box), explicit))
    for part in ("value", "first", "second"):
        assert torch.allclose(getattr(found, part), getattr(expected, part), atol=1e-12)


def test_a_row_says_when_a_limit_is_missed():
    assert str(Row("sphere", 0.5, 0.1, 3.0)).endswith("missed")
    assert "missed" not in str(Row("sphere", 0.05, 0.1, 3.0))
    assert "missed" in str(Row("sphere", math.nan, 0.1, 3.0))


def test_the_area_of_the_p_surface_is_that_of_its_weierstrass_representation():
    """2 kappa^2 times the integral of (1 + |w|^2)^2 / |1 - 14 w^4 + w^8| over the plane, for a cell of side 2."""
    assert abs(P_AREA - 3 * ellipk(0.25) / ellipk(0.75)) < 1e-6
    # The plane inside the unit circle is half of it all; in logarithmic rings, eight of which hold a singularity.
    r, u = (torch.arange(4000, dtype=torch.float64) + 0.5 for _ in range(2))
    w = torch.polar(*torch.meshgrid(r / 4000, math.pi / 2 * u / 4000, indexing="ij"))
    density = (1 + w.abs() ** 2) ** 2 / (1 - 14 * w**4 + w**8).abs()
    half = 4 * float((density * w.abs()).sum()) / 4000 * math.pi / 2 / 4000
    assert abs(2 * (2 / ellipk(0.75)) ** 2 * 2 * half / 4 - P_AREA) < 2e-3


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::levelflow.extraction.ExtractionWarning")  # so few steps may leave holes
@pytest.mark.parametrize("case", CASES)
def test_every_case_runs(case):
    suite = Suite(Cuboid((1.0, 0.6, 0.4), radius=0.1), "block", Budget(steps=60), Sampling(n=512, given=5000))
    found = list(rows(suite, [case]))
    assert found and all(row.error >= 0 and row.seconds > 0 for row in found)
