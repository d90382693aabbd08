"""Mean curvature flow of meshes against spheres, circles, cylinders and tori; smoothing that does not shrink."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from levelflow.flows import MeanCurvature, Taubin
from levelflow.flows.laplacian import Laplacian
from levelflow.flows.normals import smooth_normals
from levelflow.shapes import Mesh, Torus
from tests.axisymmetric import Revolved
from tests.flows.examples import after, arc, ball, extracted, icosphere, moved, polygon, ring, tube, wound

RATE = 0.1


def radii(mesh: Mesh) -> np.ndarray:
    return np.linalg.norm(mesh.vertices, axis=1)


def shrunk(space: int, t: float, *, start: float = 0.5) -> float:
    return math.sqrt(start**2 - 2 * (space - 1) * RATE * t)


@pytest.mark.parametrize("space", [2, 3])
def test_balls_shrink_as_the_exact_ones_to_first_order_in_dt(space: int) -> None:
    until = 0.4 / (space - 1)
    mesh, truth = ball(space, 60 if space == 2 else 20), shrunk(space, until)
    errors = [abs(radii(after(MeanCurvature(RATE), mesh, until=until, steps=n)).mean() - truth) for n in (5, 10, 20)]
    assert errors[-1] < 0.005
    assert np.all(np.log2(np.divide(errors[:-1], errors[1:])) > 0.8)


@pytest.mark.parametrize(("space", "resolutions"), [(2, (6, 12, 24, 48)), (3, (8, 16, 32))])
def test_balls_shrink_as_the_exact_ones_to_second_order_in_the_resolution(
    space: int, resolutions: tuple[int, ...]
) -> None:
    """At equal time, whatever the resolution; the error of the steps goes by extrapolation from two numbers of them."""
    until, truth = 0.2, shrunk(space, 0.2)
    errors = []
    for resolution in resolutions:
        few, many = (after(MeanCurvature(RATE), ball(space, resolution), until=until, steps=n).volume for n in (10, 20))
        unit = math.pi if space == 2 else 4 / 3 * math.pi
        errors.append(abs(((2 * many - few) / unit) ** (1 / space) - truth))
    order = np.polyfit(np.log(resolutions), np.log(errors), 1)[0]
    assert order < -1.6
    assert errors[-1] < 2e-3


def test_the_speed_on_a_torus_is_its_curvature() -> None:
    """In the mean over the vertices of a regular grid, whose diagonals all lean to one side: of first order."""
    errors = []
    for n in (12, 24, 48):
        mesh, curvature = wound(2 * n, n)
        mass = Laplacian.of(mesh.vertices, mesh.faces).mass
        step = MeanCurvature(RATE).displacement(mesh, 1e-7, time=0.0) / 1e-7
        speed = (step * smooth_normals(mesh)).sum(1)
        errors.append((mass * np.abs(speed + RATE * curvature)).sum() / mass.sum() / RATE)
    assert errors[-1] < 0.02
    assert np.all(np.log2(np.divide(errors[:-1], errors[1:])) > 0.95)


def test_the_speed_on_an_extracted_torus_is_its_curvature() -> None:
    """In a step that smooths over the length of an edge; the greatest curvature is about 4."""
    errors = []
    for resolution in (16, 32, 64):
        mesh = ring(resolution)
        across = np.linalg.norm(mesh.vertices[:, :2], axis=1)
        curvature = 1 / 0.25 + (across - 0.6) / 0.25 / across
        mass = Laplacian.of(mesh.vertices, mesh.faces).mass
        dt = 0.5 * (2 / resolution) ** 2 / RATE
        step = MeanCurvature(RATE).displacement(mesh, dt, time=0.0) / dt
        speed = (step * smooth_normals(mesh)).sum(1)
        errors.append((mass * np.abs(speed + RATE * curvature)).sum() / mass.sum() / RATE / 4)
    assert errors[-1] < 0.02
    assert np.polyfit(np.log([16, 32, 64]), np.log(errors), 1)[0] < -1.2


def test_a_torus_moves_as_its_section_does() -> None:
    """Against the level-set method in the half plane, which shares nothing with meshes."""
    until = 0.12
    reference = Revolved(Torus(0.6, 0.25), 1.0, 0.4, spacing=0.01, rate=RATE).run(until)
    heights, outer = (part.numpy() for part in reference.profile())
    for resolution in (16, 32):
        errors = []
        for steps in (12, 24):
            mesh = after(MeanCurvature(RATE), ring(resolution), until=until, steps=steps)
            across, z = np.linalg.norm(mesh.vertices[:, :2], axis=1), np.abs(mesh.vertices[:, 2])
            outside = (across > 0.6) & (z < 0.1)
            errors.append((across[outside] - np.interp(z[outside], heights, outer)).mean())
        # The outer radius is 0.85 at the start and 0.78 at the end.
        assert abs(errors[1]) < 0.6 * abs(errors[0]) < 0.002
        assert abs(2 * errors[1] - errors[0]) < 5e-4


def test_the_speed_does_not_depend_on_the_triangles() -> None:
    """The same circle with points ten times as dense on one side: without a mass it would not stay round."""
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    angle = angle + 0.9 * np.sin(angle)
    i = np.arange(200)
    uneven = Mesh(0.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1), np.stack([i, (i + 1) % 200], axis=1))
    result = after(MeanCurvature(RATE), uneven, until=0.4, steps=50)
    assert np.ptp(radii(result)) < 1e-3
    assert radii(result).mean() == pytest.approx(shrunk(2, 0.4), abs=2e-3)


def test_a_tube_with_free_ends_is_a_shrinking_cylinder() -> None:
    """Exactly that of a regular polygon in the plane; with its ends held it becomes a neck."""
    free = after(MeanCurvature(RATE, fixed_boundary=False), tube(along=9), until=0.2, steps=4)
    flat = after(MeanCurvature(RATE), polygon(12, radius=0.5), until=0.2, steps=4)
    across = np.linalg.norm(free.vertices[:, :2], axis=1)
    assert np.allclose(across, radii(flat)[0], atol=1e-12)
    held = after(MeanCurvature(RATE), tube(along=9), until=0.2, steps=4)
    ends = np.abs(tube(along=9).vertices[:, 2]) == 1
    assert np.array_equal(held.vertices[ends], tube(along=9).vertices[ends])
    assert np.linalg.norm(held.vertices[~ends, :2], axis=1).max() < 0.499


def test_a_held_curve_comes_to_rest_as_a_straight_line() -> None:
    rest = after(MeanCurvature(1.0), arc(), until=100.0, steps=20)
    assert np.abs(rest.vertices[:, 1]).max() < 1e-9
    assert rest.vertices[[0, -1]].tolist() == arc().vertices[[0, -1]].tolist()


def test_bodies_do_not_feel_each_other() -> None:
    small, large = polygon(40, radius=0.4), polygon(60, radius=0.5, center=(3, 0))
    both = Mesh(np.concatenate([small.vertices, large.vertices]), np.concatenate([small.faces, large.faces + 40]))
    step = MeanCurvature(RATE).displacement(both, 0.1, time=0.0)
    alone = [MeanCurvature(RATE).displacement(mesh, 0.1, time=0.0) for mesh in (small, large)]
    assert np.allclose(step, np.concatenate(alone), atol=1e-12)


def noisy(mesh: Mesh, size: float) -> Mesh:
    noise = np.random.default_rng(0).normal(size=len(mesh.vertices))
    return moved(mesh, size * noise[:, None] * smooth_normals(mesh))


@pytest.mark.parametrize("mesh", [polygon(150), icosphere(3)], ids=["circle", "sphere"])
def test_taubin_removes_noise_and_keeps_the_volume(mesh: Mesh) -> None:
    rough = noisy(mesh, 0.01)
    smooth = after(Taubin(0.02, -0.0201), rough, until=5.0, steps=10)
    sunk = after(MeanCurvature(0.02), rough, until=5.0, steps=10)
    assert radii(smooth).std() < 0.35 * radii(rough).std()
    assert abs(smooth.volume - rough.volume) < 0.01 * rough.volume
    assert abs(sunk.volume - rough.volume) > 0.15 * rough.volume


def test_taubin_multiplies_a_wave_by_its_factor() -> None:
    """On a regular polygon each Fourier mode is an eigenfunction."""
    mesh, rate, mu, dt = polygon(64), 0.3, -0.33, 0.05
    found = Laplacian.of(mesh.vertices, mesh.faces)
    k = (found.stiffness @ mesh.vertices)[0, 0] / found.mass[0]
    result = moved(mesh, Taubin(rate, mu).displacement(mesh, dt, time=0.0))
    assert np.allclose(result.vertices, mesh.vertices * (1 - mu * k * dt) / (1 + rate * k * dt / 2) ** 2)


def test_slivers_do_not_hurt_in_many_steps() -> None:
    for resolution in (16, 24, 32):
        mesh = extracted(lambda x: x.norm(dim=1) - 0.5 + 1e-9 * torch.sin(97 * x[:, 1]), resolution, refine=0)
        result = after(MeanCurvature(RATE), mesh, until=0.3, steps=6)
        assert np.ptp(radii(result)) < 0.01


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan])
def test_a_rate_that_is_not_positive_is_refused(rate: float) -> None:
    with pytest.raises(ValueError, match=rf"MeanCurvature\(rate={rate:g}\): the rate must be positive.*until=-0.1"):
        MeanCurvature(rate)


@pytest.mark.parametrize(("rate", "mu"), [(0.0, -0.1), (0.33, 0.34), (0.34, -0.33)])
def test_taubin_refuses_what_would_shrink(rate: float, mu: float) -> None:
    with pytest.raises(ValueError, match=r"Taubin\(rate=.* mu at most -rate.*Taubin\(0.33, -0.34\)"):
        Taubin(rate, mu)


@pytest.mark.parametrize("flow", [MeanCurvature(RATE), Taubin(0.33, -0.34)])
def test_no_smoothing_backwards_in_time(flow: MeanCurvature | Taubin) -> None:
    with pytest.raises(ValueError, match=r"displacement\(mesh, -0.1\): .* give a positive dt"):
        flow.displacement(polygon(9), -0.1, time=0.0)
