"""Two-dimensional evolutions against their exact solutions; the three-dimensional ones are in benchmarks/exact.py."""

import math

import numpy as np
import pytest
import torch

from levelflow import (
    SIREN,
    Box,
    Budget,
    Circle,
    Divergence,
    LipschitzMLP,
    Periodic,
    Placed,
    Rectangle,
    Sampling,
    equations,
    extract,
    fit,
    lift,
    load,
    save,
    solve,
)
from levelflow.shapes.cloud import PointCloud
from levelflow.shapes.implicit import Implicit
from tests.fields import Explicit

FEW = Sampling(n=512, given=10_000)
QUICK = {"budget": Budget(steps=250), "sampling": Sampling(n=1024, given=20_000)}


def network(**more):
    return SIREN(2, 1, width=32, depth=2, **more)


def radii(field, t, generator, center=(0.0, 0.0)):
    points = Implicit(field.at(t)).sample(500, generator=generator).points
    return torch.linalg.vector_norm(points - torch.tensor(center, dtype=points.dtype), dim=1)


def test_a_circle_shrinks_by_its_curvature(generator):
    field = solve(equations.MeanCurvature(0.1), network(), at={0.0: Circle(0.5)}, until=0.8, **QUICK)
    for t in (0.0, 0.4, 0.8):
        exact = math.sqrt(0.25 - 0.2 * t)
        assert (radii(field, t, generator) - exact).abs().max() < 0.005


def test_a_circle_approaches_another_exponentially(generator):
    field = solve(
        equations.Approach(Circle(0.8)), network(), at={0.0: Circle(0.4)}, until=1.5, budget=Budget(steps=400),
        sampling=FEW,
    )  # fmt: skip
    assert field.box.upper[0] > 0.8
    for t in (0.0, 0.5, 1.0, 1.5):
        assert (radii(field, t, generator) - 0.8 + 0.4 * math.exp(-t)).abs().mean() < 0.006


def test_without_an_equation_only_the_keyframes_are_given(generator):
    """And all samples are theirs."""
    seen, keys = [], {0.0: Circle(0.3), 0.5: Circle(0.5), 1.0: Circle(0.4)}
    field = solve(
        equations.Unconstrained(),
        network(),
        at=keys,
        budget=Budget(steps=250),
        sampling=FEW,
        on_step=lambda progress: seen.append(progress.losses),
    )
    assert all({*losses} == {"surface", "distance"} for losses in seen)
    assert field.provenance["equation"] == "Unconstrained()" and field.provenance["warm_up"] == 0
    for t, shape in keys.items():
        assert (radii(field, t, generator) - shape.radius).abs().max() < 0.005


def test_a_lipschitz_network_is_smooth_between_keyframes_and_comes_back_from_its_file(generator, tmp_path):
    seen, mine = [], LipschitzMLP(2, 1, width=16, depth=2)
    field = solve(
        equations.Unconstrained(), mine, at={0.0: Circle(0.3), 1.0: Circle(0.5)}, budget=Budget(steps=400),
        sampling=FEW, on_step=lambda progress: seen.append(progress.losses),
    )  # fmt: skip
    assert {*seen[-1]} == {"surface", "distance", "steepness"}
    assert field.field.lipschitz < 0.9 * mine.lipschitz
    for t, radius in ((0.0, 0.3), (1.0, 0.5)):
        assert (radii(field, t, generator) - radius).abs().mean() < 0.02
    between = radii(field, 0.5, generator)
    assert between.min() > 0.25
    assert between.max() < 0.55
    save(field, tmp_path / "f.safetensors")
    again = load(tmp_path / "f.safetensors")
    x, t = field.box.uniform(50, generator=generator), field.box.uniform_times(50, generator=generator)
    assert torch.equal(field(x, t), again(x, t)) and again.provenance == field.provenance
    assert isinstance(again.field, LipschitzMLP) and torch.equal(again.field.lipschitz, field.field.lipschitz)


