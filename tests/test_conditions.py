"""What a given shape asks of a field: samples and their values."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from levelflow.boxes import Box
from levelflow.conditions import (
    BAND,
    MARGIN,
    Given,
    OffSurface,
    OnSurface,
    Sampling,
    band_error,
    box_around,
    pick,
    surface_of,
)
from levelflow.fields import Placed
from levelflow.shapes.analytic import Circle
from levelflow.shapes.cloud import PointCloud
from levelflow.shapes.implicit import Implicit
from tests.fields import Explicit, siren

CENTER, RADIUS = (10.0, -4.0), 1.5
CIRCLE = Circle(RADIUS, center=CENTER)
BOX = Box((7, -6), (13, -2))
FIELD = Explicit(lambda x, t: (x - x.new_tensor(CENTER)).norm(dim=1) - RADIUS, 2, box=BOX)
UNIT = Explicit(lambda x, t: x.norm(dim=1) - 0.5, 2, 1)
LIKE = torch.zeros(1, dtype=torch.float64)


def cloud(n: int) -> PointCloud:
    angle = np.linspace(0, 2 * math.pi, n, endpoint=False)
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return PointCloud(np.array(CENTER) + RADIUS * normals, normals)


def given(key: Circle | Explicit | PointCloud, n: int = 4000) -> Given:
    return Given.of(key, BOX, n=n, generator=torch.Generator().manual_seed(0), like=LIKE)


@pytest.mark.parametrize("key", [CIRCLE, FIELD], ids=["solid", "field"])
def test_samples_and_values_are_those_of_the_shape_in_normalised_units(key: Circle | Explicit) -> None:
    samples = given(key)
    assert len(samples.points) == len(samples.normals) == 4000 and len(samples.far) == 1000
    assert (samples.points.norm(dim=1) - 0.5).abs().max() < 1e-4
    assert (samples.normals - 2 * samples.points).abs().max() < 1e-3
    for x, values in ((samples.near, samples.near_values), (samples.far, samples.far_values)):
        assert torch.allclose(values, x.norm(dim=1) - 0.5, rtol=0, atol=1e-12)
        assert not values.requires_grad
    x = BOX.uniform(50, generator=torch.Generator().manual_seed(1))
    assert torch.equal(samples.value(x), key.distance(x) if isinstance(key, Circle) else key(x))


def test_samples_can_be_those_of_a_part_in_the_units_of_the_box() -> None:
    samples = given(CIRCLE)
    left = samples.where(lambda x: x[:, 0] < CENTER[0] - 1, BOX)
    for x, all_of_them in ((left.points, samples.points), (left.near, samples.near), (left.far, samples.far)):
        assert 0 < len(x) < len(all_of_them) and (x[:, 0] < -1 / 3).all()
    assert torch.allclose(left.near_values, left.near.norm(dim=1) - 0.5, rtol=0, atol=1e-12)
    assert len(left.far_values) == len(left.far) and len(left.normals) == len(left.points)


def test_near_samples_are_at_the_distances_that_they_say() -> None:
    samples = given(CIRCLE, 40_000)
    assert 29_800 < len(samples.near) <= 30_000
    close, wide = samples.near_values[:20_000], samples.near_values[20_000:]
    assert close.std() == pytest.approx(0.02, rel=0.03)
    assert wide.std() == pytest.approx(0.1, rel=0.08)


def test_all_samples_lie_in_the_box() -> None:
    samples = Given.of(CIRCLE, CIRCLE.box, n=4000, generator=torch.Generator().manual_seed(0), like=torch.zeros(1))
    sides = torch.tensor([1.0, 1.0]) + 1e-6
    assert len(samples.near) < 3000
    assert (samples.near.abs() <= sides).all() and (samples.far.abs() <= sides).all()
    assert samples.near.dtype == samples.near_values.dtype == torch.float32


def test_the_values_of_a_point_cloud_are_estimated() -> None:
    samples = given(cloud(800))
    for x, values in ((samples.near, samples.near_values), (samples.far, samples.far_values)):
        exact = x.norm(dim=1) - 0.5
        assert (values - exact).abs().max() < 1e-3
        clear = exact.abs() > 1e-3
        assert (values[clear].sign() == exact[clear].sign()).all()


def test_the_estimate_gets_better_with_more_points() -> None:
    errors = []
    for n in (50, 100, 200):
        samples = given(cloud(n))
        errors.append(float((samples.near_values - (samples.near.norm(dim=1) - 0.5)).abs().mean()))
    assert errors[0] > 2 * errors[1] > 4 * errors[2]


def test_on_and_off_the_surface_the_exact_field_has_no_loss(generator: torch.Generator) -> None:
    samples = given(CIRCLE)
    for term in (OnSurface(UNIT, samples, (0.3,), n=64), OffSurface(UNIT, samples, (0.3,), n=64)):
        batch = term.sample(generator)
        assert all(len(part) == 64 for part in batch)
        assert term.loss(*batch).shape == (64,)
        assert term.loss(*batch).detach().abs().max() < 1e-20


def test_on_the_surface_value_and_normal_are_charged(generator: torch.Generator) -> None:
    field = siren(2, 1)
    term = OnSurface(field, given(CIRCLE), (0.3,), n=64)
    x, normals, _ = term.sample(generator)
    jet = field.jet(x, torch.full((64, 1), 0.3, dtype=torch.float64))
    exact = jet.value**2 + term.normal * (jet.gradient - normals).square().sum(1)
    assert torch.allclose(term.loss(x, normals, torch.full((64, 1), 0.3, dtype=torch.float64)), exact)


def test_off_the_surface_a_quarter_of_the_samples_is_drawn_anywhere(generator: torch.Generator) -> None:
    _, values, _ = OffSurface(UNIT, given(CIRCLE), (0.0,), n=4000).sample(generator)
    assert (values[:3000].abs() < 0.1).float().mean() > 0.8
    assert (values[3000:].abs() < 0.1).float().mean() < 0.4
    assert len(OffSurface(UNIT, given(CIRCLE), (0.0,), n=3).sample(generator)[0]) == 3


def test_within_the_band_the_distance_is_asked_for_and_beyond_it_the_sign_and_the_band() -> None:
    cases = [
        (0.1, 0.2, -0.1),
        (0.3, -0.2, 0.5),
        (0.4, 0.9, 0.0),
        (BAND, 0.9, 0.0),
        (0.2, 0.9, 0.2 - BAND),
        (-0.1, 0.9, -0.1 - BAND),
        (-0.9, -0.4, 0.0),
        (-0.2, -0.4, BAND - 0.2),
        (0.1, -0.4, 0.1 + BAND),
    ]
    f, values, error = (torch.tensor(column, dtype=torch.float64) for column in zip(*cases, strict=True))
    assert torch.allclose(band_error(f, values).abs(), error.abs(), rtol=0, atol=1e-15)
    inside = values.abs() <= BAND
    assert torch.allclose(band_error(f, values)[inside], error[inside])


def test_picked_rows_belong_together(generator: torch.Generator) -> None:
    x = torch.arange(10)
    a, b = pick(200, x, x[:, None] * torch.tensor([2, 3]), generator=generator)
    assert torch.equal(b, a[:, None] * torch.tensor([2, 3]))
    assert set(a.tolist()) == set(range(10))


def test_a_field_stands_for_its_zero_set_and_a_shape_for_itself() -> None:
    assert surface_of(CIRCLE) is CIRCLE
    surface = surface_of(FIELD)
    assert isinstance(surface, Implicit) and surface.field is FIELD


def test_a_box_around_boxes_has_a_margin() -> None:
    assert box_around([Box((0, 0), (4, 1)), Box((3, -1), (8, 1))]) == Box(
        (-8 * MARGIN, -1 - 8 * MARGIN), (8 + 8 * MARGIN, 1 + 8 * MARGIN)
    )
    frame = box_around([CIRCLE.box]).frame
    assert RADIUS / frame.scale == pytest.approx(0.8)


def test_samples_are_shared_out_as_said() -> None:
    assert Sampling(n=1000).counts() == (500, 250, 250)
    assert Sampling(n=100, space_time=0, surface=3, volume=1).counts() == (1, 75, 25)


@pytest.mark.parametrize(
    "sampling",
    [
        {"n": 3},
        {"given": 3},
        {"surface": -0.1},
        {"space_time": 0.0, "surface": 0.0, "volume": 0.0},
        {"space_time": math.nan},
    ],
)
def test_a_sampling_has_positive_numbers_and_shares(sampling: dict) -> None:
    ((name, value), *_) = sampling.items()
    with pytest.raises(
        ValueError, match=rf"Sampling\(.*{name}={value}.*\): the numbers must be at least 4, and the shares"
    ):
        Sampling(**sampling)


def test_a_placed_field_can_be_given(generator: torch.Generator) -> None:
    def unit(x: Tensor, t: Tensor) -> Tensor:
        return x.norm(dim=1) - 0.5

    samples = Given.of(Placed(Explicit(unit, 2), BOX), BOX, n=400, generator=generator, like=LIKE)
    assert torch.allclose(samples.far_values, samples.far.norm(dim=1) - 0.5, rtol=0, atol=1e-12)


def test_beyond_the_band_only_the_side_and_a_least_size_are_asked_for():
    f = torch.tensor([0.01, 0.5, 0.04, 0.06, -0.1, -0.05, 0.3], dtype=torch.float64)
    d = torch.tensor([0.02, 0.10, 0.10, 0.10, 0.10, -0.2, 2.0], dtype=torch.float64)
    expected = torch.tensor([-0.01, 0.0, 0.01, 0.0, 0.15, 0.05, 0.0], dtype=torch.float64)
    assert torch.allclose(band_error(f, d, 0.03), expected)
    within = torch.tensor([-0.01, 0.4, -0.06, -0.04, -0.2, 0.15, 0.0], dtype=torch.float64)
    assert torch.allclose(band_error(f, d), within)


def test_where_all_repeats_itself_points_beyond_have_the_values_of_those_within() -> None:
    """A circle that touches the sides of a cell: samples around it come in on the other side."""
    cell = Box((CENTER[0] - RADIUS, -7), (CENTER[0] + RADIUS, -1))
    samples = Given.of(CIRCLE, cell, n=4000, generator=torch.Generator().manual_seed(0), like=LIKE, periodic=(0,))
    dropped = Given.of(CIRCLE, cell, n=4000, generator=torch.Generator().manual_seed(0), like=LIKE)
    assert len(samples.near) == 3000 > len(dropped.near) + 100
    x = cell.frame.from_unit(samples.near)
    assert cell.expanded(1e-9).contains(x).all()
    assert torch.allclose(samples.near_values, CIRCLE.distance(x) / cell.frame.scale, rtol=0, atol=1e-9)
    x = cell.uniform(50, generator=torch.Generator().manual_seed(1))
    assert torch.allclose(samples.value(x + x.new_tensor([2 * RADIUS, 0])), CIRCLE.distance(x), rtol=0, atol=1e-12)
