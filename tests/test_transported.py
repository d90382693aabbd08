import math

import pytest
import torch

from levelflow import SIREN, Box, Circle, Placed, Rectangle, extract
from levelflow.equations import (
    Approach,
    Constant,
    Family,
    MeanCurvature,
    Regional,
    Rotation,
    Source,
    SphereMask,
    Stationary,
    Transport,
)
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


def test_a_family_of_motions_that_commute_is_exact_for_all_parameters(generator):
    shape, pushes = Rectangle((0.8, 0.3)), (Transport((1.0, 0.5)), Transport((0.0, -2.0)))
    field = Transported(Family(*pushes), shape, until=((0.0, 1.0), (-0.5, 0.5)), time=(0.5, 0.0))
    assert field.box.times == ((0.0, 1.0), (-0.5, 0.5)) and field.times == 2
    assert field.box.lower[0] < -0.9 and field.box.lower[1] < -1.4 and field.box.upper[1] > 1.4
    x, t = field.box.uniform(200, generator=generator), field.box.uniform_times(200, generator=generator)
    moved = (t - t.new_tensor([0.5, 0.0])) @ t.new_tensor([[1.0, 0.5], [0.0, -2.0]])
    assert torch.allclose(field(x, t), shape.distance(x - moved), atol=1e-12)
    assert torch.equal(field.at(0.5, 0.0)(x), shape.distance(x))
    assert torch.allclose(field.carry(x, t, t.flip(0)), x - moved + moved.flip(0), atol=1e-12)
    jet, oracle = field.jet(x, t, order=2), differentiated(field, x, t)
    for name in ("value", "gradient", "dt", "hessian"):
        assert torch.allclose(getattr(jet, name), getattr(oracle, name).detach(), atol=1e-10)
    assert Family(*pushes).residual(x, t, jet).abs().max() < 1e-12
    alone = Transported(Family(Transport(Rotation(1.0))), shape, box=PLANE)
    one = Transported(Transport(Rotation(1.0)), shape, box=PLANE)
    assert torch.equal(alone(x, 2 * t[:, :1]), one(x, 2 * t[:, :1]))


@pytest.mark.filterwarnings("ignore:Transported. not all motions")
def test_motions_that_do_not_commute_run_in_their_order(generator):
    """The push first and then the turn: a point of the given shape is turned with what it was pushed by."""
    push, turn, shape = Constant((1.0, 0.0)), Rotation(1.0), Circle(0.5)
    field = Transported(Family(Transport(push), Transport(turn)), shape, until=(1.0, 1.0))
    x = shape.sample(50, generator=generator).points
    start, end = x.new_zeros(50, 2), x.new_tensor([1.0, 0.75]).expand(50, 2)
    there = turn.flow(x + x.new_tensor([1.0, 0.0]), start[:, 1], end[:, 1])
    assert torch.allclose(field.carry(x, start, end), there, atol=1e-12)
    assert field(there, end).abs().max() < 1e-12 and field.box.contains(there).all()
    assert torch.allclose(field.carry(there, end, start), x, atol=1e-12)


def test_a_mask_of_a_velocity_keeps_the_characteristics(generator):
    """What lies in the fixed region stays, what is far from it moves in full, and the equation holds in between."""
    fixed = SphereMask((-0.5, 0.0), 0.3, 0.4, inside=0.0, outside=1.0)
    motion = Regional(Transport((0.5, 0.0)), fixed)
    field = Transported(motion, Rectangle((1.4, 0.2)), until=1.0)
    x, t = field.box.uniform(300, generator=generator), field.box.uniform_times(300, generator=generator)
    jet = field.jet(x, t, order=2)
    assert motion.residual(x, t, jet).abs().max() < 1e-4
    inside = fixed(x) == 0
    assert inside.any() and torch.equal(field(x, t)[inside], field.shape.distance(x)[inside])
    assert extract(field.at(1.0), resolution=64).box.upper[0] == pytest.approx(1.2, abs=0.01)
    assert not Regional(MeanCurvature(1.0), fixed).has_characteristics(2)


def test_wrong_use_is_explained():
    with pytest.raises(ValueError, match="has no characteristics"):
        Transported(MeanCurvature(1.0), Circle(0.5), box=PLANE)
    with pytest.raises(ValueError, match="MeanCurvature.rate=1.0. depends on the surface"):
        Transported(Family(Stationary(), MeanCurvature(1.0)), Circle(0.5), until=(1.0, 1.0))
    pair = Family(Stationary(), Transport((1.0, 0.0)))
    with pytest.raises(ValueError, match=r"has 2 parameter\(s\); give a number for each"):
        Transported(pair, Circle(0.5), until=(1.0, 1.0), time=(0.0, 0.0, 0.0))
    for until, message in (((1.0,), "there are 2 parameters; give an end"), ((1.0, 0.0), "parameter 1: all is given")):
        with pytest.raises(ValueError, match=message):
            Transported(pair, Circle(0.5), until=until)
    with pytest.raises(ValueError, match=r"the box has 1 times and the motion 2; .*during\(\(0, 1\), \(0, 1\)\)"):
        Transported(pair, Circle(0.5), box=PLANE)
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