@pytest.mark.parametrize(
    ("equation", "radius"),
    [
        (equations.MeanCurvature(0.1), lambda t: math.sqrt(0.25 - 0.2 * t)),
        (equations.Morph(Circle(0.3)), lambda t: 0.5 - 0.2 * t),
    ],
    ids=["second order", "first order"],
)
def test_a_lipschitz_network_follows_an_equation(equation, radius, generator):
    field = solve(
        equation, LipschitzMLP(2, 1, width=16, depth=2), at={0.0: Circle(0.5)}, until=1.0, budget=Budget(steps=800),
        sampling=FEW,
    )  # fmt: skip
    for t in (0.0, 0.5, 1.0):
        assert (radii(field, t, generator) - radius(t)).abs().mean() < 0.005


def test_backwards_in_time_it_grows(generator):
    with pytest.warns(UserWarning, match="sharpens before t = 0, which is ill-posed"):
        field = solve(
            equations.MeanCurvature(0.1), network(), at={0.0: Circle(0.5)}, until=-0.2,
            budget=Budget(steps=600), sampling=QUICK["sampling"],
        )  # fmt: skip
    assert (radii(field, -0.2, generator) - math.sqrt(0.25 + 0.04)).abs().max() < 0.005


def test_before_and_after_the_given_time_are_equally_exact(generator):
    with pytest.warns(UserWarning, match="sharpens before"):
        field = solve(equations.MeanCurvature(0.1), network(), at={0.0: Circle(0.5)}, until=(-0.2, 0.8), **QUICK)
    for t in (-0.2, 0.0, 0.4, 0.8):
        assert (radii(field, t, generator) - math.sqrt(0.25 - 0.2 * t)).abs().max() < 0.005


def test_units_do_not_matter(generator):
    """A circle a thousand times as large, far away, with rate and times to match, has the same radii."""
    center = (5e4, -2e4)
    shape = Circle(500.0, center=center)
    field = solve(equations.MeanCurvature(1e5 / 4), network(), at={2.0: shape}, until=5.2, **QUICK)
    for t in (2.0, 5.2):
        exact = 1000 * math.sqrt(0.25 - 0.2 * (t - 2) / 4)
        assert (radii(field, t, generator, center) - exact).abs().max() < 5


def test_a_rotated_rectangle_is_where_characteristics_bring_it(generator):
    shape, motion = Rectangle((0.8, 0.4), radius=0.1), equations.Transport(equations.Rotation(1.0))
    field = solve(motion, network(), at={0.0: shape}, until=1.0, **QUICK)
    points = Implicit(field.at(1.0)).sample(500, generator=generator).points
    back = motion.carry(points, torch.ones(500).double(), torch.zeros(500).double())
    assert shape.distance(back).abs().mean() < 0.006


def test_the_box_holds_the_whole_motion():
    field = solve(
        equations.Transport((3.0, 0.0)), network(), at={0.0: Circle(0.5)}, until=1.0, budget=Budget(steps=1),
        sampling=Sampling(n=64, given=1000),
    )  # fmt: skip
    assert field.box.lower[0] < -0.5 and field.box.upper[0] > 3.5
    assert field.box.times == ((0.0, 1.0),)


def test_a_morph_of_concentric_circles_is_linear_in_time(generator):
    field = solve(equations.Morph(Circle(0.6)), network(), at={0.0: Circle(0.4), 1.0: Circle(0.6)}, **QUICK)
    for t in (0.0, 0.25, 0.5, 0.75, 1.0):
        assert (radii(field, t, generator) - 0.4 - 0.2 * t).abs().max() < 0.008


def test_what_is_held_stays_while_the_rest_moves(generator):
    """Half of a circle is held; curvature draws the other half towards the chord between its ends."""
    half = equations.Regional(equations.MeanCurvature(0.1), lambda x: (x[:, 0] / 0.1).clamp(0, 1))
    field = solve(half, network(), at={0.0: Circle(0.5)}, until=1.0, **QUICK)
    points = Implicit(field.at(1.0)).sample(2000, generator=generator).points
    off = points.norm(dim=1) - 0.5
    assert off[points[:, 0] < 0].abs().mean() < 0.004
    assert off[points[:, 0] > 0.1].mean() < -0.1


