"""The record Mesh: validation, measures, samples, units, orientation and the warning about signs."""

from __future__ import annotations

import pickle
import warnings
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
import torch

from levelflow.boxes import Frame
from levelflow.shapes import Mesh, MeshWarning
from tests.shapes.test_distance import CUBE_CORNERS, CUBE_FACES, cube, globe, tube

CORNERS, SIDES = np.array([[0, 0], [2, 0], [2, 1], [0, 1]]), np.array([[0, 1], [1, 2], [2, 3], [3, 0]])


def square() -> Mesh:
    return Mesh(CORNERS, SIDES)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def together(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]),
        name="bodies",
    )


def inside_out(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[:, ::-1])


@pytest.mark.parametrize(
    ("vertices", "faces", "options", "message"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3), int), {}, "the mesh is empty"),
        (CUBE_CORNERS, np.zeros((0, 3), int), {}, "8 points and no faces"),
        (np.zeros((4, 4)), CUBE_FACES, {}, r"shape \(4, 4\); wanted is \(n, 3\)"),
        (CUBE_CORNERS, CUBE_FACES[:, :2], {}, r"wanted are triangles, whole numbers of the shape \(m, 3\)"),
        (CORNERS, CUBE_FACES, {}, "wanted are segments"),
        (CUBE_CORNERS, CUBE_FACES * 1.0, {}, "the faces are float64"),
        (CUBE_CORNERS, CUBE_FACES + 1, {"name": "c.off"}, r"c.off: 6 of 12 faces name a vertex .* numbered 0 to 7"),
        (CUBE_CORNERS, CUBE_FACES - 1, {}, "faces name a vertex that does not exist, the first is face 0"),
        (CUBE_CORNERS, CUBE_FACES, {"normals": np.zeros((3, 3))}, r"the normals have the shape \(3, 3\)"),
    ],
)
def test_bad_arrays_are_refused(vertices, faces, options, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Mesh(vertices, faces, **options)


def test_vertices_that_are_not_finite_are_counted() -> None:
    broken = CUBE_CORNERS.copy()
    broken[3, 1], broken[5] = np.nan, np.inf
    with pytest.raises(ValueError, match="2 of 8 vertices have NaN or infinite coordinates, the first is vertex 3"):
        Mesh(broken, CUBE_FACES)


def test_the_record_is_frozen_and_does_not_share_its_arrays() -> None:
    corners = CUBE_CORNERS.copy()
    mesh = Mesh(corners, CUBE_FACES)
    corners[:] = 0
    assert mesh.volume == pytest.approx(1)
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0] = 1
    with pytest.raises(FrozenInstanceError):
        mesh.name = "other"  # type: ignore[misc]
    assert replace(mesh, name="other").name == "other"
    assert repr(mesh) == "Mesh('Mesh', 8 vertices, 12 faces)"


def test_a_mesh_can_be_copied_and_sent_to_another_process() -> None:
    mesh, x = cube(), torch.zeros(1, 3)
    distance = mesh.distance(x)
    assert torch.equal(pickle.loads(pickle.dumps(mesh)).distance(x), distance)


def test_measures_of_a_box() -> None:
    mesh = cube((1, 2, 3), (10, 20, 30))
    assert mesh.area == pytest.approx(22, abs=1e-12)
    assert mesh.volume == pytest.approx(6, abs=1e-12)
    assert mesh.is_watertight
    assert mesh.components == 1
    assert mesh.box.center == (10, 20, 30)
    assert mesh.box.size == (1, 2, 3)
    assert inside_out(mesh).volume == pytest.approx(-6, abs=1e-12)


def test_measures_of_a_square() -> None:
    mesh = square()
    assert mesh.area == 6
    assert mesh.volume == 2
    assert mesh.is_watertight
    assert mesh.components == 1
    assert mesh.face_normals.tolist() == [[0, -1], [1, 0], [0, 1], [-1, 0]]
    assert np.allclose(mesh.vertex_normals, np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / np.sqrt(2))
    assert not Mesh(CORNERS, SIDES[:3]).is_watertight


