import math

import pytest
import torch

from levelflow import SIREN, Box, Circle, Placed, Rectangle, extract
from levelflow.equations import Approach, Constant, Family, MeanCurvature, Rotation, Source, Stationary, Transport
from levelflow.shapes import Sphere
from levelflow.suite.cases import _enright
from levelflow.transported import Transported, reach, reach_of_family
from tests.fields import differentiated

PLANE = Box((-1.0, -1.0), (1.0, 1.0), ((0.0, 2.0),))


def test_a_rotated_shape_is_the_shape_in_turned_coordinates(generator):
    shape = Rectangle((0.8, 0.3))
    field = Transported(Transport(Rotation(1.0)), shape, box=PLANE, time=0.5)
    x, t = PLANE.uniform(200, generator=generator), PLANE.uniform_times(200, generator=generator)
    angle = -(t[:, 0] - 0.5)
    back = torch.stack(
        [angle.cos() * x[:, 0] - angle.sin() * x[:, 1], angle.sin() * x[:, 0] + angle.cos() * x[:, 1]], dim=1
    )
    assert torch.allclose(field(x, t), shape.distance(back), atol=1e-8)
    assert torch.equal(field.at(0.5)(x), field(x, torch.full((200, 1), 0.5).double()))


def test_it_solves_its_equation_and_its_jets_are_those_of_autograd(generator):
    motion = Transport(Source((0.2, 0.1), 1.0, 0.5))
    field = Transported(motion, Circle(0.5), box=PLANE, steps=32)
    x, t = PLANE.uniform(20, generator=generator), PLANE.uniform_times(20, generator=generator)
    jet = field.jet(x, t, order=2)
    assert motion.residual(x, t, jet).abs().max() < 1e-5
    oracle = differentiated(field, x, t)
    for name in ("value", "gradient", "dt", "hessian"):
        assert torch.allclose(getattr(jet, name), getattr(oracle, name).detach(), atol=1e-10)
    assert field.jet(x, t, order=0).first is None
    assert torch.allclose(field.jet(x, t, order=1).gradient, jet.gradient)


def test_enrights_deformation_keeps_the_volume_and_comes_back():
    """Grids lose 25 to 63 % of the volume; what is lost here is the error of the extracted mesh."""
    ball = Sphere(0.15, center=(0.35, 0.35, 0.35))
    box = Box((0.0,) * 3, (1.0,) * 3, ((0.0, 3.0),))
    field = Transported(Transport(_enright), ball, box=box, steps=64)
    mesh = extract(field.at(3.0), resolution=48)
    assert abs(mesh.volume / (4 / 3 * math.pi * 0.15**3) - 1) < 0.02


def test_left_to_itself_it_finds_its_box_and_its_steps(generator):
    """A disk that moves by 2 and grows: the box holds it at every time, and the error of its place is below 1e-5."""
    motion = Transport(Constant((1.0, 0.0)) + Source((2.0, 0.0), 1.0, 0.5))
    field = Transported(motion, Circle(0.5), until=(-0.5, 2.0))
    assert field.box.times == ((-0.5, 2.0),)
    assert field.box.lower[0] < -1.0 and field.box.upper[0] > 2.5
    x, t = field.box.uniform(100, generator=generator), field.box.uniform_times(100, generator=generator)
    finer = Transported(motion, Circle(0.5), box=field.box, steps=1024)
    assert 4 <= field.steps < 256
    assert (field(x, t) - finer(x, t)).abs().max() < 1e-5 * max(field.box.size)


def test_a_fitted_field_is_carried_with_its_jets(generator):
    """Also beyond the box of the fit, where the field is continued."""
    static = Placed(SIREN(2, width=8, depth=2, dtype=torch.float64), Box((-1.0, -1.0), (1.0, 1.0)))
    field = Transported(Transport(Rotation(1.0)), static, box=PLANE.expanded(0.5))
    x, t = field.box.uniform(100, generator=generator), field.box.uniform_times(100, generator=generator)
    jet, oracle = field.jet(x, t, order=2), differentiated(field, x, t)
    for name in ("value", "gradient", "dt", "hessian"):
        assert torch.isfinite(getattr(jet, name)).all()
        assert torch.allclose(getattr(jet, name), getattr(oracle, name).detach(), atol=1e-8)
    assert list(field.parameters())


def test_wrong_use_is_explained():
    with pytest.raises(ValueError, match="has no characteristics"):
        Transported(MeanCurvature(1.0), Circle(0.5), box=PLANE)
    with pytest.raises(ValueError, match="the box has 0 times"):
        Transported(Stationary(), Circle(0.5), box=PLANE.during())
    for until in (None, 0.0):
        with pytest.raises(ValueError, match=r"given at t = 0; say how far to go"):
            Transported(Stationary(), Circle(0.5), until=until)


def test_a_box_reaches_to_where_a_motion_leads():
    here, there = Circle(0.5), Circle(0.5, center=(3.0, 0.0))
    motion = Approach(there) + Stationary()
    for box in (
        reach(motion, {0.0: here}, (0.0, 1.0)),
        reach_of_family(Family(Stationary(), motion), [here], [(0.0, 0.0)], [(0.0, 1.0), (0.0, 1.0)]),
    ):
        assert box.lower[0] < -0.5 and box.upper[0] > 3.5 and box.upper[1] < 1.1
