"""Motion by velocity fields against its solution along the characteristics, and against formulas of the flows."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from levelflow.equations.curvature import MeanCurvature
from levelflow.equations.eikonal import Eikonal
from levelflow.equations.equation import Motions, Together
from levelflow.equations.transport import (
    Constant,
    Rotation,
    Source,
    SumOfVelocities,
    Transport,
    Twist,
    Velocity,
    VelocityField,
)
from tests.fields import Explicit, points


def shear(x: Tensor, t: Tensor) -> Tensor:
    """A velocity of one's own, which depends on time."""
    return torch.stack([torch.cos(3 * t[:, 0]) * x[:, 1], x[:, 0] * 0], dim=1)


def enright(x: Tensor, t: Tensor) -> Tensor:
    """Enright's field with period 3, around the middle of the unit cube; it returns to the start."""
    s, s2 = torch.sin(math.pi * x), torch.sin(2 * math.pi * x)
    v = torch.stack(
        [
            2 * s[:, 0] ** 2 * s2[:, 1] * s2[:, 2],
            -s2[:, 0] * s[:, 1] ** 2 * s2[:, 2],
            -s2[:, 0] * s2[:, 1] * s[:, 2] ** 2,
        ],
        dim=1,
    )
    return v * torch.cos(math.pi * t / 3)


VELOCITIES: dict[str, tuple[int, Velocity]] = {
    "constant": (2, Constant((0.3, -0.7))),
    "rotation in the plane": (2, Rotation(2.0, center=(0.2, 0.1))),
    "rotation": (3, Rotation(-1.0, axis=(1, 2, -2), center=(0.2, 0.1, 0.3))),
    "twist": (3, Twist(1.5, axis=(0, 3, 4), center=(0.1, 0, 0))),
    "source": (2, Source((0.3, 0.2), strength=0.7)),
    "sink in space": (3, Source((0.1, 0.1, 0), strength=-0.5, width=0.6)),
    "function of time": (2, shear),
    "sum": (2, Constant((0.3, -0.7)) + Rotation(1.0) + Source((0.3, 0.2)) + shear),
    "Enright's": (3, enright),
}


@pytest.fixture(params=VELOCITIES, name="case")
def _case(request: pytest.FixtureRequest) -> tuple[int, Velocity]:
    return VELOCITIES[request.param]


def start(x: Tensor) -> Tensor:
    """A field with no symmetry."""
    return torch.sin(x[:, 0] + 2 * x[:, 1] ** 2) + 0.5 * x[:, -1] ** 3 + 0.2 * x[:, 0]


def column(n: int, value: float) -> Tensor:
    return torch.full((n,), value, dtype=torch.float64)


def residual(velocity: Velocity, solution: Callable[[Tensor, Tensor], Tensor], space: int) -> float:
    field = Explicit(solution, space, 1)
    x, t = points(field)
    return float(Transport(velocity).residual(x, t, field.jet(x, t, order=1)).detach().abs().max())


def test_the_initial_field_along_the_characteristics_solves_the_equation(case: tuple[int, Velocity]) -> None:
    space, velocity = case
    equation = Transport(velocity)
    characteristics = lambda x, t: start(equation.carry(x, t[:, 0], 0 * t[:, 0], steps=64))  # noqa: E731
    assert residual(velocity, characteristics, space) < 2e-6
    assert residual(velocity, lambda x, t: start(x), space) > 0.1


def test_translation_solves_it() -> None:
    assert residual(Constant((0.3, -0.7)), lambda x, t: start(x - t * x.new_tensor([0.3, -0.7])), 2) < 1e-13


def turned(x: Tensor, angle: Tensor) -> Tensor:
    """Points of the plane turned counter-clockwise."""
    c, s = angle.cos(), angle.sin()
    return torch.stack([c * x[:, 0] - s * x[:, 1], s * x[:, 0] + c * x[:, 1]], dim=1)


def test_rotation_about_a_point_solves_it() -> None:
    center = torch.tensor([0.2, 0.1], dtype=torch.float64)
    solution = lambda x, t: start(center + turned(x - center, -2 * t[:, 0]))  # noqa: E731
    assert residual(Rotation(2.0, center=(0.2, 0.1)), solution, 2) < 1e-13


def twisted(x: Tensor, angle: Tensor) -> Tensor:
    """Points of space turned about the z axis."""
    return torch.cat([turned(x[:, :2], angle), x[:, 2:]], dim=1)


