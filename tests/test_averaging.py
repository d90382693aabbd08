"""Means over surfaces that are known."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from levelflow.averaging import Averages, with_means
from levelflow.boxes import Box
from levelflow.equations import MeanCurvature, VolumePreserving
from levelflow.fields import Placed
from levelflow.jets import Jet
from tests.fields import Explicit

BOX = Box((-2.0, -2.0), (2.0, 2.0)).during((0.0, 1.0))


def placed(radius: float, growth: float) -> Placed:
    """A circle of the radius r + g t in the units of a box of half size 2."""
    return Placed(Explicit(lambda x, t: x.norm(dim=1) - (radius + growth * (t[:, 0] + 1) / 2) / 2, 2, 1), BOX)


def jet_of(field: Placed):
    def jet(z: Tensor) -> Jet:
        return field.in_units(field.field.jet(z[:, :2], z[:, 2:], order=2))

    return jet


def test_the_mean_of_the_curvature_of_a_circle(generator: torch.Generator) -> None:
    field = placed(1.0, 0.0)
    averages = Averages(field, VolumePreserving(MeanCurvature(0.1)), origin=0.0)
    found = averages.measured(averages.unknown, jet_of(field), generator)
    assert found[0] == pytest.approx(1.0, rel=2e-3)  # twice the area over the circumference
    assert found[1:].tolist() == pytest.approx([-0.1] * averages.knots, rel=5e-3)
    motion = averages.known(found)
    assert motion.times[-1] == 1.0
    x = torch.tensor([[1.0, 0.0]], dtype=torch.float64)
    assert motion.speed(x, x[:, :1], field.jet(x, x[:, :1], order=2)).abs().max() < 1e-3


def test_a_volume_that_has_gone_astray_is_brought_back(generator: torch.Generator) -> None:
    field = placed(1.0, 0.1)
    averages = Averages(field, VolumePreserving(MeanCurvature(0.1)), origin=0.0)
    found = averages.measured(averages.unknown, jet_of(field), generator)
    excess = (math.pi * 1.1**2 - math.pi) / (2 * math.pi * 1.1)
    assert found[-1] == pytest.approx(-0.1 / 1.1 + averages.pull * excess, rel=2e-2)


def test_what_is_measured_later_counts_for_a_share(generator: torch.Generator) -> None:
    averages = Averages(placed(1.0, 0.0), VolumePreserving(MeanCurvature(0.1)), origin=0.0)
    first = averages.measured(averages.unknown, jet_of(averages.placed), generator)
    averages.placed = placed(0.5, 0.0)
    then = averages.measured(first, jet_of(averages.placed), generator)
    assert then[1].item() == pytest.approx(-0.1 - averages.share * 0.1, rel=1e-2)


def test_what_has_vanished_has_no_mean(generator: torch.Generator) -> None:
    field = placed(1.0, -2.0)
    averages = Averages(field, VolumePreserving(MeanCurvature(0.1)), origin=0.0)
    found = averages.measured(averages.unknown, jet_of(field), generator)
    assert found[-1] == 0
    assert found[1] != 0
    gone = Averages(field, VolumePreserving(MeanCurvature(0.1)), origin=1.0)
    assert not gone.measured(gone.unknown, jet_of(field), generator).any()
    assert gone.known(gone.unknown).reach == math.inf


def test_an_equation_finds_its_means_on_a_field(generator: torch.Generator) -> None:
    motion = with_means(VolumePreserving(MeanCurvature(0.1)), placed(1.0, 0.0), origin=0.0, generator=generator)
    assert motion.means == pytest.approx([-0.1] * Averages.knots, rel=5e-3)
