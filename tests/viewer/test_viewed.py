import math

import numpy as np
import pytest
import torch

from levelflow import Box, Mesh, Sphere, extract
from levelflow.equations import MeanCurvature
from levelflow.viewer.viewed import CURVATURE, RESIDUAL, SPEED, ViewedField, ViewedMesh
from tests.export.moving import GROWTH, growing, radius
from tests.fields import Explicit, placed, siren


def shrinking(rate):
    """A sphere under mean curvature, r^2 = 1/4 - 4 rate t."""

    def f(x, t):
        return torch.linalg.vector_norm(x, dim=1) - (0.25 - 4 * rate * t[:, 0]).clamp_min(0).sqrt()

    return Explicit(f, 3, 1, box=Box((-1.0,) * 3, (1.0,) * 3, ((0.0, 1.0),)))


def test_a_field_is_seen_with_its_normals_curvature_and_speed():
    center = np.array([3.0, -2.0, 1.0])
    viewed = ViewedField(growing(tuple(center)), name="ball")
    assert viewed.quantities == (CURVATURE, SPEED) and viewed.box.times == ((-4.0, 1.0),)
    surface = viewed.surface((0.5,), resolution=24)
    n = (surface.mesh.vertices - center) / np.linalg.norm(surface.mesh.vertices - center, axis=1, keepdims=True)
    assert np.allclose(surface.mesh.normals, n) and surface.time == (0.5,) and surface.note == ""
    assert np.allclose(surface.quantities["curvature"], 2 / radius(0.5), rtol=0.02)
    assert np.allclose(surface.quantities["speed"], GROWTH)


def test_where_the_motion_is_known_its_error_is_seen():
    rate = 0.02
    surface = ViewedField(shrinking(rate), name="", equation=MeanCurvature(rate)).surface((1.0,), resolution=32)
    assert np.abs(surface.quantities["residual"]).max() < 2e-3
    surface = ViewedField(shrinking(rate), name="", equation=MeanCurvature(2 * rate)).surface((1.0,), resolution=32)
    r = math.sqrt(0.25 - 4 * rate)
    assert np.allclose(surface.quantities["residual"], -rate * 2 / r, atol=2e-3)


@pytest.mark.parametrize(
    ("equation", "known"),
    [
        (repr(MeanCurvature(0.01)), True),
        ("Eikonal()", False),
        ("Morph(towards 1 target(s) at t = 1)", False),
        ("", False),
    ],
)
def test_the_residual_is_there_where_the_file_tells_the_motion(equation, known):
    field = placed(3, 1)
    field.provenance["equation"] = equation
    assert (RESIDUAL in ViewedField(field, name="").quantities) is known


def test_a_surface_that_has_vanished_is_a_note():
    surface = ViewedField(growing(), name="").surface((-3.0,), resolution=8)
    assert surface.mesh is None and surface.note == "There is no surface at t = -3: the field does not change sign."
    gone = ViewedField(growing().at(-3.0), name="").surface((), resolution=8)
    assert gone.note.startswith("There is no surface in the box of the field")


@pytest.mark.parametrize("space", [2, 3])
def test_a_surface_that_has_vanished_is_a_note_at_any_resolution(space):
    for resolution in (64, 128):
        assert ViewedField(growing(space=space), name="").surface((-4.0,), resolution=resolution).mesh is None


def test_values_are_those_of_the_field():
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    assert np.allclose(ViewedField(growing(), name="").values(x, (0.0,)), [-1.5, 1.5])
    ball = ViewedMesh(extract(Sphere(0.5).distance, box=Box((-1,) * 3, (1,) * 3), resolution=32), name="ball")
    assert np.allclose(ball.values(x, ()), [-0.5, 0.5], atol=0.01)


@pytest.mark.parametrize("times", [0, 1, 2])
def test_fields_of_any_number_of_parameters_are_seen(times):
    box = Box((-1.0,) * 3, (1.0,) * 3, ((0.0, 1.0),) * times)
    field = Explicit(lambda x, t: torch.linalg.vector_norm(x, dim=1) - 0.5 - t.sum(1) / 8, 3, times, box=box)
    viewed, middle = ViewedField(field, name=""), (0.5,) * times
    assert (SPEED in viewed.quantities) is (times == 1)
    surface, snapshot = viewed.surface(middle, resolution=12), viewed.snapshot(middle, resolution=12)
    r = 0.5 + times / 16
    assert np.allclose(np.linalg.norm(snapshot.mesh.vertices, axis=1), r, atol=1e-4)
    assert np.allclose(surface.quantities["curvature"], 2 / r, rtol=0.1)
    assert (snapshot.velocities is None) is (times != 1)


def test_the_edges_of_a_cube_are_sharp_and_the_sphere_stays_whole():
    cube = Mesh(*_cube(), name="cube")
    surface = ViewedMesh(cube, name="cube").surface((), resolution=99)
    sides = surface.mesh.normals[surface.mesh.faces]
    assert np.allclose(sides, surface.mesh.face_normals[:, None]) and len(surface.quantities["curvature"]) == len(
        surface.mesh.vertices
    )
    ball = extract(Sphere(0.5).distance, box=Box((-1,) * 3, (1,) * 3), resolution=24, refine=2)
    assert len(ViewedMesh(ball, name="").surface((), resolution=2).mesh.vertices) == len(ball.vertices)
    assert ViewedMesh(cube, name="cube").snapshot((), resolution=2).mesh is cube


def _cube():
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def test_what_cannot_be_seen_is_refused():
    with pytest.raises(ValueError, match=r"ViewedField\('net'\): the field has no box; give one that is Placed"):
        ViewedField(siren(3), name="net")
    with pytest.raises(ValueError, match=r"at\(2\): the field was solved for times from -4 to 1"):
        ViewedField(growing(), name="").surface((2.0,), resolution=8)
    with pytest.raises(ValueError, match="cube: a mesh stands still; ask for it without a time"):
        ViewedMesh(Mesh(*_cube()), name="cube").surface((0.0,), resolution=8)
    with pytest.raises(ValueError, match="depends on 0 time"):
        ViewedField(growing().at(0.0), name="").values(np.zeros((1, 3)), (0.0,))


def test_a_mixture_says_of_what():
    field = placed(3, 2)
    assert ViewedField(field, name="").shares == ()
    field.provenance = {"shares": ["a", "b", "c"]}
    assert ViewedField(field, name="").shares == ("a", "b", "c")
    # At given shares it is a surface like others.
    assert ViewedField(field.at(3.0, 0.0), name="").shares == ()
