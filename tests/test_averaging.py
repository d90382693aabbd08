"""Means over surfaces that are known, and volumes that are kept."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from levelflow.averaging import Volume, with_means
from levelflow.boxes import Box
from levelflow.equations import MeanCurvature, VolumePreserving
from levelflow.fields import Placed
from levelflow.jets import Jet
from tests.fields import Explicit

BOX = Box((-2.0, -2.0), (2.0, 2.0)).during((0.0, 1.0))
MOTION = VolumePreserving(MeanCurvature(0.1))


def placed(radius: float, growth: float) -> Placed:
    """A circle of the radius r + g t in the units of a box of half size 2, with the slope 3."""
    return Placed(Explicit(lambda x, t: 3 * x.norm(dim=1) - 3 * (radius + growth * (t[:, 0] + 1) / 2) / 2, 2, 1), BOX)


def volume_of(field: Placed) -> Volume:
    def jet(z: Tensor) -> Jet:
        return volume.placed.in_units(volume.placed.field.jet(z[:, :2], z[:, 2:], order=2))

    volume = Volume(field, MOTION, placed(1.0, 0.0).at(0.0), jet=jet)
    return volume


def test_the_mean_of_the_curvature_of_a_circle(generator: torch.Generator) -> None:
    field = placed(1.0, 0.0)
    volume = volume_of(field)
    volume.measure(generator)
    motion = volume.equation
    assert motion.reach == pytest.approx(1.0, rel=2e-3)  # twice the area over the circumference
    # A circle of the level s has the radius 1 + s / 3, whatever time it is.
    assert motion.levels == pytest.approx([-0.3, -0.15, 0.0, 0.15, 0.3], rel=2e-3)
    expected = [-0.1 / (1 + s / 3) for s in motion.levels]
    for means in motion.means:
        assert means == pytest.approx(expected, rel=5e-3)
    assert motion.times[-1] == 1.0
    x = torch.tensor([[1.0, 0.0]], dtype=torch.float64)
    assert motion.speed(x, x[:, :1], field.jet(x, x[:, :1], order=2)).abs().max() < 1e-2


def test_a_volume_that_has_gone_astray_is_brought_back(generator: torch.Generator) -> None:
    volume = volume_of(placed(1.0, 0.1))
    volume.measure(generator)
    excess = (math.pi * 1.1**2 - math.pi) / (2 * math.pi * 1.1)
    assert volume.equation.means[-1][2] == pytest.approx(-0.1 / 1.1 + volume.pull * excess, rel=2e-2)


def test_the_loss_is_the_square_of_the_excess_also_when_the_field_has_changed(generator: torch.Generator) -> None:
    volume = volume_of(placed(1.0, 0.1))
    volume.measure(generator)
    before = volume.loss(*volume.sample(generator)).detach()
    assert before[0] < 1e-7
    assert before[-1].sqrt() == pytest.approx((1.1**2 - 1) / (2 * 1.1) / 2, rel=1e-2)  # in half sides of the box
    volume.placed = placed(1.02, 0.1)
    after = volume.loss(*volume.sample(generator)).detach() ** 0.5
    assert after.tolist() == pytest.approx((before**0.5 + 0.01).tolist(), abs=2e-4)


def test_it_looks_every_few_steps_and_what_is_measured_later_counts_for_a_share(generator: torch.Generator) -> None:
    volume = volume_of(placed(1.0, 0.0))
    volume.look(generator)
    first = volume.equation.means
    volume.placed = placed(0.8, 0.0)
    for _ in range(volume.every - 1):
        volume.look(generator)
    assert volume.equation.means == first
    volume.look(generator)
    excess = (0.8**2 - 1) / (2 * 0.8)
    then = -0.1 / 0.8 + volume.pull * excess
    assert volume.equation.means[0][2] == pytest.approx(-0.1 + volume.share * (then + 0.1), rel=1e-2)


def test_what_has_vanished_has_no_mean_and_is_asked_for_nothing(generator: torch.Generator) -> None:
    volume = volume_of(placed(1.0, -2.0))
    volume.measure(generator)
    assert not any(volume.equation.means[-1])
    assert all(volume.equation.means[0])
    assert volume.loss(*volume.sample(generator))[-1] == 0
    never = Volume(volume.placed, MOTION, placed(-1.0, 0.0).at(0.0), jet=volume.jet)
    never.measure(generator)
    assert not any(map(any, never.equation.means))
    assert never.equation.reach == math.inf


def test_an_equation_finds_its_means_on_a_field(generator: torch.Generator) -> None:
    motion = with_means(MOTION, placed(1.0, 0.0), origin=0.0, generator=generator)
    assert [means[2] for means in motion.means] == pytest.approx([-0.1] * Volume.knots, rel=5e-3)
