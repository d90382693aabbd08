"""Families of circles whose radius or centre is known for every parameter."""

from __future__ import annotations

import math

import pytest
import torch

from levelflow import SIREN, Box, Budget, Circle, Sampling, solve
from levelflow.equations import Constant, Eikonal, Family, MeanCurvature, Rotation, Stationary, Transport
from tests.fields import Explicit, points

BOX = Box((-1.0, -1.0), (1.0, 1.0), ((0.0, 1.0), (0.0, 0.5)))
MOVE, SHRINK = Transport((0.3, -0.1)), MeanCurvature(0.05)


def moved_and_shrunk(x, t):
    """A circle of radius 1/2 that has moved for the first parameter and shrunk for the second."""
    y = x - t[:, :1] * x.new_tensor([0.3, -0.1])
    return torch.linalg.vector_norm(y, dim=1) - (0.25 - 0.1 * t[:, 1]).sqrt()


def test_motions_that_commute_have_a_family():
    field = Explicit(moved_and_shrunk, 2, 2, box=BOX)
    x = field.box.uniform(200, generator=torch.Generator().manual_seed(0))
    t = field.box.uniform_times(200, generator=torch.Generator().manual_seed(1))
    y = x - t[:, :1] * x.new_tensor([0.3, -0.1])
    x = x - y + y / torch.linalg.vector_norm(y, dim=1, keepdim=True) * (0.25 - 0.1 * t[:, 1:]).sqrt()
    jet = field.jet(x, t, order=2)
    family = Family(MOVE, SHRINK)
    for error in (family.residual(x, t, jet), family.error(x, t, jet)):
        assert error.shape == (200, 2) and error.detach().abs().max() < 1e-12
    assert Family(SHRINK, MOVE).error(x, t, jet).detach().abs().max() > 0.01
    assert repr(family) == f"Family({MOVE!r}, {SHRINK!r})"


def test_a_jet_along_one_parameter_forgets_the_others():
    field = Explicit(moved_and_shrunk, 2, 2, box=BOX)
    x, t = points(field)
    jet = field.jet(x, t, order=2)
    for i in (0, 1):
        along = jet.along(i)
        assert torch.equal(along.dt, jet.dt[:, i : i + 1]) and torch.equal(along.hessian, jet.hessian)
        assert torch.equal(along.gradient, jet.gradient)


def test_errors_come_to_units_by_the_interval_of_their_own_parameter():
    assert [column.unit(BOX) for column in Family(MOVE, SHRINK).columns] == [0.5, 0.25]
    together = Family(MOVE, SHRINK) + Eikonal()
    assert [column.unit(BOX) for column in together.columns] == [0.5, 0.25, 1.0]
    field = Explicit(moved_and_shrunk, 2, 2, box=BOX)
    x, t = points(field)
    assert together.error(x, t, field.jet(x, t, order=2)).shape == (len(x), 3)


def test_a_family_is_solved_from_one_shape():
    family = Family(Transport((0.3, 0.0)), MeanCurvature(0.05))
    network = SIREN(2, 2, width=32, depth=2)
    field = solve(
        family, network, at={(0.0, 0.0): Circle(0.5)}, until=(1.0, 1.0), budget=Budget(250), sampling=Sampling(1024)
    )
    assert field.box.times == ((0.0, 1.0), (0.0, 1.0)) and field.box.upper[0] > 0.8 > field.box.upper[1]
    angles = torch.linspace(0, 2 * math.pi, 40, dtype=torch.float64)
    circle = torch.stack([angles.cos(), angles.sin()], dim=1)
    for s, t in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.5, 0.5)):
        x = circle * math.sqrt(0.25 - 0.1 * t) + circle.new_tensor([0.3 * s, 0.0])
        assert field.at(s, t)(x).abs().max() < 0.02
    assert field.provenance["accuracy"]["0,0"]["mean"] < 0.01


