import pytest
import torch

from levelflow.boxes import Box
from levelflow.equations import Eikonal, Family, MeanCurvature, Morph, Regional, Stationary
from levelflow.shapes import Circle
from tests.fields import Explicit, points

BOX = Box((-1.0, -1.0), (1.0, 1.0), ((0.0, 0.9),))


def shrinking(x, t):
    """Concentric circles under mean curvature of rate 0.1."""
    return ((x * x).sum(1) + 0.2 * t[:, 0]).sqrt() - 0.5


def test_a_mask_multiplies_the_speed():
    field, motion = Explicit(shrinking, 2, 1, box=BOX), MeanCurvature(0.1)
    x, t = points(field)
    jet = field.jet(x, t, order=2)
    half = Regional(motion, lambda x: torch.full((len(x),), 0.5))
    assert half.order == 2 and half.sharpens
    assert torch.allclose(half.speed(x, t, jet), 0.5 * motion.speed(x, t, jet))
    assert Regional(motion, lambda x: torch.ones(len(x))).residual(x, t, jet).detach().abs().max() < 1e-12
    left = Regional(motion, lambda x: (x[:, 0] < 0).double())
    error = left.residual(x, t, jet).detach()
    assert error[x[:, 0] < 0].abs().max() < 1e-12 < error[x[:, 0] > 0].abs().min()


def test_a_field_is_a_mask_and_the_weight_in_time_is_that_of_the_motion():
    field, mask = Explicit(shrinking, 2, 1, box=BOX), Explicit(lambda x, t: x[:, 0], 2)
    x, t = points(field)
    jet = field.jet(x, t, order=1)
    morph = Morph(Circle(0.8))
    assert torch.allclose(Regional(morph, mask).speed(x, t, jet), x[:, 0] * morph.speed(x, t, jet))
    assert torch.equal(Regional(morph, mask).weight(t), morph.weight(t))


def test_points_are_held_where_the_mask_is_zero_and_no_other_motion_is_at_work(generator):
    x = BOX.uniform(100, generator=generator)
    left = x[:, 0] < 0
    film = Regional(MeanCurvature(0.1), lambda x: x[:, 0].clamp_min(0))
    assert torch.equal(film.held(x), left)
    assert torch.equal((film + Stationary()).held(x), left)
    assert not (film + MeanCurvature(0.1)).held(x).any() and not Eikonal().held(x).any()
    columns = Family(film, Stationary()).columns
    assert torch.equal(columns[0].held(x), left) and columns[1].held(x).all()


def test_what_is_no_mask_is_refused(unchecked):
    with pytest.raises(TypeError, match="the mask is to be a function of points"):
        Regional(MeanCurvature(0.1), 0.5)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"Regional\(Eikonal\(\), ...\): this is no motion along the normal"):
        Regional(Eikonal(), lambda x: x[:, 0])  # type: ignore[arg-type]
    field = Explicit(shrinking, 2, 1, box=BOX)
    x, t = points(field)
    with pytest.raises(ValueError, match=r"the mask has the shape \(30, 2\) at 30 points"):
        Regional(MeanCurvature(0.1), lambda x: x).speed(x, t, field.jet(x, t, order=2))