def test_a_morph_passes_through_all_of_its_keyframes(generator):
    targets = {0.5: Circle(0.6), 1.0: Circle(0.3)}
    field = solve(equations.Morph(targets), network(), at={0.0: Circle(0.4), **targets}, **QUICK)
    for t, radius in ((0.0, 0.4), (0.5, 0.6), (1.0, 0.3)):
        assert (radii(field, t, generator) - radius).abs().mean() < 0.008
    assert (radii(field, 0.25, generator) - 0.5).abs().mean() < 0.03


def test_motions_add_up(generator):
    motion = equations.Transport((0.5, 0.0)) + equations.MeanCurvature(0.1)
    field = solve(motion, network(), at={0.0: Circle(0.5)}, until=0.5, box=Box((-0.8, -0.8), (1.0, 0.8)), **QUICK)
    assert (radii(field, 0.5, generator, (0.25, 0.0)) - math.sqrt(0.15)).abs().max() < 0.008


def test_it_starts_from_a_fitted_field(generator):
    shape = Circle(0.5)
    start = fit(SIREN(2, width=32, depth=2), shape, **QUICK)
    field = solve(
        equations.MeanCurvature(0.1), network(), at={0.0: start}, until=0.4, start=start,
        **QUICK,
    )  # fmt: skip
    assert (radii(field, 0.0, generator) - 0.5).abs().max() < 0.01
    assert (radii(field, 0.4, generator) - math.sqrt(0.17)).abs().mean() < 0.006
    assert field.provenance["accuracy"]["0"]["mean"] < 0.003


def test_a_point_cloud_is_enough(generator):
    points, _ = Circle(0.5).sample(400, generator=generator)
    field = solve(equations.MeanCurvature(0.1), network(), at={0.0: PointCloud(points.numpy())}, until=0.4, **QUICK)
    assert (radii(field, 0.0, generator) - 0.5).abs().max() < 0.01
    assert (radii(field, 0.4, generator) - math.sqrt(0.17)).abs().max() < 0.01


def test_the_same_seed_gives_the_same_bits_and_an_interrupted_run_ends_the_same():
    states = []

    def keep(progress):
        if progress.step == 20:
            states.append(progress.state())

    problem = (equations.MeanCurvature(0.1), network())
    given = {"at": {0.0: Circle(0.5)}, "until": 0.5}
    short = {"budget": Budget(steps=40), "sampling": Sampling(n=256, given=2000), "seed": 5}
    once = solve(*problem, **given, **short, on_step=keep)
    again = solve(*problem, **given, **short)
    resumed = solve(*problem, **given, **short, state=states[0])
    other = solve(*problem, **given, **{**short, "seed": 6})
    for a, b, c in zip(once.parameters(), again.parameters(), resumed.parameters(), strict=True):
        assert torch.equal(a, b) and torch.equal(a, c)
    assert any(not torch.equal(a, b) for a, b in zip(once.parameters(), other.parameters(), strict=True))


def test_the_given_network_is_not_changed():
    mine = network()
    before = [p.clone() for p in mine.parameters()]
    solve(equations.Stationary(), mine, at={0.0: Circle(0.5)}, until=1.0, budget=Budget(steps=2))
    assert all(torch.equal(a, b) for a, b in zip(before, mine.parameters(), strict=True))


def test_divergence_stops_with_the_last_good_field():
    class Mad(equations.LevelSetEquation):
        def speed(self, x, t, jet):
            return jet.value * float("nan")

    with pytest.raises(Divergence, match="diverged at step") as caught:
        solve(Mad(), network(), at={0.0: Circle(0.5)}, until=1.0, budget=Budget(steps=9), warm_up=0.0)
    assert all(torch.isfinite(p).all() for p in caught.value.field.parameters())


