"""Where an equation is sampled, and what is known along characteristics."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from levelflow.boxes import Box
from levelflow.conditions import Given, Sampling
from levelflow.equations.curvature import MeanCurvature
from levelflow.equations.eikonal import Eikonal
from levelflow.equations.heat import Heat
from levelflow.equations.stationary import Stationary
from levelflow.equations.transport import Rotation, Transport
from levelflow.extraction import extract
from levelflow.fields import Field, Placed
from levelflow.jets import Jet
from levelflow.minimising import Budget, minimise
from levelflow.motion import Blend, Carried, Clinging, Motion, Outside, Sharpening, Smoothing
from levelflow.networks.siren import SIREN
from levelflow.shapes.analytic import Circle, Cuboid
from levelflow.solving import solve
from tests.fields import Explicit, siren

BOX = Box((1, -2), (5, 1), ((2.0, 6.0),))
"""Its frame has the centre (3, -0.5) and the scale 2; half of its interval lasts 2."""
VELOCITY = (0.3, -0.1)


def moving(u: Tensor, tau: Tensor) -> Tensor:
    """A circle in normalised coordinates that moves with a velocity."""
    return (u - tau * u.new_tensor([0.3, -0.1])).norm(dim=1) - 0.4


def given(key: Circle, box: Box, n: int = 2000) -> Given:
    like = torch.zeros(1, dtype=torch.float64)
    return Given.of(key, box.during(), n=n, generator=torch.Generator().manual_seed(0), like=like)


def sides() -> Tensor:
    return torch.tensor([1.0, 0.75, 1.0], dtype=torch.float64)


def unit(field: Field, z: Tensor) -> Tensor:
    return field(z[:, :2], z[:, 2:]).detach()


def test_walkers_come_to_the_zero_set_of_a_moving_circle(generator: torch.Generator) -> None:
    field = Explicit(moving, 2, 1)
    motion = Motion(Placed(field, BOX), Transport(VELOCITY), n=200)
    motion.sample(generator)
    walkers = motion.memory["walkers"]
    assert walkers.shape == (1600, 3)
    assert (walkers.abs() <= sides() + 1e-12).all()
    arrived = unit(field, walkers).abs() < 1e-6
    # A tenth starts afresh after every walk, and a few start too far away.
    assert 0.82 < arrived.double().mean() < 0.95
    times = walkers[arrived, 2]
    assert abs(times.mean()) < 0.06 and times.std() == pytest.approx(1 / math.sqrt(3), rel=0.05)
    angle = torch.atan2(*(walkers[arrived, :2] - times[:, None] * torch.tensor([0.3, -0.1])).flip(1).unbind(1))
    assert (torch.histc(angle, bins=4, min=-math.pi, max=math.pi) / len(angle) - 0.25).abs().max() < 0.12


def test_walkers_follow_the_field_as_it_changes(generator: torch.Generator) -> None:
    radius = [0.3]
    field = Explicit(lambda u, tau: u.norm(dim=1) - radius[0], 2, 1)
    motion = Motion(Placed(field, BOX), Stationary(), n=100)
    motion.sample(generator)
    before = motion.memory["walkers"].clone()
    radius[0] = 0.5
    for _ in range(motion.every - 1):
        motion.sample(generator)
    assert torch.equal(motion.memory["walkers"], before)
    motion.sample(generator)
    assert (unit(field, motion.memory["walkers"]).abs() < 1e-6).double().mean() > 0.8


def test_walkers_that_leave_a_cell_come_in_on_the_other_side() -> None:
    """A field whose Newton steps all go to the right by 0.2."""
    placed = Placed(Explicit(lambda u, tau: u[:, 0] - u[:, 0].detach() - 0.2, 2, 1), Box((0, 0), (2, 2), ((0.0, 1.0),)))
    z = torch.tensor([[0.9, 0.9, 0.3], [-0.5, 0.0, 0.3]], dtype=torch.float64)
    motion = Motion(placed, Stationary(), n=5)
    assert torch.allclose(motion._newton(z)[:, 0], torch.tensor([1.1, -0.3]).double())
    placed.periodic = (0,)
    assert torch.allclose(motion._newton(z), torch.tensor([[-0.9, 0.9, 0.3], [-0.3, 0.0, 0.3]]).double())


def test_samples_are_walkers_with_noise_and_for_a_fifth_points_of_the_whole_box(generator: torch.Generator) -> None:
    field = Explicit(moving, 2, 1)
    motion = Motion(Placed(field, BOX), Transport(VELOCITY), n=5000)
    (z,) = motion.sample(generator)
    assert z.shape == (5000, 3)
    near = unit(field, z[:4000])
    arrived = near[near.abs() < 0.05]
    assert len(arrived) > 3500 and arrived.std() == pytest.approx(motion.noise, rel=0.25)
    share = torch.histc(z[4000:, 1], bins=3, min=-0.75, max=0.75) / 1000
    assert (share - 1 / 3).abs().max() < 0.06


def test_the_true_motion_has_no_loss_and_another_has(generator: torch.Generator) -> None:
    # In the units of the box the circle moves by 2 (0.3, -0.1) in half the interval, 2 units of time.
    motion = Motion(Placed(Explicit(moving, 2, 1), BOX), Transport(VELOCITY), n=500)
    (z,) = motion.sample(generator)
    assert motion.loss(z).shape == (500,)
    assert motion.loss(z).detach().max() < 1e-25
    still = Motion(Placed(Explicit(moving, 2, 1), BOX), Stationary(), n=500)
    assert still.loss(z).detach().mean() > 1e-3


def test_the_loss_is_the_displacement_over_half_the_interval_whatever_the_units(generator: torch.Generator) -> None:
    losses = []
    for length, duration in ((1.0, 1.0), (1000.0, 60.0)):
        low, high = (tuple(length * v for v in corner) for corner in (BOX.lower, BOX.upper))
        box = Box(low, high, ((2 * duration, 6 * duration),))
        speed = length / duration
        equation = Transport((0.35 * speed, 0.0)) + MeanCurvature(rate=0.01 * speed * length)
        motion = Motion(Placed(siren(2, 1), box), equation, n=200)
        z = 2 * torch.rand(200, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64) - 1
        losses.append(motion.loss(z).detach())
    assert torch.allclose(losses[0], losses[1], rtol=1e-9)
    drift = Motion(Placed(Explicit(lambda u, tau: u[:, 0], 2, 1), BOX), Transport((0.004, 0.0)), n=200)
    assert torch.allclose(drift.loss(z).detach().sqrt(), torch.tensor(0.004 * 2 / 2, dtype=torch.float64), rtol=1e-3)


def test_far_errors_count_little_and_flat_places_not_at_all() -> None:
    z = torch.zeros(5, 3, dtype=torch.float64)
    for speed in (1.0, 10.0):
        far = Motion(Placed(Explicit(lambda u, tau: u[:, 0], 2, 1), BOX), Transport((speed, 0.0)), n=5)
        assert torch.allclose(far.loss(z).detach(), torch.tensor(0.01 * math.log1p((speed / 0.1) ** 2)).double())
    flat = Motion(Placed(Explicit(lambda u, tau: 0.04 * u[:, 0] + tau[:, 0], 2, 1), BOX), Stationary(), n=5)
    assert (flat.loss(z) == 0).all()


def test_errors_of_second_order_count_relative_to_the_curvature() -> None:
    """Circles of radius 1 and 0.1 that stand still, under mean curvature: the error of their speed is rate kappa."""
    box, rate = Box((-2.0, -2.0), (2.0, 2.0), ((0.0, 1.0),)), 1e-3
    still = Placed(Explicit(lambda u, tau: torch.linalg.vector_norm(u, dim=1), 2, 1), box)
    z = torch.tensor([[0.5, 0.0, 0.0], [0.05, 0.0, 0.0]], dtype=torch.float64)
    kappa = torch.tensor([1.0, 10.0], dtype=torch.float64)
    displacement = rate * kappa / 2 / 2
    relative = 1 + Motion.bend * 2 * kappa
    found = Motion(still, MeanCurvature(rate), n=5).loss(z)
    assert torch.allclose(found, (displacement / relative) ** 2, rtol=1e-3)
    steeper = Placed(Explicit(lambda u, tau: 2 * torch.linalg.vector_norm(u, dim=1), 2, 1), box)
    both = Motion(steeper, MeanCurvature(rate) + Eikonal(), n=5)
    slope = both.knee**2 * math.log1p(1 / both.knee**2)
    assert torch.allclose(both.loss(z), found + slope)


def test_errors_of_values_count_whatever_the_slope_and_the_curvature() -> None:
    """The flat rest of a small circle, still while heat flows: the error is rate times the Laplacian of f."""
    still = Placed(Explicit(lambda u, tau: 0.01 * (u * u).sum(1), 2, 1), BOX)
    z = torch.tensor([[0.05, 0.0, 0.0], [0.5, 0.5, 0.0]], dtype=torch.float64)
    change = 0.1 * 4 * 0.01 / 2 * 2 / 2  # 4 and 1/2 for the Laplacian in these units, 2/2 for half the time
    found = Motion(still, Heat(0.1), n=5).loss(z)
    assert torch.allclose(found, torch.tensor(0.01 * math.log1p((change / 0.1) ** 2), dtype=torch.float64))


def test_several_equations_at_once_add_their_losses() -> None:
    z = 2 * torch.rand(50, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64) - 1
    loss = lambda equation: Motion(Placed(siren(2, 1), BOX), equation, n=5).loss(z)  # noqa: E731
    total = loss(Transport(VELOCITY) + Eikonal())
    assert torch.allclose(total, loss(Transport(VELOCITY)) + loss(Eikonal()))


def test_a_run_with_walkers_goes_on_with_the_same_bits() -> None:
    def run(state: dict[str, Tensor] | None) -> tuple[list[Tensor], dict[str, Tensor]]:
        field = Placed(siren(2, 1, width=8, seed=0 if state is None else 5), BOX)
        states = {}
        minimise(
            field.parameters(),
            [Motion(field, MeanCurvature(rate=0.1), n=50)],
            budget=Budget(steps=25),
            generator=torch.Generator().manual_seed(0 if state is None else 5),
            state=state,
            on_step=lambda progress: states.update(progress.state()) if progress.step == 14 else None,
        )
        return [p.detach() for p in field.parameters()], states

    whole, state = run(None)
    resumed, _ = run(state)
    assert all(torch.equal(a, b) for a, b in zip(whole, resumed, strict=True))


@pytest.mark.parametrize("time", [2.0, 4.5, 6.0])
def test_values_are_carried_as_the_exact_solution_of_a_rotation_says(time: float, generator: torch.Generator) -> None:
    center = torch.tensor([3.0, -0.5], dtype=torch.float64)
    circle = Circle(0.4, center=(3.6, -0.5))
    rotation = Transport(Rotation(0.5, center=(3.0, -0.5)))

    def exact(x: Tensor, t: Tensor) -> Tensor:
        c, s = torch.cos(-0.5 * (t - time)), torch.sin(-0.5 * (t - time))
        y = x - center
        return circle.distance(center + torch.stack([c * y[:, 0] - s * y[:, 1], s * y[:, 0] + c * y[:, 1]], dim=1))

    placed = Placed(siren(2, 1), BOX)
    carried = Carried(placed, rotation, given(circle, BOX), time, n=2000, generator=generator)
    u, tau, values = carried.sample(generator)
    x, t = BOX.frame.from_unit(u), placed.times_in_units(tau)
    assert len(values) == 2000 and u.shape == (2000, 2)
    assert t.min() < 2.1 and t.max() > 5.9
    assert torch.allclose(2 * values, exact(x, t[:, 0]), rtol=0, atol=1e-6)
    assert (values[:1500].abs() < 0.05).double().mean() > 0.6
    assert (values[1500:].abs() < 0.05).double().mean() < 0.3

    solution = Explicit(lambda u, tau: exact(2 * u + center, 4 + 2 * tau[:, 0]) / 2, 2, 1)
    solved = Carried(Placed(solution, BOX), rotation, given(circle, BOX), time, n=200, generator=generator)
    assert solved.loss(*solved.sample(generator)).detach().max() < 1e-12


def test_characteristics_are_known_for_velocities_and_not_for_curvature() -> None:
    for space in (2, 3):
        assert Stationary().has_characteristics(space)
        assert Transport((1.0,) * space).has_characteristics(space)
        assert not MeanCurvature(rate=1).has_characteristics(space)
        assert not (Eikonal() + Transport((1.0,) * space)).has_characteristics(space)


def radius_at(t: Tensor, knots: dict[float, float]) -> Tensor:
    """Linear between the knots, constant beyond them."""
    times = sorted(knots)
    value = torch.full_like(t, knots[times[0]])
    for a, b in zip(times, times[1:], strict=False):
        part = ((t - a) / (b - a)).clamp(0, 1)
        value = value + part * (knots[b] - knots[a])
    return value


@pytest.mark.parametrize(
    "knots",
    [{2.0: 0.5, 6.0: 1.0}, {6.0: 0.4, 2.0: 0.9, 3.0: 0.6}, {4.0: 0.5}, {3.0: 0.5, 5.0: 1.0}],
    ids=["two", "three", "one stands still", "within the interval"],
)
def test_the_values_of_a_blend_are_linear_in_time(knots: dict[float, float], generator: torch.Generator) -> None:
    placed = Placed(siren(2, 1), BOX)
    samples = [given(Circle(r, center=(3.0, -0.5)), BOX) for r in knots.values()]
    blend = Blend(placed, samples, list(knots), n=3000)
    u, tau, values = blend.sample(generator)
    t = placed.times_in_units(tau)[:, 0]
    exact = u.norm(dim=1) - radius_at(t, knots) / 2
    assert torch.allclose(values, exact, rtol=0, atol=1e-12)
    assert t.min() < 2.1 and t.max() > 5.9

    solution = Explicit(lambda u, tau: u.norm(dim=1) - radius_at(4 + 2 * tau[:, 0], knots) / 2, 2, 1)
    assert Blend(Placed(solution, BOX), samples, list(knots), n=30).loss(u, tau, values).detach().max() < 1e-24


def test_in_a_loop_a_blend_goes_on_from_the_last_shape_to_the_first(generator: torch.Generator) -> None:
    placed = Placed(siren(2, 1), BOX)
    placed.loops = True
    knots = {3.0: 0.5, 5.0: 1.0}
    blend = Blend(placed, [given(Circle(r, center=(3.0, -0.5)), BOX) for r in knots.values()], list(knots), n=3000)
    u, tau, values = blend.sample(generator)
    round_again = {1.0: 1.0, 3.0: 0.5, 5.0: 1.0, 7.0: 0.5}
    exact = u.norm(dim=1) - radius_at(placed.times_in_units(tau)[:, 0], round_again) / 2
    assert torch.allclose(values, exact, rtol=0, atol=1e-12)


def test_a_blend_acts_until_it_is_said_to() -> None:
    placed = Placed(siren(2, 1), BOX)
    assert Blend(placed, [given(Circle(0.5, center=(3, -0.5)), BOX)], [2.0], n=10, until=0.25).until == 0.25
    assert Motion(placed, Stationary(), n=10, since=0.25).since == 0.25


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_an_equation_without_units_has_the_same_loss_in_all_units(scale: float) -> None:
    def loss(scale: float) -> Tensor:
        field = Placed(SIREN(2, 1, width=8, depth=2), Box((-scale, -scale), (scale, scale), ((0.0, 1.0),)))
        z = torch.rand(50, 3, generator=torch.Generator().manual_seed(0))
        return Motion(field, Eikonal(), n=4).loss(z).sum()

    assert torch.allclose(loss(scale), loss(1.0), rtol=1e-4)


def test_an_equation_sees_points_far_from_the_origin_exactly() -> None:
    seen = []

    class Look(Stationary):
        def speed(self, x: Tensor, t: Tensor, jet: Jet) -> Tensor:
            seen.append(x)
            return torch.zeros_like(jet.value)

    box = Box((4e6, 4e6), (4e6 + 2, 4e6 + 2), ((0.0, 1.0),))
    z = torch.rand(50, 3, generator=torch.Generator().manual_seed(0))
    Motion(Placed(SIREN(2, 1, width=8, depth=2), box), Look(), n=4).loss(z)
    assert (seen[0] - (4e6 + 1 + z[:, :2].double())).abs().max() < 1e-6


def test_errors_of_a_motion_by_curvature_are_forgiven_only_later() -> None:
    """At first an error of a tenth counts as its square, and at the end like a logarithm beyond a hundredth."""
    term = Smoothing(Placed(siren(2, 1), BOX), MeanCurvature(0.1), n=8)
    knees = []
    for term.spent in (0.0, 0.1, 0.35, 1.0):
        knees.append(term.knee)
    assert knees[0] == pytest.approx(Motion.knee)
    assert knees[1] == pytest.approx(Motion.knee * 0.1 ** (0.1 / 0.35))
    assert knees[2:] == pytest.approx([0.01, 0.01])


def test_nothing_comes_in_from_beyond_a_closed_surface(generator: torch.Generator) -> None:
    """A circle that shrinks is not charged; one with a piece in a corner at the last time is."""
    box = Box((-1, -1), (1, 1), ((0.0, 1.0),))

    def shrinking(u: Tensor, tau: Tensor) -> Tensor:
        return u.norm(dim=1) - (0.25 - 0.1 * (tau[:, 0] + 1)).sqrt()

    def stray(u: Tensor, tau: Tensor) -> Tensor:
        corner = (torch.cat([u, tau], dim=1) - 1).norm(dim=1) - 0.1
        return torch.minimum(shrinking(u, tau), corner)

    losses = []
    for field in (Explicit(shrinking, 2, 1), Explicit(stray, 2, 1)):
        term = Outside(Placed(field, box), given(Circle(0.5), box), n=2000, generator=generator)
        x, t = term.sample(generator)
        assert (x.norm(dim=1) > 0.5 + term.gap - 1e-6).all() and x.abs().max() == 1
        assert x.abs().amax(1).min() < 0.5
        assert (x.abs() == 1).all(1).any() and (t == 1).any()
        losses.append(float(term.loss(x, t).detach().max()))
    assert losses[0] == 0
    assert 0.1**2 < losses[1] < 0.1201**2
    wide = given(Circle(0.5, center=(0.6, 0.0)), box)
    assert not len(Outside(Placed(Explicit(stray, 2, 1), box), wide, n=2, generator=generator).points)


@pytest.mark.slow
def test_the_faces_of_a_cube_stay_inside_it() -> None:
    """By the principle of comparison a surface stays in its convex hull; faces once left the box at the start."""
    field = solve(
        MeanCurvature(0.1), SIREN(3, 1), at={0.0: Cuboid((1.2, 1.2, 1.2))}, until=1.0, budget=Budget(400),
        sampling=Sampling(4096),
    )  # fmt: skip
    volumes = []
    for t in (0.1, 0.2, 0.4, 0.8):
        surface = extract(field.at(t), resolution=64, refine=2)
        assert surface.is_watertight and surface.components == 1
        assert max(map(abs, (*surface.box.lower, *surface.box.upper))) < 0.605
        volumes.append(surface.volume)
    assert volumes == sorted(volumes, reverse=True)


def test_where_little_moves_errors_count_in_proportion(generator: torch.Generator) -> None:
    """A still circle of normalised radius 0.4 under curvature, which in half the time should move by rate / 0.8."""
    circle = Explicit(lambda u, tau: torch.linalg.vector_norm(u, dim=1) - 0.4, 2, 1)
    placed = Placed(circle, BOX)
    z = torch.tensor([[0.4, 0.0, 0.0]], dtype=torch.float64)
    shape = given(Circle(0.8, center=(3.0, -0.5)), BOX)
    for rate, enlarged in ((1.0, 1.0), (4e-3, None), (1e-5, Clinging.most)):
        term = Clinging(placed, MeanCurvature(rate), shape, n=2000)
        term.spent = 1.0
        samples = term.sample(generator)[0]
        error = rate / 0.8 * 2 / 2 / (1 + Motion.bend / 0.4)
        gain = term.gain
        assert gain == pytest.approx(enlarged or Clinging.slow / error, rel=0.02)
        knee = term.knee
        expected = knee**2 * math.log1p((gain * error / knee) ** 2)
        assert term.loss(z).item() == pytest.approx(expected, rel=1e-3)
        (z_next,) = term.sample(generator)
        assert unit(circle, z_next).std().item() == pytest.approx(Clinging.noise / gain, rel=0.1)
        assert len(samples) == 2000
        term.spent = 0.0
        assert term.gain == 1.0


def test_backwards_nothing_is_forgiven() -> None:
    """Late in the training errors saturate forwards in time, and count as at first backwards."""
    placed = Placed(Explicit(moving, 2, 1), BOX)
    shape = given(Circle(0.8, center=(3.0, -0.5)), BOX)
    for kind, knee in ((Clinging, Clinging.gentle), (Sharpening, Motion.knee)):
        term = kind(placed, MeanCurvature(0.1), shape, n=10)
        assert term.knee == pytest.approx(Motion.knee)
        term.spent = 1.0
        assert term.knee == pytest.approx(knee)


def test_samples_stay_with_the_given_shape(generator: torch.Generator) -> None:
    """Of two circles in the field only one is given, and no walker is on the other."""
    left, right = ([-0.5, 0.0], [0.5, 0.0])

    def two(u: Tensor, tau: Tensor) -> Tensor:
        return torch.stack([(u - u.new_tensor(c)).norm(dim=1) - 0.2 for c in (left, right)]).amin(0)

    placed = Placed(Explicit(two, 2, 1), BOX)
    shape = given(Circle(0.4, center=(2.0, -0.5)), BOX)
    (near,) = Clinging(placed, MeanCurvature(0.1), shape, n=500).sample(generator)
    assert (near[:, 0] < 0).all() and near[:, 2].std() == pytest.approx(1 / math.sqrt(3), rel=0.1)
    (spread,) = Smoothing(placed, MeanCurvature(0.1), n=500).sample(generator)
    assert 0.3 < (spread[:, 0] < 0).double().mean() < 0.7