def test_the_vertex_normals_of_a_cube_are_its_diagonals() -> None:
    """However its squares are cut; a mean weighted by area would miss by 15 degrees and more."""
    diagonals = CUBE_CORNERS * 2 / np.sqrt(3)
    assert np.abs(cube().vertex_normals - diagonals).max() < 1e-15
    given = Mesh(CUBE_CORNERS, CUBE_FACES, normals=-diagonals)
    assert given.vertex_normals is given.normals


def test_area_and_volume_of_a_globe_converge_in_second_order() -> None:
    areas, volumes = np.array([(m.area, m.volume) for m in map(globe, (16, 32, 64))]).T
    for values, exact in ((areas, 4 * np.pi), (volumes, 4 * np.pi / 3)):
        errors = exact - values
        assert (np.abs(np.log2(errors[:-1] / errors[1:]) - 2) < 0.05).all()


def test_samples_are_uniform_by_area() -> None:
    mesh = cube((1, 2, 3))
    points, normals = mesh.sample(100_000, generator=generator())
    assert points.dtype == torch.float64
    for axis, area in enumerate((6, 3, 2)):
        side = normals[:, axis] == 1
        assert side.double().mean().item() == pytest.approx(area / 22, abs=0.005)
        # Uniform in a rectangle: mean 0 and variance side^2 / 12 along both directions in it.
        for other in {0, 1, 2} - {axis}:
            along = points[side, other] / mesh.box.size[other]
            assert along.mean().item() == pytest.approx(0, abs=0.01)
            assert along.var().item() == pytest.approx(1 / 12, abs=0.002)
    assert mesh.distance(points).abs().max() < 1e-13
    again = mesh.sample(100_000, generator=generator())
    assert torch.equal(again.points, points)


def test_samples_of_a_curve_are_uniform_by_length() -> None:
    mesh = square()
    points, normals = mesh.sample(50_000, generator=generator())
    assert (normals[:, 1] == -1).double().mean().item() == pytest.approx(1 / 3, abs=0.01)
    bottom = points[normals[:, 1] == -1]
    assert bottom[:, 0].mean().item() == pytest.approx(1, abs=0.02)
    assert mesh.distance(points).abs().max() < 1e-14


def test_a_mesh_without_area_cannot_be_sampled_or_normalised() -> None:
    flat = Mesh(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 1, 2]]), name="flat")
    with pytest.raises(ValueError, match="flat: the faces have no area"):
        flat.sample(10, generator=generator())
    with pytest.raises(ValueError, match=r"all vertices are at \(1.0, 1.0, 1.0\)"):
        Mesh(np.ones((3, 3)), np.array([[0, 1, 2]])).normalized()


@pytest.mark.parametrize("margin", [-0.1, 1.0])
def test_a_margin_that_leaves_no_room_is_refused(margin: float) -> None:
    with pytest.raises(ValueError, match=r"wants a margin from 0 to below 1"):
        cube().normalized(margin)


@pytest.mark.parametrize("margin", [0.0, 0.2])
def test_normalising_remembers_the_way_back(margin: float) -> None:
    mesh = cube((1, 2, 30), (1e3, 20, 30))
    unit = mesh.normalized(margin)
    assert unit.box.upper[2] == pytest.approx(1 - margin)
    assert max(unit.box.size) == pytest.approx(2 - 2 * margin)
    assert np.allclose(unit.box.center, 0, atol=1e-15)
    assert np.abs(unit.restored().vertices - mesh.vertices).max() < 1e-12
    assert unit.restored().frame == Frame((0.0, 0.0, 0.0), 1.0)
    assert unit.restored().restored() is not mesh
    assert mesh.restored() is mesh
    back = unit.frame.from_unit(torch.tensor(unit.vertices)).numpy()
    assert np.abs(back - mesh.vertices).max() < 1e-12


def test_normalising_twice_still_leads_back() -> None:
    mesh = cube((1, 2, 30), (1e3, 20, 30))
    twice = mesh.normalized(0.1).normalized(0.5)
    assert max(twice.box.size) == pytest.approx(1)
    assert np.abs(twice.restored().vertices - mesh.vertices).max() < 1e-12


def test_an_inside_out_mesh_is_turned() -> None:
    assert cube().oriented().volume == pytest.approx(1)
    mesh = cube()
    assert mesh.oriented() is mesh
    assert inside_out(mesh).oriented().volume == pytest.approx(1)
    assert Mesh(CORNERS, SIDES[:, ::-1]).oriented().volume == 2