def test_a_volume_is_kept_and_the_longer_shape_becomes_rounder():
    field = solve(
        equations.VolumePreserving(equations.MeanCurvature(1.0)), network(),
        at={0.0: Rectangle((0.8, 0.4), radius=0.1)}, until=0.03,
        budget=Budget(steps=250), sampling=Sampling(n=1024, given=5000),
    )  # fmt: skip
    before, after = (extract(field.at(t), resolution=128, refine=3) for t in (0.0, 0.03))
    assert after.volume == pytest.approx(before.volume, rel=2e-3)
    assert after.area < 0.93 * before.area
    assert len(set(field.box.size)) == 1


@pytest.mark.parametrize(
    ("equation", "inner", "message"),
    [
        (
            equations.VolumePreserving(equations.MeanCurvature(1.0)) + equations.MeanCurvature(1.0),
            SIREN(2, 1),
            "put ever",
        ),
        (equations.Willmore(1.0), Periodic(SIREN(2, 2), time=True), "must be a SIREN"),
    ],
    ids=["volume of a part", "fourth order"],
)
def test_what_cannot_be_solved_is_explained(equation, inner, message):
    with pytest.raises(ValueError, match=message):
        solve(equation, inner, at={0.0: Circle(0.3)}, until=0.1, budget=Budget(steps=1))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"at": {}}, "at least one shape"),
        ({"at": {0.0: Circle(1.0)}}, "say how far to go"),
        ({"at": {0.0: Circle(1.0)}, "until": math.nan}, "finite numbers"),
        ({"at": {0.0: Circle(1.0)}, "until": 1.0, "warm_up": 1.0}, "warm_up=1"),
        ({"at": {0.0: Circle(1.0)}, "until": 1.0, "network": SIREN(2)}, "network has 0 times"),
    ],
)
def test_wrong_use_is_explained(unchecked, arguments, message):
    with pytest.raises(ValueError, match=message):
        solve(equations.Stationary(), arguments.pop("network", network()), **arguments)


@pytest.mark.parametrize(
    ("inner", "place"),
    [
        (SIREN(2, width=33, depth=2), Circle(0.5).box),
        (SIREN(2, width=32, depth=3), Circle(0.5).box),
        (SIREN(2, 2, width=8, depth=2), Circle(0.5).box.during((0.0, 1.0), (0.0, 1.0))),
        (SIREN(3, width=8, depth=2), Box((-1.0,) * 3, (1.0,) * 3)),
    ],
    ids=["wider", "deeper", "two parameters", "another space"],
)
def test_a_start_that_does_not_fit_is_explained(inner, place):
    problem = {"at": {0.0: Circle(0.5)}, "until": 1.0}
    with pytest.raises(ValueError, match=r"static or with as many times.*this one \(2 layers, 32 wide\)"):
        solve(equations.Stationary(), network(), start=Placed(inner, place), **problem)


def test_a_lipschitz_network_has_no_start(generator):
    start = Placed(SIREN(2, width=8), Circle(0.5).box)
    with pytest.raises(ValueError, match=r"a LipschitzMLP cannot be lifted.*leave start out, or give SIREN\(2, 1\)"):
        solve(equations.Stationary(), LipschitzMLP(2, 1, width=8), at={0.0: Circle(0.5)}, until=1.0, start=start)


def test_a_smaller_start_is_lifted_and_a_lifted_field_is_a_start(generator):
    """Wider, deeper, in space-time, in another box and over another interval: the same field up to one small step."""
    shape = Circle(0.5)
    still = fit(SIREN(2, width=32, depth=2), shape, **QUICK)
    lifted = Placed(lift(still.field, depth=3), still.box.during((0.0, 1.0)))
    x = still.box.uniform(200, generator=generator)
    for start in (still, lifted):
        found = solve(
            equations.MeanCurvature(0.1), SIREN(2, 1, width=40, depth=3), at={0.0: shape}, until=0.3, start=start,
            box=Box((-1.0, -1.5), (1.2, 1.5)), budget=Budget(steps=1), sampling=Sampling(n=8, given=200),
        )  # fmt: skip
        assert (found.field.times, found.field.width, found.field.depth) == (1, 40, 3)
        with torch.no_grad():
            for t in (0.0, 0.3):
                assert (found.at(t)(x) - still(x)).abs().max() < 0.05