def test_twist_turns_by_an_angle_that_grows_along_the_axis() -> None:
    solution = lambda x, t: start(twisted(x, -1.5 * x[:, 2] * t[:, 0]))  # noqa: E731
    assert residual(Twist(1.5, axis=(0, 0, 2)), solution, 3) < 1e-13


def test_the_twist_of_the_paper_has_rate_minus_one(generator: torch.Generator) -> None:
    x = torch.randn(50, 3, generator=generator, dtype=torch.float64)
    exact = x[:, 1:2] * torch.stack([-x[:, 2], 0 * x[:, 0], x[:, 0]], dim=1)
    assert torch.allclose(Twist(-1.0, axis=(0, 1, 0))(x, x[:, :1]), exact, rtol=0, atol=1e-14)


def test_the_source_of_the_paper_has_the_default_width(generator: torch.Generator) -> None:
    x = torch.randn(50, 3, generator=generator, dtype=torch.float64)
    y = x - x.new_tensor([0.1, 0.2, 0.3])
    exact = torch.exp(-(y * y).sum(1, keepdim=True) / 0.18) * y
    assert torch.allclose(Source((0.1, 0.2, 0.3))(x, x[:, :1]), exact, rtol=0, atol=1e-14)


def test_a_rotation_is_counter_clockwise_seen_against_the_axis() -> None:
    east = torch.tensor([[1.0, 0.0]])
    assert Rotation(1.0)(east, east[:, :1]).tolist() == [[0.0, 1.0]]
    east = torch.tensor([[1.0, 0.0, 0.0]])
    assert Rotation(1.0, axis=(0, 0, 5))(east, east[:, :1]).tolist() == [[0.0, 1.0, 0.0]]


def test_points_are_carried_around_by_a_rotation(generator: torch.Generator) -> None:
    x = torch.randn(50, 2, generator=generator, dtype=torch.float64)
    end = torch.rand(50, generator=generator, dtype=torch.float64)
    carried = Transport(Rotation(2.0)).carry(x, column(50, -0.5), end, steps=200)
    assert torch.allclose(carried, turned(x, 2 * (end + 0.5)), rtol=0, atol=1e-8)


def test_points_are_carried_by_a_twist(generator: torch.Generator) -> None:
    x = torch.randn(50, 3, generator=generator, dtype=torch.float64)
    carried = Transport(Twist(1.5, axis=(0, 0, 1))).carry(x, column(50, 0), column(50, 0.7), steps=200)
    assert torch.allclose(carried, twisted(x, 1.5 * 0.7 * x[:, 2]), rtol=0, atol=1e-7)


def test_a_constant_velocity_carries_points_exactly_in_one_step(generator: torch.Generator) -> None:
    x = torch.randn(50, 2, generator=generator, dtype=torch.float64)
    carried = Transport((1, -2)).carry(x, column(50, 0.5), column(50, 2), steps=1)
    assert torch.allclose(carried, x + 1.5 * x.new_tensor([1, -2]), rtol=0, atol=1e-14)


@pytest.mark.parametrize("case", ["rotation", "decay"])
def test_the_error_of_carrying_falls_with_the_fourth_power_of_the_step(case: str, generator: torch.Generator) -> None:
    x = 0.2 + torch.rand(50, 2, generator=generator, dtype=torch.float64)
    if case == "rotation":
        # As a function, so that the formula of its flow is not used.
        velocity, exact = Rotation(2.0).__call__, turned(x, column(50, 4.0))
    else:
        velocity, exact = (lambda x, t: -t * x * x), x / (1 + 2 * x)
    steps = [8, 16, 32, 64]
    errors = [
        float((Transport(velocity).carry(x, column(50, 0), column(50, 2), steps=n) - exact).abs().max()) for n in steps
    ]
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert abs(slope + 4) < 0.15


@pytest.mark.parametrize(
    ("space", "velocity"), [case for case in VELOCITIES.values() if isinstance(case[1], Constant | Rotation | Twist)]
)
def test_formulas_of_flows_agree_with_the_characteristics(
    space: int, velocity: VelocityField, generator: torch.Generator
) -> None:
    x = torch.rand(30, space, generator=generator, dtype=torch.float64)
    start, end = torch.rand(2, 30, generator=generator, dtype=torch.float64)
    steps = Transport(velocity.__call__).carry(x, start, end, steps=64)
    assert torch.allclose(velocity.flow(x, start, end), steps, rtol=0, atol=1e-7)


