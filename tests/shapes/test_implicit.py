"""The zero sets of fields as shapes."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from levelflow.boxes import Box
from levelflow.fields import Placed
from levelflow.shapes.implicit import Implicit
from tests.fields import Explicit, periodic, siren

A, B = 1.0, 0.6
ELLIPSE = Explicit(lambda x, t: (x[:, 0] / A) ** 2 + (x[:, 1] / B) ** 2 - 1, 2, box=Box((-1.2, -1.2), (1.2, 1.2)))


def test_samples_lie_on_the_surface_with_its_outward_normals(generator: torch.Generator) -> None:
    x, n = Implicit(ELLIPSE).sample(5000, generator=generator)
    assert x.shape == n.shape == (5000, 2) and x.dtype == torch.float64
    assert not x.requires_grad and not n.requires_grad
    assert ELLIPSE(x).abs().max() < 1e-4
    exact = torch.nn.functional.normalize(x / torch.tensor([A**2, B**2]), dim=1)
    assert (n - exact).abs().max() < 1e-4


def test_samples_are_spread_evenly_by_length(generator: torch.Generator) -> None:
    x, _ = Implicit(ELLIPSE).sample(20_000, generator=generator)
    fine = np.linspace(-math.pi, math.pi, 20_001)
    length = np.concatenate([[0], np.cumsum(np.hypot(np.diff(A * np.cos(fine)), np.diff(B * np.sin(fine))))])
    angle = torch.atan2(x[:, 1] / B, x[:, 0] / A).numpy()
    place = np.interp(angle, fine, length / length[-1])
    share = np.histogram(place, bins=16, range=(0, 1))[0] / len(x) * 16
    assert np.abs(share - 1).max() < 0.1


def test_a_circle_is_sampled_at_every_angle_alike(generator: torch.Generator) -> None:
    circle = Explicit(lambda x, t: torch.exp(x[:, 0]) * ((x * x).sum(1) - 0.25), 2, box=Box((-1, -1), (1, 1)))
    x, _ = Implicit(circle).sample(20_000, generator=generator)
    share = torch.histc(torch.atan2(x[:, 1], x[:, 0]), bins=8, min=-math.pi, max=math.pi) / len(x) * 8
    assert (share - 1).abs().max() < 5 * math.sqrt(8 / len(x)) + 0.02


def test_the_same_seed_gives_the_same_samples() -> None:
    one, two = (Implicit(ELLIPSE).sample(100, generator=torch.Generator().manual_seed(3)) for _ in range(2))
    assert torch.equal(one.points, two.points)


def test_the_box_is_that_of_the_surface_and_a_little_more() -> None:
    box = Implicit(ELLIPSE).box
    exact = np.array([A, B])
    assert (np.array(box.upper) >= exact - 1e-4).all() and (np.array(box.upper) <= exact + 0.03).all()
    assert (np.array(box.lower) <= -exact + 1e-4).all() and (np.array(box.lower) >= -exact - 0.03).all()


def test_a_box_that_is_given_is_where_the_surface_is_looked_for(generator: torch.Generator) -> None:
    x, _ = Implicit(ELLIPSE, box=Box((0, 0), (2, 2))).sample(500, generator=generator)
    assert (x >= 0).all()


def test_the_gap_of_a_distance_is_the_distance(generator: torch.Generator) -> None:
    box = Box((-1, -1), (1, 1))
    circle = Explicit(lambda x, t: 3 * (x.norm(dim=1) - 0.5), 2)
    x = box.uniform(100, generator=generator)
    assert torch.allclose(Implicit(circle, box=box).gap(x), (x.norm(dim=1) - 0.5).abs())


def test_a_field_in_units_far_from_the_origin_is_sampled_as_well(generator: torch.Generator) -> None:
    field = Placed(Explicit(lambda x, t: x.norm(dim=1) - 0.5, 2), Box((1e6, 0), (1e6 + 2, 2)))
    x, _ = Implicit(field).sample(500, generator=generator)
    assert ((x - torch.tensor([1e6 + 1, 1.0], dtype=torch.float64)).norm(dim=1) - 0.5).abs().max() < 1e-6


def test_a_field_without_a_zero_in_the_box_has_no_samples(generator: torch.Generator) -> None:
    def positive(x: Tensor, t: Tensor) -> Tensor:
        return (x * x).sum(1) + 1

    for box in (Box((-1, -1), (1, 1)), Box((5, 5), (6, 6))):
        with pytest.raises(ValueError, match=r"no zero in the box .* surface has vanished or lies outside"):
            Implicit(Explicit(positive, 2), box=box).sample(10, generator=generator)


def test_a_field_of_time_is_sliced_first() -> None:
    with pytest.raises(ValueError, match=r"the field depends on 1 time\(s\); give a slice, Implicit\(f.at\(t\)\)"):
        Implicit(siren(2, 1))


def test_a_field_without_a_box_needs_one() -> None:
    with pytest.raises(
        ValueError, match=r"the field has no box; say where its surface is with Implicit\(field, box=...\)"
    ):
        Implicit(siren(2))


@pytest.mark.parametrize("radius", [0.05, 0.01])
def test_a_surface_that_fills_little_of_the_box_is_found(generator: torch.Generator, radius: float) -> None:
    ball = Explicit(lambda x, t: x.norm(dim=1) - radius, 3, 0, box=Box((-1.0,) * 3, (1.0,) * 3))
    points, normals = Implicit(ball).sample(500, generator=generator)
    assert torch.allclose(points.norm(dim=1), torch.full((500,), radius).double(), rtol=1e-3)
    assert points.mean(0).norm() < 0.2 * radius
    assert torch.allclose(normals, points / points.norm(dim=1, keepdim=True), atol=1e-6)


def test_beyond_its_cell_a_field_goes_on_as_it_repeats_itself() -> None:
    field = Placed(periodic(2, axes=(1,)), Box((0.0, -1.0), (4.0, 3.0)))
    x = torch.tensor([[1.0, 0.5], [1.0, 4.5], [1.0, -7.5], [5.0, 4.5]]).double()
    values = Implicit(field).value(x)
    assert torch.allclose(values[:3], field(x[:1]).expand(3), rtol=0, atol=1e-12)
    assert torch.allclose(values[3], field(torch.tensor([[4.0, 0.5]]).double()) + 1.0, rtol=0, atol=1e-12)


def test_beyond_its_box_a_field_goes_on_as_the_distance_to_the_box() -> None:
    ball = Explicit(lambda x, t: x.norm(dim=1) - 0.5, 2, 0, box=Box((-1.0, -1.0), (1.0, 1.0)))
    x = torch.tensor([[0.2, 0.0], [3.0, 0.0], [1.0, -2.0]]).double()
    expected = torch.tensor([-0.3, 0.5 + 2.0, math.sqrt(2) - 0.5 + 1.0]).double()
    assert torch.allclose(Implicit(ball).value(x), expected)