def test_a_motion_goes_on_from_a_motion_in_a_deeper_network(generator):
    problem = {"at": {0.0: Circle(0.5)}, "sampling": QUICK["sampling"]}
    first = solve(equations.MeanCurvature(0.1), network(), until=0.2, budget=Budget(steps=100), **problem)
    field = solve(
        equations.MeanCurvature(0.1), SIREN(2, 1, width=40, depth=3), until=0.4, start=first, budget=Budget(steps=100),
        **problem,
    )  # fmt: skip
    assert field.box.times == ((0.0, 0.4),)
    assert (radii(field, 0.0, generator) - 0.5).abs().max() < 0.01
    assert (radii(field, 0.4, generator) - math.sqrt(0.17)).abs().mean() < 0.01


def test_a_start_may_lie_in_another_box(generator):
    """A field fitted in its own small box starts a motion that leaves it, and is the same field at first."""
    shape = Circle(0.5)
    start = fit(SIREN(2, width=32, depth=2), shape, **QUICK)
    moved = solve(
        equations.Transport((3.0, 0.0)) + equations.MeanCurvature(0.01), network(), at={0.0: shape}, until=1.0,
        start=start, box=Box((-1.0, -2.0), (5.0, 2.0)), budget=Budget(steps=1), sampling=Sampling(n=8, given=200),
    )  # fmt: skip
    x = start.box.uniform(200, generator=generator)
    with torch.no_grad():
        assert (moved.at(0.0)(x) - start(x)).abs().max() < 0.1
    assert moved.box.upper == (5.0, 2.0)


def test_what_is_given_must_be_a_shape_or_a_field(unchecked):
    with pytest.raises(TypeError, match=r"'bunny.obj' is neither a shape nor a field"):
        solve(equations.Stationary(), network(), at={0.0: "bunny.obj"}, until=1.0)
    with pytest.raises(ValueError, match=r"has 3 space coordinates, a shape has 2"):
        solve(equations.Stationary(), SIREN(3, 1), at={0.0: Circle(0.5)}, until=1.0)
    with pytest.raises(ValueError, match="does not contain the given surface"):
        solve(equations.Stationary(), network(), at={0.0: Circle(0.5)}, until=1.0, box=Box((5.0, 5.0), (6.0, 6.0)))


def test_a_fitted_field_that_leaves_its_own_box_brings_no_ghosts():
    start = fit(SIREN(2, width=32, depth=2), Circle(0.5), **QUICK)
    field = solve(equations.Transport((2.0, 0.0)), network(), at={0.0: start}, until=1.0, **QUICK)
    for t in (0.0, 1.0):
        curve = extract(field.at(t), resolution=64)
        assert curve.components == 1 and abs(curve.volume / (math.pi / 4) - 1) < 0.05


CELL = Box((-1.0, -1.0), (1.0, 1.0))


def cell(time=1, **more):
    """A network that is periodic along x."""
    return Periodic(SIREN(3, time, width=32, depth=2, **more), axes=(0,))


def ellipse(a, b):
    """A field near the distance to an ellipse."""

    def value(x, t):
        ratio, slope = ((x / x.new_tensor(axes)).norm(dim=1) for axes in ((a, b), (a * a, b * b)))
        return ratio * (ratio - 1) / slope.clamp_min(1e-9)

    return Explicit(value, 2, box=CELL)