def test_one_body_of_several_is_turned_and_a_cavity_is_kept() -> None:
    big, small, cavity = cube((4, 4, 4)), inside_out(cube(at=(5, 0, 0))), inside_out(cube())
    mixed = together(big, small, cavity)
    turned = mixed.oriented()
    assert mixed.components == 3
    assert turned.volume == pytest.approx(64 + 1 - 1)
    assert turned.distance(torch.tensor([[5.0, 0, 0], [0, 0, 0], [1, 0, 0]])).tolist() == pytest.approx(
        [-0.5, 0.5, -0.5]
    )
    assert inside_out(mixed).oriented().volume == pytest.approx(64 + 1 - 1)


@pytest.mark.parametrize(
    "make", [cube, lambda: globe(16), lambda: together(cube(), cube(at=(3, 0, 0))), square], ids=range(4)
)
def test_closed_meshes_give_no_warning(make) -> None:
    shape = make()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        shape.distance(torch.zeros(1, shape.vertices.shape[1]))
    assert shape.sign_uncertainty() == (0, 0.0, 0.0, None)


def test_a_cavity_gives_no_warning() -> None:
    shell = together(cube((4, 4, 4)), inside_out(cube()))
    assert shell.distance(torch.zeros(1, 3)).item() == 0.5
    assert shell.sign_uncertainty().region is None


def test_an_open_mesh_warns_once_with_the_place_in_its_own_units() -> None:
    mesh = tube(64)
    moved = Mesh(mesh.vertices + [100, 0, 0], mesh.faces, name="tube.off").normalized()
    with pytest.warns(MeshWarning, match=r"^tube.off: the sign .* open \(128 edges .* between \(99, .* % of its box"):
        moved.distance(torch.zeros(1, 3))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        moved.distance(torch.zeros(1, 3))
        moved.restored().distance(torch.zeros(1, 3))
    found = moved.sign_uncertainty()
    assert found.open_edges == 128
    assert 0.3 < found.share < 0.6
    assert found.region is not None
    assert found.region.lower[0] >= 98.9
    assert found.region.upper[2] > 0.9


def test_the_uncertain_share_of_two_overlapping_boxes_is_their_overlap() -> None:
    mesh = together(cube((2, 1, 1)), cube((2, 1, 1), (1, 0.1, 0.1)))
    with pytest.warns(MeshWarning, match="parts of it overlap or face inward"):
        mesh.distance(torch.zeros(1, 3))
    found = mesh.sign_uncertainty()
    box = mesh.box.expanded(0.025 * 3)
    assert found.share == pytest.approx(0.81 / np.prod(box.size), rel=0.05)
    assert found.region is not None
    assert np.allclose(found.region.lower, (0, -0.4, -0.4), atol=0.03)
    assert np.allclose(found.region.upper, (1, 0.5, 0.5), atol=0.03)


def test_a_body_that_faces_inward_counts_as_uncertain() -> None:
    mesh = together(cube((4, 4, 4)), inside_out(cube(at=(5, 0, 0))))
    with pytest.warns(MeshWarning, match="face inward"):
        mesh.distance(torch.zeros(1, 3))


def test_a_slit_too_thin_to_matter_is_reported_as_such() -> None:
    """A cube with one corner torn by 1e-9: open, and nearly nothing of space is affected."""
    corners = np.concatenate([CUBE_CORNERS, CUBE_CORNERS[:1] * (1 + 1e-9)])
    faces = CUBE_FACES.copy()
    faces[0, faces[0] == 0] = 8
    mesh = Mesh(corners, faces, name="torn")
    with pytest.warns(MeshWarning, match="torn: .* close to those edges only, less than 0.01 % of its box"):
        mesh.distance(torch.zeros(1, 3))


def test_an_open_curve_warns_too() -> None:
    with pytest.warns(MeshWarning, match=r"open \(2 end points"):
        Mesh(CORNERS, SIDES[:3]).distance(torch.zeros(1, 2))


def test_the_closest_point_in_numpy() -> None:
    closest = cube().closest(np.array([[2, 0.1, 0.2]]))
    assert closest.distance.tolist() == pytest.approx([1.5])
    assert closest.point.tolist()[0] == pytest.approx([0.5, 0.1, 0.2])
