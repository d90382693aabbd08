"""Motions without their mean."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from levelflow.equations import Eikonal, MeanCurvature, Transport, VolumePreserving
from tests.fields import Explicit, points


def sphere(x: Tensor, t: Tensor) -> Tensor:
    return x.norm(dim=1) - 0.5


def test_a_sphere_stands_still() -> None:
    field = Explicit(sphere, 3, 1)
    x, t = points(field, 50)
    x = 0.5 * x / x.norm(dim=1, keepdim=True)
    motion = VolumePreserving(MeanCurvature(0.1)).measured([0.0], [[-0.1 * 2 / 0.5]])
    assert motion.speed(x, t, field.jet(x, t, order=2)).abs().max() < 1e-14
    assert (motion.order, motion.sharpens, motion.averages) == (2, True, True)


def test_the_mean_is_linear_between_the_times_and_fades_away_from_the_surface() -> None:
    field = Explicit(sphere, 2, 1)
    x = torch.tensor([[0.5, 0.0]] * 5 + [[0.8, 0.0]], dtype=torch.float64)
    t = torch.tensor([[-1.0], [0.0], [0.25], [1.0], [2.0], [0.0]], dtype=torch.float64)
    still = Transport(lambda x, t: torch.zeros_like(x))
    motion = VolumePreserving(still).measured([0.0, 1.0], [[-2.0], [-4.0]], reach=0.3)
    expected = [2.0, 2.0, 2.5, 4.0, 4.0, 2.0 * torch.exp(torch.tensor(-1.0)).item()]
    assert motion.speed(x, t, field.jet(x, t)).tolist() == pytest.approx(expected)
    assert motion.weight(t).tolist() == [1.0] * 6


def test_level_sets_have_means_of_their_own() -> None:
    field = Explicit(sphere, 2, 1)
    x = torch.tensor([[0.3, 0.0], [0.4, 0.0], [0.55, 0.0], [1.0, 0.0]], dtype=torch.float64)
    still = Transport(lambda x, t: torch.zeros_like(x))
    motion = VolumePreserving(still).measured([0.0], [[-3.0, -2.0, -1.0]], levels=[-0.1, 0.0, 0.1], reach=0.4)
    expected = [3.0 * math.exp(-(0.1**2) / 0.16), 3.0, 1.5, math.exp(-1.0)]
    assert motion.speed(x, torch.zeros_like(x[:, :1]), field.jet(x, x[:, :1])).tolist() == pytest.approx(expected)


def test_it_says_what_it_is() -> None:
    motion = VolumePreserving(MeanCurvature(rate=0.1))
    assert repr(motion.measured([0.0], [[1.0]])) == repr(motion) == "VolumePreserving(MeanCurvature(rate=0.1))"


def test_without_a_mean_it_refuses_and_so_it_does_without_a_speed(unchecked: None) -> None:
    field = Explicit(sphere, 2, 1)
    x, t = points(field, 3)
    with pytest.raises(ValueError, match=r"VolumePreserving.*: the mean over the surface is not known"):
        VolumePreserving(MeanCurvature(0.1)).speed(x, t, field.jet(x, t, order=2))
    with pytest.raises(TypeError, match="no motion along the normal"):
        VolumePreserving(Eikonal())  # type: ignore[arg-type]