def test_a_velocity_may_depend_on_parameters_given_for_all_their_values():
    """All translations at once: f(x, b, t) = f0(x - b t)."""
    motion = Transport(lambda x, t: torch.cat([t[:, 1:], torch.zeros_like(t[:, 1:])], dim=1))
    box = Box((-1.2, -0.8), (1.2, 0.8))
    field = solve(
        motion, SIREN(2, 2, width=32, depth=2), at={(0.0, None): Circle(0.5)}, until=(1.0, (-0.5, 0.5)), box=box,
        budget=Budget(400), sampling=Sampling(1024),
    )  # fmt: skip
    angles = torch.linspace(0, 2 * math.pi, 40, dtype=torch.float64)
    circle = 0.5 * torch.stack([angles.cos(), angles.sin()], dim=1)
    for b in (-0.5, 0.2, 0.5):
        for t in (0.0, 1.0):
            assert field.at(t, b)(circle + circle.new_tensor([b * t, 0.0])).abs().max() < 0.05


def test_what_is_no_family_is_refused(unchecked):
    with pytest.raises(ValueError, match=r"Family\(\): give a motion for each parameter"):
        Family()
    with pytest.raises(TypeError, match=r"Family: Eikonal\(\) is no motion along the normal"):
        Family(Eikonal())  # type: ignore[arg-type]
    field = Explicit(moved_and_shrunk, 2, 2, box=BOX)
    x, t = points(field)
    with pytest.raises(ValueError, match=r"1 motions for a field of 2 parameter\(s\)"):
        Family(Stationary()).error(x, t, field.jet(x, t, order=1))


@pytest.mark.parametrize(
    ("at", "until", "message"),
    [
        ({0.0: Circle(0.5)}, (1.0, 1.0), "the network has 2 time"),
        ({(0.0,): Circle(0.5)}, (1.0, 1.0), "give a number for each, or None"),
        ({(None, None): Circle(0.5)}, (1.0, 1.0), "give a number for each, or None"),
        ({(0.0, 0.0): Circle(0.5)}, (1.0,), "there are 2 parameters; give an end"),
        ({(0.0, 0.0): Circle(0.5)}, (1.0, None), "all is given at t = 0"),
        ({(0.0, 0.0): Circle(0.5)}, ((0.0, 0.0), 1.0), "solve, parameter 0: all is given at t = 0"),
        ({(0.0, None): Circle(0.5)}, (1.0, None), "nothing is given at a value of parameter 1"),
        ({(0.0, None): Circle(0.5)}, (1.0, ()), "nothing is given at a value of parameter 1"),
        ({(0.0, None): Circle(0.5)}, (1.0, (1.0, 1.0)), "nothing is given at a value of parameter 1"),
        ({(0.0, math.nan): Circle(0.5)}, (1.0, 1.0), "the times must be finite numbers"),
    ],
)
def test_parameters_without_an_interval_are_refused(at, until, message):
    with pytest.raises(ValueError, match=message):
        solve(Family(Transport(Rotation(1.0)), Transport(Constant((1.0, 0.0)))), SIREN(2, 2), at=at, until=until)


def test_every_parameter_needs_a_motion_and_every_motion_a_parameter():
    at = {(0.0, 0.0): Circle(0.5)}
    with pytest.raises(ValueError, match="nothing says how the surface changes with parameter 1, which is 0"):
        solve(MeanCurvature(0.1), SIREN(2, 2), at=at, until=(1.0, 1.0))
    with pytest.raises(ValueError, match=r"needs 2 parameters, and the network has 1: SIREN\(time=2\)"):
        solve(Family(MOVE, SHRINK), SIREN(2, 1), at={0.0: Circle(0.5)}, until=1.0)
    with pytest.raises(ValueError, match="two motions for one parameter"):
        Family(MOVE, SHRINK) + Transport((1.0, 0.0))


def test_the_box_is_that_of_the_moved_shape_and_accuracies_name_what_is_free():
    quick = {"budget": Budget(80), "sampling": Sampling(256, given=2000)}
    alone = solve(Family(Transport((3.0, 0.0))), SIREN(2, 1, width=8), at={0.0: Circle(0.5)}, until=1.0, **quick)
    assert alone.box.upper[0] > 3.5
    free = {(0.0, None): Circle(0.5), (None, 0.0): Circle(0.5)}
    with pytest.warns(UserWarning, match="sharpens before t = 0"):
        field = solve(
            Family(SHRINK, Stationary()), SIREN(2, 2, width=8), at=dict(reversed(free.items())),
            until=((-0.1, 0.1), (-1.0, 1.0)), **quick,
        )  # fmt: skip
    assert set(field.provenance["accuracy"]) == {"0,:", ":,0"}
