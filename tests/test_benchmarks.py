"""The rivals of the benchmarks: that they are what they claim to be, so that comparisons with them mean something."""

import importlib.util
import math
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch

from levelflow import SIREN, Box, Budget, Circle, Mesh, Placed, Rectangle, Sampling, extract, fit
from levelflow.conditions import Given
from levelflow.equations import Eikonal, LevelSetEquation, MeanCurvature, Morph, Rotation, Source, Stationary, Transport
from levelflow.flows import Edit, edge_distortion
from levelflow.handles import Handle, HandleWarning, SphereRegion
from levelflow.shapes import PointCloud, Sphere
from levelflow.shapes.implicit import Implicit
from levelflow.suite import HALF_WAY
from levelflow.suite.suite import along
from tests.fields import Explicit, differentiated
from tests.flows.examples import icosphere

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks"


def benchmark(name):
    """A script of the folder as a module."""
    spec = importlib.util.spec_from_file_location(f"benchmarks.{name}", FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


deformation, grid, keyframes, recipe, features, editing = (
    benchmark("deformation"),
    benchmark("grid"),
    benchmark("keyframes"),
    benchmark("recipe"),
    benchmark("features"),
    benchmark("editing"),
)
EXACT = {"dtype": torch.float64}


def radii(field, generator, center=(0.0, 0.0)):
    points = Implicit(field).sample(500, generator=generator).points
    return torch.linalg.vector_norm(points - torch.tensor(center, dtype=points.dtype), dim=1)


class Inflate(LevelSetEquation):
    def speed(self, x, t, jet):
        return torch.full_like(jet.value, 0.2)


def test_on_a_grid_shifted_circles_morph_as_the_suite_says():
    ends = {0.0: Circle(0.4, center=(-0.2, 0.0)), 1.0: Circle(0.5, center=(0.3, 0.0))}
    field = grid.solve(Morph(ends[1.0]), at=ends, resolution=96, **EXACT)
    angle = torch.arange(7, dtype=torch.float64) * math.pi / 6
    across = torch.stack([angle.cos(), angle.sin()], dim=1)
    found = along(field.at(0.5), torch.tensor([0.05, 0.0], dtype=torch.float64), across)
    assert (found - HALF_WAY).abs().max() < 3e-4


def test_on_a_grid_a_circle_shrinks_with_second_order(generator):
    errors = []
    for resolution in (24, 48):
        field = grid.solve(MeanCurvature(0.1), at={0.0: Circle(0.5)}, until=0.8, resolution=resolution, **EXACT)
        errors.append(max(float((radii(field.at(t), generator) / math.sqrt(0.25 - 0.2 * t) - 1).abs().max())
                          for t in (0.4, 0.8)))  # fmt: skip
    assert errors[1] < 1e-3 and math.log2(errors[0] / errors[1]) > 1.7


def test_on_a_grid_a_circle_is_carried_with_second_order(generator):
    errors = []
    for resolution in (24, 48):
        field = grid.solve(Transport((0.5, 0.2)), at={0.0: Circle(0.3)}, until=1.0, resolution=resolution, **EXACT)
        errors.append(float((radii(field.at(1.0), generator, (0.5, 0.2)) / 0.3 - 1).abs().max()))
    assert errors[1] < 2e-3 and math.log2(errors[0] / errors[1]) > 1.5


@pytest.mark.parametrize("until", [1.0, -1.0])
def test_on_a_grid_a_rectangle_turns_either_way(until, generator):
    shape, motion = Rectangle((0.8, 0.4), radius=0.1), Transport(Rotation(1.0))
    field = grid.solve(motion, at={0.0: shape}, until=until, resolution=48, **EXACT)
    points = Implicit(field.at(until)).sample(500, generator=generator).points
    back = motion.carry(points, torch.full((500,), until).double(), torch.zeros(500).double())
    assert shape.distance(back).abs().mean() < 3e-3


def test_on_a_grid_a_morph_is_linear_in_time(generator):
    field = grid.solve(Morph(Circle(0.6)), at={0.0: Circle(0.4), 1.0: Circle(0.6)}, resolution=32, **EXACT)
    for t in (0.0, 0.5, 1.0):
        assert (radii(field.at(t), generator) - 0.4 - 0.2 * t).abs().max() < 1e-3


def test_on_a_grid_motions_add_up(generator):
    """At the radius 0.5 curvature and inflation are in balance; without curvature the speed is constant."""
    field = grid.solve(Inflate() + MeanCurvature(0.1), at={0.0: Circle(0.5)}, until=0.5, resolution=32, **EXACT)
    assert (radii(field.at(0.5), generator) - 0.5).abs().max() < 1e-3
    field = grid.solve(Inflate(), at={0.0: Circle(0.5)}, until=0.5, box=Box((-1.0, -1.0), (1.0, 1.0)), resolution=32)
    assert (radii(field.at(0.5), generator) - 0.6).abs().max() < 1e-3


def test_on_a_grid_what_stands_still_is_the_same_and_what_vanishes_is_gone():
    field = grid.solve(Stationary(), at={0.0: Circle(0.5)}, until=1.0, resolution=16, **EXACT)
    x = torch.tensor([[0.5, 0.0], [0.0, 0.3]], dtype=torch.float64)
    assert torch.equal(field.at(0.0)(x), field.at(1.0)(x)) and field.provenance["steps"] == 0
    gone = grid.solve(MeanCurvature(1.0), at={0.0: Circle(0.3)}, until=0.5, resolution=16).at(0.5)
    assert (gone(Box((-0.3, -0.3), (0.3, 0.3)).uniform(100, generator=torch.Generator().manual_seed(0))) > 0).all()


def test_on_a_grid_sharpening_blows_up_and_says_so():
    field = grid.solve(MeanCurvature(0.1), at={0.0: Circle(0.5)}, until=(-0.4, 0.1), resolution=32)
    (since,) = field.provenance["blown_up"]
    assert -0.4 <= since < 0
    assert field.at(-0.4)(torch.zeros(1, 2).double()).isfinite()
    assert extract(field.at(0.1), resolution=32).box.size[0] == pytest.approx(2 * math.sqrt(0.23), rel=0.01)


def test_on_a_grid_fields_can_be_given_and_clouds_cannot(generator):
    samples = Circle(0.5).sample(100, generator=generator)
    cloud = PointCloud(samples.points.numpy(), samples.normals.numpy())
    with pytest.raises(TypeError, match="has no values to put on a grid; give a solid or a field"):
        grid.solve(Stationary(), at={0.0: cloud}, until=1.0)
    with pytest.raises(TypeError, match=r"grid.solve: Eikonal\(\) is no sum of motions"):
        grid.solve(Eikonal(), at={0.0: Circle(0.5)}, until=1.0)
    quick = {"budget": Budget(steps=2), "sampling": Sampling(n=64, given=500)}
    given = fit(SIREN(2, width=8), Circle(0.5), **quick)
    field = grid.solve(Stationary(), at={0.0: given}, until=1.0, resolution=48, **EXACT)
    x = Circle(0.5).sample(50, generator=generator).points
    assert torch.allclose(field.at(0.5)(x).float(), given(x), atol=1e-3)


def test_jets_on_a_grid_are_those_of_autograd(generator):
    field = grid.solve(MeanCurvature(0.1), at={0.0: Circle(0.5)}, until=0.5, resolution=16, **EXACT)
    x, t = field.box.uniform(20, generator=generator), field.box.uniform_times(20, generator=generator)
    jet, oracle = field.jet(x, t, order=2), differentiated(field, x, t)
    for name in ("value", "gradient", "dt", "hessian"):
        assert torch.allclose(getattr(jet, name), getattr(oracle, name).detach(), atol=1e-10)
    slice_ = field.at(0.2)
    jet, whole = slice_.jet(x, order=2), field.jet(x, torch.full((20, 1), 0.2).double(), order=2)
    for name in ("value", "gradient", "hessian"):
        assert torch.allclose(getattr(jet, name), getattr(whole, name), atol=1e-10)


def placed(width=16):
    """An untrained network in a box with a scale and an interval of its own."""
    network = SIREN(2, 1, width=width, depth=2, omega=recipe.OMEGA, dtype=torch.float64)
    return Placed(network, Box((-2.0, -1.0), (4.0, 1.0), ((0.5, 2.0),)))


@pytest.mark.parametrize(
    "motions",
    [
        (MeanCurvature(0.3),),
        (Transport(Source((0.2, 0.1))),),
        (Stationary(),),
        (MeanCurvature(0.2), Transport((1.0, 0.0))),
    ],
)
def test_the_residual_of_the_recipe_is_ours_in_normalised_coordinates(motions, generator):
    field = placed()
    u = 2 * torch.rand(50, 3, generator=generator, dtype=torch.float64) - 1
    x, t = u[:, :2], u[:, 2:]
    order = max(m.order for m in motions)
    found = recipe.residual(field, motions, x, t, *recipe.nested(field.field, x, t, order=order))
    equation = sum(motions[1:], start=motions[0])
    points, times = field.box.frame.from_unit(x), field.times_in_units(t)
    truth = equation.residual(points, times, field.jet(points, times, order=order)) * 0.75 / 3.0
    assert torch.allclose(found, truth, rtol=1e-9, atol=1e-11)


def test_the_morph_of_the_recipe_has_the_form_of_the_original(generator):
    field, target = placed(), Circle(0.6)
    u = 2 * torch.rand(50, 3, generator=generator, dtype=torch.float64) - 1
    x, t = u[:, :2], u[:, 2:]
    value, first, kappa = recipe.nested(field.field, x, t, order=1)
    found = recipe.residual(field, (Morph(target, since=0.5, until=2.0),), x, t, value, first, kappa)
    g = target.distance(field.box.frame.from_unit(x)) / 3.0
    truth = first[:, 2] - 0.5 * (g - value) * torch.exp(-(value**2)) * first[:, :2].norm(dim=1)
    assert torch.allclose(found, truth)


def test_the_loss_of_the_recipe_has_the_gradient_of_one_made_of_our_jets(generator):
    """A quarter on the surface and a quarter off it at the given time; the residual is asked of all points."""
    field, motions = placed(), (MeanCurvature(0.3),)
    given = {0.5: Given.of(Circle(0.6), field.box, n=200, generator=generator, like=field.field.last.weight)}
    sampling = Sampling(n=40, space_time=0.5, surface=0.25, volume=0.25)
    parameters = list(field.parameters())
    state = generator.get_state()
    loss = recipe.loss(field, motions, given, recipe.CURVATURE, sampling, generator)
    found = torch.autograd.grad(loss, parameters)

    generator.set_state(state)
    samples, weights = given[0.5], recipe.CURVATURE
    on, normals = recipe.pick(10, samples.points, samples.normals, generator=generator)
    off, distances = recipe.pick(10, samples.far, samples.far_values, generator=generator)
    u = 2 * torch.rand(20, 3, generator=generator, dtype=torch.float64) - 1
    x = torch.cat([on, off, u[:, :2] * torch.tensor([1.0, 1 / 3], dtype=torch.float64)])
    t = torch.cat([torch.full((20, 1), -1.0).double(), u[:, 2:]])
    jet = field.field.jet(x, t, order=2)
    values = jet.value[:20] - torch.cat([torch.zeros(10), distances])
    off_angle = 1 - torch.cosine_similarity(jet.gradient[:10], normals)
    residual = MeanCurvature(0.3 * 0.75 / 9).residual(x, t, jet)
    truth = (weights.distance * (values**2).sum() + weights.normal * off_angle.sum()) / 40
    truth = truth + weights.residual * (residual**2).mean()
    assert torch.allclose(loss, truth)
    for a, b in zip(found, torch.autograd.grad(truth, parameters), strict=True):
        assert torch.allclose(a, b, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("fitting", [0.0, 0.5])
def test_the_recipe_lowers_the_error_of_a_stationary_circle(fitting, generator):
    steps, sampling = [], Sampling(n=128, given=2000)
    field = recipe.solve(
        Stationary(), SIREN(2, 1, width=32, depth=2), at={0.0: Circle(0.5)}, until=1.0, budget=Budget(steps=400),
        sampling=sampling, fitting=fitting, on_step=lambda *now: steps.append(now),
    )  # fmt: skip
    assert [step for step, _, _ in steps] == list(range(1 + round(400 * fitting), 401))
    assert all(a[1] <= b[1] for a, b in zip(steps[:-1], steps[1:], strict=True))
    x = Circle(0.5).sample(200, generator=generator).points
    assert Implicit(field.at(0.0)).gap(x).mean() < 0.06
    assert field.field.omega == 30 and field.provenance["steps"] == 400


def test_the_recipe_takes_motions_only():
    with pytest.raises(TypeError, match=r"recipe.solve: Eikonal\(\) is no sum of motions"):
        recipe.solve(Eikonal(), SIREN(2, 1, width=8), at={0.0: Circle(0.5)}, until=1.0)


def test_time_for_measuring_does_not_count():
    clock = recipe.Clock(Budget(seconds=100.0))
    with clock.stopped():
        time.sleep(0.2)
    assert clock.seconds < 0.1 and clock.spent < 1e-3


@pytest.mark.parametrize(("power", "jump", "bend"), [(1, 1.0, 0.0), (2, 1.95, 0.4)], ids=["steady", "accelerated"])
def test_a_growing_circle_is_judged_by_its_formulas(power, jump, bend):
    """Its radius is 0.3 + 0.2 t^p: the path is as long as the radius grows, whatever the values of the field."""
    growing = Explicit(
        lambda x, t: (2 + x[:, 0]) * (x.norm(dim=1) - 0.3 - 0.2 * t[:, 0] ** power), 2, 1,
        box=Box((-1.0, -1.0), (1.0, 1.0), ((0.0, 1.0),)),
    )  # fmt: skip
    found = keyframes.judge(growing, {0.0: Circle(0.3), 1.0: Circle(0.5)})
    assert found.ends < 1e-4 and found.worst < 1e-3
    assert found.length == pytest.approx(0.2, rel=1e-3)
    assert found.jump == pytest.approx(jump, rel=0.01)
    assert found.bend == pytest.approx(bend, abs=0.02)
    t = np.linspace(0, 1, 21)
    radius = 0.3 + 0.2 * t**power
    assert found.area == pytest.approx(np.abs(radius / (0.3 + 0.2 * t) - 1).mean(), abs=1e-3)
    assert found.volume == pytest.approx(np.abs(radius**2 / (0.09 + 0.16 * t) - 1).mean(), abs=1e-3)
    assert found.parts == (1, 1)


def test_what_leaves_the_box_or_vanishes_is_judged_as_well():
    box = Box((-1.0, -1.0), (1.0, 1.0), ((0.0, 1.0),))
    plane = keyframes.mesh_of(lambda x: x[:, 0], box.during(), 32)
    assert plane.is_watertight and plane.volume == pytest.approx(2.0, abs=0.01)
    shrinking = Explicit(lambda x, t: x.norm(dim=1) - 0.48 + t[:, 0], 2, 1, box=box)
    found = keyframes.judge(shrinking, {0.0: Circle(0.48)}, resolution=64)
    assert found.parts == (0, 1) and found.length == pytest.approx(0.45, abs=0.06)
    assert "0-1" in str(found) and len(str(found)) == len(keyframes.HEAD)


def test_the_part_whose_edges_are_to_stay_is_closed_and_at_its_distance(generator):
    clean = features.part()
    assert clean.is_watertight and clean.components == 1
    x = 2 * torch.rand(300, 3, generator=generator, dtype=torch.float64) - 1
    assert torch.allclose(clean.distance(x), features.distance(x), atol=1e-12)
    assert max(features.errors(clean)) < 1e-12
    noise, edges, corners = features.errors(features.noisy(clean, 0.01, 0))
    assert 0.003 < noise < 0.01 and 0.003 < edges < 0.01 and corners > 0.003


def test_the_time_to_a_noise_is_linear_between_those_that_are_known():
    times, noises = [0.0, 1.0, 3.0], [0.5, 0.3, 0.1]
    assert features.when(times, noises, 0.5) == 0.0
    assert features.when(times, noises, 0.2) == pytest.approx(2.0)


def test_libigl_takes_a_surface_whose_handles_turn_together_along_rigidly():
    ball = extract(Sphere(0.5).distance, box=Box((-1.0,) * 3, (1.0,) * 3), resolution=12)
    around = {"angle": 50.0, "axis": (0.0, 0.0, 1.0), "center": (0.1, 0.0, 0.0)}
    handles = [Handle.rotate(SphereRegion((0.0, side, 0.0), 0.25), **around) for side in (0.5, -0.5)]
    with pytest.warns(HandleWarning, match="all handles"):
        edit = Edit(ball, handles)
    after = editing.by_libigl(edit, steps=4)
    assert edge_distortion(ball, after) < 1e-4
    assert after.vertices == pytest.approx(handles[0].target(ball.vertices, 1.0), abs=1e-4)


def test_the_edits_of_the_benchmark_have_regions_on_one_side_of_a_plane():
    half = editing.beyond(1, -0.45, above=False)
    assert (half.distance(np.array([[3.0, -0.5, -2.0], [0.0, -0.4, 0.0]])) > 0).tolist() == [False, True]


def test_energies_of_deformed_meshes_are_those_of_known_deformations():
    """A rigid motion costs nothing, a scale stretches, a plate of a regular grid that is rolled up costs 3 / r^2."""
    ball = icosphere(3)
    assert deformation.stretch(ball, Mesh(ball.vertices + 3, ball.faces)) < 1e-20
    assert deformation.bend(ball, Mesh(2 * ball.vertices, ball.faces), 1.0) < 1e-20
    assert abs(deformation.stretch(ball, Mesh(2 * ball.vertices, ball.faces)) - 2 * 0.75**2 * 4) < 1e-9
    x, y = (part.reshape(-1) for part in np.meshgrid(np.linspace(0, 1, 81), np.linspace(0, 1, 81), indexing="ij"))
    i = (np.arange(80)[:, None] * 81 + np.arange(80)).reshape(-1)
    faces = np.concatenate([np.stack([i, i + 81, i + 82], 1), np.stack([i, i + 82, i + 1], 1)])
    flat = Mesh(np.stack([x, y, 0 * x], 1), faces)
    rolled = Mesh(np.stack([np.sin(x), y, 1 - np.cos(x)], 1), faces)
    assert deformation.stretch(flat, rolled) < 1e-6
    assert abs(deformation.bend(flat, rolled, 1.0) - 3) < 0.05
    assert deformation.cuts(rolled) == 0
    upright = flat.vertices[:, [0, 2, 1]] + [0.01, 0.5, -0.5]
    crossed = Mesh(np.concatenate([flat.vertices, upright]), np.concatenate([faces, faces + len(x)]))
    assert deformation.cuts(crossed) > 0
