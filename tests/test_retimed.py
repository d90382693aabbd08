"""Fields to another clock. Their jets are tested in test_jets."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from levelflow import Box, Placed, Retimed, extract
from levelflow.equations import Constant, Transport
from levelflow.export.normal_motion import carry, slopes
from levelflow.export.snapshots import snapshots
from levelflow.export.tracking import track
from levelflow.export.volumes import volumes
from levelflow.jets import Jet
from levelflow.rendering import image
from levelflow.transported import Transported
from levelflow.viewer.viewed import SPEED, ViewedField
from tests.export.moving import GROWTH, growing, radius
from tests.fields import Explicit, differentiated, periodic, placed, points, siren

KEYS = {0: 2, 1: 3.5, 3: 3.5, 4: 5, 6: 2}
"""Half the way, a hold, the rest of it, and back: for a field from t = 2 to 5."""
NOW = torch.linspace(-1, 7, 1601, dtype=torch.float64)


def moments(retimed: Retimed, t: torch.Tensor = NOW) -> torch.Tensor:
    return torch.tensor([retimed.moment(time) for time in t.tolist()], dtype=torch.float64)


@pytest.mark.parametrize("ease", [0.0, 0.3, 1.0])
def test_the_clock_meets_its_keys_and_never_leaves_the_times_between_them(ease: float) -> None:
    retimed = Retimed(placed(2, 1), KEYS, ease=ease)
    assert [retimed.moment(new) for new in KEYS] == list(KEYS.values())
    for (a, p), (b, q) in zip(KEYS.items(), list(KEYS.items())[1:], strict=False):
        inside = moments(retimed, torch.linspace(a, b, 101, dtype=torch.float64))
        assert inside.min() == min(p, q) and inside.max() == max(p, q)
        assert (inside.diff() * np.sign(q - p) > 0).all() if p != q else (inside == p).all()


def test_between_two_keys_it_is_the_cubic_that_is_said() -> None:
    u = torch.linspace(0, 1, 11, dtype=torch.float64)
    for ease in (0.0, 0.5, 1.0):
        found = moments(Retimed(placed(2, 1), {2: 3, 6: 5}, ease=ease), 2 + 4 * u)
        assert torch.allclose(found, 3 + 2 * ((1 - ease) * u + ease * (3 * u**2 - 2 * u**3)), rtol=0, atol=1e-14)


def test_eased_it_is_at_rest_at_every_key_and_its_speed_has_no_jump() -> None:
    step = float(NOW[1] - NOW[0])
    # The cubics bend by at most 6 |rise| / length^2.
    jumps = {ease: moments(Retimed(placed(2, 1), KEYS, ease=ease)).diff().div(step).diff().abs() for ease in (0, 1)}
    assert jumps[1].max() < 1.01 * 6 * 1.5 * step
    assert jumps[0].max() == pytest.approx(3.0, rel=1e-6)
    x, _ = points(placed(2, 1))
    rates = [Retimed(placed(2, 1), KEYS).jet(x, torch.full((len(x), 1), float(t)).double()).dt for t in KEYS]
    assert all((rate == 0).all() for rate in rates)


@pytest.mark.parametrize("ease", [0.0, 0.6, 1.0])
def test_values_and_speeds_are_those_of_the_field_at_the_moment(ease: float) -> None:
    field = placed(2, 1)
    retimed = Retimed(field, KEYS, ease=ease)
    x, t = points(retimed, 200)
    moment = moments(retimed, t[:, 0])[:, None]
    h = 1e-6
    rate = (moments(retimed, t[:, 0] + h) - moments(retimed, t[:, 0] - h))[:, None] / (2 * h)
    whole, jet = field.jet(x, moment, order=2), retimed.jet(x, t, order=2)
    assert torch.equal(jet.value, whole.value) and torch.equal(jet.value, retimed(x, t))
    assert torch.equal(jet.gradient, whole.gradient) and torch.equal(jet.hessian, whole.hessian)
    assert torch.allclose(jet.dt, whole.dt * rate, rtol=0, atol=1e-7)
    assert retimed.box == field.box.during((0.0, 6.0))
    assert (retimed.space, retimed.times, retimed.device) == (2, 1, field.device)


def test_second_derivatives_are_those_of_a_map_through_time() -> None:
    """Pushed through a map that mixes space with time, the bend of the clock counts."""
    retimed = Retimed(placed(2, 1), {0: 2, 1: 5})

    def sheared(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        return retimed(x, 0.5 + 0.3 * x[:, :1] * x[:, 1:])

    x = 3 * torch.rand(20, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64) - 1
    exact = differentiated(sheared, x, x.new_zeros(20, 0))
    z = torch.cat([x, 0.5 + 0.3 * x[:, :1] * x[:, 1:]], dim=1)
    first, second = torch.zeros(20, 2, 3).double(), torch.zeros(20, 2, 2, 3).double()
    first[:, 0, 0] = first[:, 1, 1] = 1
    first[:, :, 2] = 0.3 * x.flip(1)
    second[:, 0, 1, 2] = second[:, 1, 0, 2] = 0.3
    pushed = retimed.push(Jet(z, first, second, 2))
    assert torch.allclose(pushed.first, exact.first, rtol=0, atol=1e-11)
    assert torch.allclose(pushed.second, exact.second, rtol=0, atol=1e-11)


def test_at_a_time_it_is_the_slice_of_the_field_inside() -> None:
    field = placed(2, 1)
    retimed = Retimed(field, KEYS)
    x, _ = points(field)
    for t, moment in ((0.0, 2.0), (2.2, 3.5), (3.5, 4.25), (5.0, 3.5)):
        now = retimed.at(t)
        assert isinstance(now, Placed) and now.box == field.box.during()
        assert torch.equal(now(x), field.at(moment)(x))
    assert retimed.at(None) is retimed
    with pytest.raises(ValueError, match=r"at\(7\): the field was solved for times from 0 to 6"):
        retimed.at(7.0)


def test_before_the_first_key_and_after_the_last_it_stands_still() -> None:
    retimed = Retimed(placed(2, 1), {0: 2, 1: 5}, ease=0)
    x, _ = points(retimed)
    for t, moment in ((-0.5, 2.0), (1.5, 5.0)):
        jet = retimed.jet(x, torch.full((len(x), 1), t, dtype=torch.float64))
        assert retimed.moment(t) == moment and (jet.dt == 0).all()


def test_a_loop_can_go_round_several_times() -> None:
    """Its times go on beyond the interval; only a whole number of rounds closes."""
    loop = Placed(periodic(2, 1, loop=True), Box((-1, -1), (1, 1), ((0, 1),)))
    rounds = Retimed(loop, {0: 0.25, 6: 3.25}, ease=0)
    assert rounds.loops and not Retimed(loop, {0: 0.25, 6: 3}).loops
    assert rounds.moment(3) == 1.75
    x, _ = points(loop)
    assert torch.allclose(rounds.at(3.0)(x), loop.at(0.75)(x), rtol=0, atol=1e-12)
    t = torch.full((len(x), 1), 3, dtype=torch.float64)
    assert torch.allclose(rounds(x, t), loop.at(0.75)(x), rtol=0, atol=1e-12)
    assert torch.allclose(rounds.jet(x, t).dt, loop.jet(x, t / 4).dt / 2, rtol=0, atol=1e-12)
    there_and_back = Retimed(placed(2, 1), {0: 2, 1: 5, 2: 2})
    assert there_and_back.loops and not Retimed(placed(2, 1), {0: 2, 1: 5}).loops


def test_points_of_the_surface_move_as_they_do_inside() -> None:
    """A sphere that grows, waits and shrinks: its points keep to their rays, and stand still in between."""
    retimed = Retimed(growing(), {0: 0, 1: 1, 2: 1, 3: -1})
    n = np.array([[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]])
    local = slopes(retimed, radius(0.5) * n, 0.5)
    assert np.allclose(local.velocities, 1.5 * GROWTH * n)
    assert np.array_equal(slopes(retimed, radius(1) * n, 1.4).velocities, np.zeros((2, 3)))
    carried = carry(retimed, radius(0) * n, 0.0, 3.0, step=0.1)
    assert carried.arrived.all() and np.allclose(carried.points, radius(-1) * n, atol=1e-9)


def test_points_of_a_carried_field_go_along_its_characteristics() -> None:
    ball = Explicit(lambda x, t: x.norm(dim=1) - 0.4, 3, box=Box((-1.0,) * 3, (1.0,) * 3))
    field = Transported(Transport(Constant((1.0, 0.0, 0.0))), ball, until=1.0)
    x = np.array([[0.0, 0.4, 0.0]])
    carried = carry(Retimed(field, {0: 0, 1: 1, 2: 0.25}), x, 0.0, 2.0, step=0.1)
    assert carried.arrived.all() and np.allclose(carried.points, x + [0.25, 0, 0])


def test_everything_that_takes_a_moving_field_takes_it() -> None:
    retimed = Retimed(growing(), {0: 0, 1: 1, 2: 0})
    times = (0.0, 0.5, 1.0, 1.5)
    radii = [radius(moment) for moment in (0, 0.5, 1, 0.5)]
    for frames in (snapshots(retimed, times, resolution=16), track(retimed, times, resolution=16)):
        for frame, r in zip(frames, radii, strict=True):
            assert np.allclose(np.linalg.norm(frame.mesh.vertices, axis=1), r, atol=1e-5)
    assert [v.values.min() < 0 for v in volumes(retimed, times, resolution=8)] == [True] * 4
    viewed = ViewedField(retimed, name="")
    assert viewed.box.times == ((0.0, 2.0),) and SPEED in viewed.quantities
    seen = viewed.surface((1.5,), resolution=16)
    assert np.allclose(seen.quantities["speed"], -1.5 * GROWTH, atol=1e-6)
    assert np.array_equal(seen.mesh.vertices, extract(growing().at(0.5), resolution=16).vertices)
    assert np.ptp(image(retimed.at(1.5), size=32)) > 50


@pytest.mark.parametrize(
    ("field", "keys", "ease", "message"),
    [
        (placed(2), {0: 2, 1: 3}, 1, r"the field has 0 times or parameters; give one that moves"),
        (placed(2, 2), {0: 2, 1: 3}, 1, r"the field has 2 times or parameters; .* a slice of a family"),
        (siren(2, 1), {0: 0, 1: 1}, 1, r"the field has no box, and so no interval of times"),
        (placed(2, 1), {0: 2}, 1, r"keys=\{0: 2\}\): give two keys or more"),
        (placed(2, 1), {0: 2, float("nan"): 3}, 1, "finite numbers"),
        (placed(2, 1), {0: 2, 1: float("inf")}, 1, "finite numbers"),
        (placed(2, 1), {0: 2, 1: 6}, 1, r"of the old times, at\(6\): the field was solved for times from 2 to 5"),
        (placed(2, 1), {0: 2, 1: 3}, 1.5, r"ease=1.5\): give a number from 0, an even speed, to 1"),
        (placed(2, 1), {0: 2, 1: 3}, float("nan"), r"ease=nan\): give a number"),
    ],
)
def test_what_cannot_be_retimed_is_explained(field, keys, ease, message) -> None:
    with pytest.raises(ValueError, match=f"^Retimed.*{message}"):
        Retimed(field, keys, ease=ease)
