"""Motions that are given, against where they carry points."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from levelflow.equations import Constant, Rotation, Twist
from levelflow.flows import NormalOffset, Prescribed
from tests.flows.examples import after, ball, icosphere, moved, polygon


def swirl(x: Tensor, t: Tensor) -> Tensor:
    """A rotation whose rate depends on time, without a formula for where it leads: by the angle 1 - cos(t)."""
    return torch.sin(t) * torch.stack([-x[:, 1], x[:, 0]], dim=1)


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


def test_a_rotation_is_exact() -> None:
    mesh = polygon(7, center=(2, 1))
    step = Prescribed(Rotation(1.5)).displacement(mesh, 2.0, time=0.0)
    assert np.allclose(mesh.vertices + step, turned(mesh.vertices, 3.0), atol=1e-12)
    ball_ = icosphere(1)
    full = Prescribed(Rotation(2 * math.pi, axis=(1, 2, 3)) + Constant((0, 0, 0)), steps=200)
    assert np.abs(full.displacement(ball_, 1.0, time=0.0)).max() < 1e-6
    there = moved(ball_, Prescribed(Twist(0.7)).displacement(ball_, 2.0, time=0.0))
    assert np.abs(there.vertices - ball_.vertices).max() > 0.1
    assert np.allclose(Prescribed(Twist(0.7)).displacement(there, -2.0, time=2.0), ball_.vertices - there.vertices)


@pytest.mark.parametrize("velocity", [(0.3, -0.2), np.array([0.3, -0.2]), torch.tensor([0.3, -0.2])], ids=type)
def test_numbers_are_a_constant_velocity(velocity: object) -> None:
    step = Prescribed(velocity).displacement(polygon(5), 0.5, time=1.0)  # type: ignore[arg-type]
    assert np.allclose(step, [0.15, -0.1], atol=1e-7)


def test_a_velocity_of_ones_own_is_followed_to_fourth_order() -> None:
    mesh, truth = polygon(7, center=(2, 1)), turned(polygon(7, center=(2, 1)).vertices, 1 - math.cos(2.0))
    errors = [
        np.abs(after(Prescribed(swirl, steps=n), mesh, until=2.0, steps=2).vertices - truth).max() for n in (2, 4)
    ]
    assert errors[1] < 1e-4
    assert math.log2(errors[0] / errors[1]) > 3.7


@pytest.mark.parametrize("space", [2, 3])
def test_an_offset_ball_is_a_ball(space: int) -> None:
    mesh = ball(space, 16)
    length = np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    mesh = moved(mesh, mesh.vertices * (0.5 / length - 1))
    for speed in (0.3, -0.3):
        result = after(NormalOffset(speed), mesh, until=0.5, steps=5)
        assert np.allclose(np.linalg.norm(result.vertices, axis=1), 0.5 + speed * 0.5, atol=1e-9)


def test_neither_numbers_nor_a_function(unchecked: None) -> None:
    with pytest.raises(TypeError, match=r"Prescribed\('up'\): give the components.* or a function V\(x, t\)"):
        Prescribed("up")  # type: ignore[arg-type]


def test_no_steps() -> None:
    with pytest.raises(ValueError, match=r"Prescribed\(steps=0\): at least one step"):
        Prescribed((1, 0), steps=0)