def test_carrying_there_and_back_is_the_identity(case: tuple[int, Velocity], generator: torch.Generator) -> None:
    space, velocity = case
    x = torch.rand(30, space, generator=generator, dtype=torch.float64)
    there = Transport(velocity).carry(x, column(30, 0.2), column(30, 1.0), steps=64)
    back = Transport(velocity).carry(there, column(30, 1.0), column(30, 0.2), steps=64)
    assert (there - x).abs().max() > 0.05
    assert torch.allclose(back, x, rtol=0, atol=1e-6)


def test_enrights_field_returns_to_the_start(generator: torch.Generator) -> None:
    x = 0.35 + 0.15 * torch.nn.functional.normalize(torch.randn(50, 3, generator=generator, dtype=torch.float64), dim=1)
    equation = Transport(enright)
    assert torch.allclose(equation.carry(x, column(50, 0), column(50, 3), steps=256), x, rtol=0, atol=1e-5)
    assert (equation.carry(x, column(50, 0), column(50, 1.5), steps=64) - x).abs().max() > 0.3


def test_velocities_and_transports_add(generator: torch.Generator) -> None:
    x = torch.randn(20, 2, generator=generator, dtype=torch.float64)
    t = torch.rand(20, 1, generator=generator, dtype=torch.float64)
    parts = (Constant((1.0, 2.0)), Rotation(3.0), shear)
    exact = sum(velocity(x, t) for velocity in parts)
    assert torch.allclose((parts[0] + parts[1] + parts[2])(x, t), exact)
    total = Transport(parts[0]) + Transport(parts[1]) + Transport(shear)
    assert isinstance(total, Transport) and isinstance(total.velocity, SumOfVelocities)
    assert torch.allclose(total.velocity(x, t), exact)


def test_transport_and_other_equations_add() -> None:
    assert isinstance(Transport((1, 2)) + MeanCurvature(rate=1), Motions)
    assert isinstance(Transport((1, 2)) + Eikonal(), Together)


def test_a_transport_says_what_it_is() -> None:
    assert repr(Transport((1, 0))) == "Transport(Constant(velocity=(1.0, 0.0)))"


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("velocity", ["north", 3.0, ("a", "b"), None])
def test_what_is_no_velocity_is_refused(velocity: object) -> None:
    with pytest.raises(TypeError, match=r"Transport\(.*\): give the components of a constant velocity, such as"):
        Transport(velocity)  # type: ignore[arg-type]


def test_a_constant_velocity_has_as_many_components_as_points_have_coordinates() -> None:
    with pytest.raises(ValueError, match="the velocity has 3 components, the points have 2 coordinates"):
        Transport((1, 2, 3)).carry(torch.zeros(1, 2), torch.zeros(1), torch.ones(1))


@pytest.mark.parametrize("width", [0.0, -1.0, math.nan])
def test_a_source_has_a_positive_reach(width: float) -> None:
    with pytest.raises(ValueError, match=rf"Source\(width={width:g}\): the width must be positive"):
        Source((0.0, 0.0), width=width)


def test_a_velocity_field_without_values_says_so() -> None:
    with pytest.raises(NotImplementedError):
        VelocityField()(torch.zeros(1, 2), torch.zeros(1, 1))


@pytest.mark.parametrize("axis", [(0.0, 0.0, 0.0), (0.0, 1.0), (0.0, math.nan, 1.0)])
@pytest.mark.parametrize("velocity", [Rotation, Twist])
def test_an_axis_is_a_direction(velocity: type, axis: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="the axis must be three finite numbers, not all zero"):
        velocity(1.0, axis)


def test_what_does_not_fit_the_points_is_refused() -> None:
    x, t = torch.zeros(4, 2).double(), torch.zeros(4, 1).double()
    with pytest.raises(ValueError, match="a twist needs three space coordinates"):
        Twist(1.0)(x, t)
    with pytest.raises(ValueError, match="has 3 coordinates, the points have 2"):
        Rotation(1.0, center=(0.0, 0.0, 0.0))(x, t)
    with pytest.raises(ValueError, match=r"the velocity has the shape \(4,\) at points of the shape \(4, 2\)"):
        Transport(lambda x, t: x[:, 0]).carry(x, t[:, 0], t[:, 0] + 1)


def test_a_constant_velocity_may_be_an_array() -> None:
    assert repr(Transport(np.array([1, 0]))) == repr(Transport(torch.tensor([1, 0]))) == repr(Transport((1, 0)))