def test_a_loop_from_a_circle_to_an_ellipse_and_back_meets_its_keys_and_has_no_seam(generator):
    circle, oval = Circle(0.5), ellipse(0.7, 0.35)
    field = solve(
        equations.Morph({0.5: oval, 1.0: circle}), Periodic(SIREN(2, 2, width=32, depth=2), time=True),
        at={0.0: circle, 0.5: oval}, until=1.0, budget=Budget(400), sampling=QUICK["sampling"],
    )  # fmt: skip
    assert field.loops and field.box.times == ((0.0, 1.0),)
    assert all(accuracy["max"] < 0.01 for accuracy in field.provenance["accuracy"].values())
    assert (radii(field, 1.0, generator) - 0.5).abs().max() < 0.01
    # The way there and the way back are the same, half of the way at a quarter of the time.
    waists = [radii(field, t, generator).min() for t in (0.25, 0.75)]
    assert all(abs(waist - (0.5 + 0.35) / 2) < 0.02 for waist in waists)
    x = CELL.uniform(200, generator=generator)
    first, last = (field.jet(x, torch.full((200, 1), t), order=2) for t in (0.0, 1.0))
    for part in ("value", "first", "second"):
        assert torch.allclose(getattr(first, part), getattr(last, part), rtol=1e-3, atol=1e-3)
    times = torch.linspace(0.9, 1.1, 21, dtype=torch.float64)
    rates = torch.stack([field.jet(x, t.expand(200, 1)).dt[:, 0] for t in times])
    steepest = (rates[1:] - rates[:-1]).abs().max(1).values
    assert steepest[9:11].max() < 2 * steepest.median()


def test_a_ripple_in_a_periodic_box_flattens_by_its_curvature(generator):
    """y(x, t) solves y_t = rate y_xx / (1 + y_x^2) on a circle; the reference is by finite differences."""
    rate, height = 0.1, 0.25
    ripple = Explicit(lambda x, t: x[:, 1] - height * torch.cos(math.pi * x[:, 0]), 2, box=CELL)
    field = solve(equations.MeanCurvature(rate), cell(), at={0.0: ripple}, until=1.0, box=CELL, **QUICK)
    grid = np.linspace(-1, 1, 101)
    y, h, dt = height * np.cos(np.pi * grid[:-1]), 0.02, 1e-3
    heights = [y]
    for _ in range(1000):
        left, right = np.roll(y, 1), np.roll(y, -1)
        y = y + dt * rate * (right - 2 * y + left) / h**2 / (1 + ((right - left) / (2 * h)) ** 2)
        heights.append(y)
    for t in (0.0, 0.5, 1.0):
        points = Implicit(field.at(t)).sample(500, generator=generator).points.numpy()
        exact = heights[round(1000 * t)]
        assert np.abs(points[:, 1] - np.interp(points[:, 0], grid, np.append(exact, exact[0]))).max() < 0.005


def test_a_circle_that_is_carried_by_a_whole_period_comes_back_on_the_other_side(generator):
    motion = equations.Transport(equations.Constant((2.0, 0.0)))
    field = solve(motion, cell(), at={0.0: Circle(0.5)}, until=1.0, box=CELL, **QUICK)
    for t in (0.0, 1.0):
        assert (radii(field, t, generator) - 0.5).abs().mean() < 0.01
    halfway = Implicit(field.at(0.5)).sample(500, generator=generator).points
    around = torch.where(
        halfway[:, :1] > 0, halfway - halfway.new_tensor([1.0, 0]), halfway + halfway.new_tensor([1.0, 0])
    )
    assert (around.norm(dim=1) - 0.5).abs().mean() < 0.01


def test_what_is_periodic_is_explained():
    loop = Periodic(SIREN(2, 2, width=8, depth=2), time=True)
    with pytest.raises(ValueError, match=r"in a loop t = 0 and t = 1 are the same instant.*\{0: shape\}, .*until=1"):
        solve(equations.Morph(Circle(0.4)), loop, at={0.0: Circle(0.5), 1.0: Circle(0.4)})
    with pytest.raises(ValueError, match=r"solve: the network is periodic along x; say what its cell is"):
        solve(equations.Stationary(), cell(), at={0.0: Circle(0.5)}, until=1.0)
    start = Placed(SIREN(2, width=8, depth=2), CELL)
    with pytest.raises(ValueError, match=r"a Periodic cannot be lifted from another network; .* give SIREN\(2, 1\)"):
        solve(equations.Stationary(), loop, at={0.0: Circle(0.5)}, until=1.0, start=start)
