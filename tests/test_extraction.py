"""Extraction: the same mesh as from the full grid, at a fraction of the evaluations, where the surface is."""

import warnings
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from levelflow.boxes import Box
from levelflow.extraction import EmptyLevelSet, ExtractionWarning, extract
from levelflow.shapes.mesh import Mesh

UNIT = Box((-1, -1, -1), (1, 1, 1))
SQUARE = Box((-1, -1), (1, 1))
CENTERS = torch.rand(30, 3, generator=torch.Generator().manual_seed(5), dtype=torch.float64) * 1.8 - 0.9


class Counted:
    """A field that counts the points at which it was evaluated."""

    def __init__(self, function: Callable[[Tensor], Tensor]) -> None:
        self.function, self.count = function, 0

    def __call__(self, x: Tensor) -> Tensor:
        self.count += len(x)
        return self.function(x)


def ball(radius: float, center: float = 0.0) -> Callable[[Tensor], Tensor]:
    return lambda x: (x - center).norm(dim=1) - radius


def torus(x: Tensor) -> Tensor:
    return torch.stack([x[:, :2].norm(dim=1) - 0.6, x[:, 2]]).norm(dim=0) - 0.25


def capsule(x: Tensor) -> Tensor:
    """Of radius 1.5 cells at a resolution of 128, between the lines of the grid: corners around it see equal values."""
    axis = x.new_tensor([0.0, 0.031, -0.03]) + x.new_tensor([1.0, 0.0, 0.0]) * x[:, :1].clamp(-0.7, 0.7)
    return (x - axis).norm(dim=1) - 1.5 * 2 / 128


def spheres(x: Tensor) -> Tensor:
    return torch.cdist(x, CENTERS).amin(1) - 0.03


def cube(x: Tensor) -> Tensor:
    """With its faces on grid points: f = 0 exactly at many of them."""
    q = x.abs() - 0.5
    return q.clamp(min=0).norm(dim=1) + q.amax(1).clamp(max=0)


def gyroid(x: Tensor) -> Tensor:
    return torch.maximum((torch.sin(5 * x) * torch.cos(5 * x[:, [1, 2, 0]])).sum(1), 4 * (x.norm(dim=1) - 0.95))


FIELDS = {
    "sphere": ball(0.5),
    "torus": torus,
    "capsule": capsule,
    "spheres": spheres,
    "cube": cube,
    "gyroid": gyroid,
    "flat": lambda x: 0.05 * torch.sinh(ball(0.6)(x)),
    "steep far away": lambda x: (x**2).sum(1) ** 2 - 0.1,
    "truncated": lambda x: torus(x).clamp(-0.08, 0.08),
    "hilly": lambda x: torus(x) * (1 + 0.8 * torch.sin(4 * x).prod(1)),
    "fine detail": lambda x: ball(0.5)(x) + 0.01 * torch.sin(40 * x).prod(1),
}


def dense(field: Callable[[Tensor], Tensor], resolution: int) -> Mesh:
    """Marching cubes on the full grid."""
    from skimage.measure import marching_cubes

    axis = torch.arange(resolution + 1, dtype=torch.float64) * (2 / resolution) - 1
    x = torch.cartesian_prod(axis, axis, axis)
    values = torch.cat([field(part) for part in x.split(1 << 16)]).reshape((resolution + 1,) * 3)
    # With exact zeros, marching cubes leaves holes.
    values = torch.where(values == 0, -1e-12, values) * resolution
    vertices, faces, _, _ = marching_cubes(values.float().numpy(), 0.0, allow_degenerate=False)
    return Mesh(vertices.astype(np.float64) * (2 / resolution) - 1, faces)


@pytest.mark.parametrize("name", FIELDS)
def test_mesh_is_that_of_the_full_grid(name: str) -> None:
    mesh, full = extract(FIELDS[name], resolution=64, box=UNIT), dense(FIELDS[name], 64)
    assert np.array_equal(mesh.faces, full.faces)
    assert np.allclose(mesh.vertices, full.vertices, rtol=0, atol=1e-6)
    assert mesh.is_watertight
    assert mesh.volume > 0


@pytest.mark.parametrize(("field", "share"), [(torus, 0.1), (ball(0.9), 0.1), (capsule, 0.01)])
def test_few_points_are_evaluated(field: Callable[[Tensor], Tensor], share: float) -> None:
    counted = Counted(field)
    extract(counted, resolution=256, box=UNIT)
    assert counted.count < share * 257**3


def test_every_point_is_evaluated_once() -> None:
    seen: list[Tensor] = []
    extract(lambda x: seen.append(x) or torus(x), resolution=64, box=UNIT)  # type: ignore[func-returns-value]
    x = torch.cat(seen)
    assert len(torch.unique(x, dim=0)) == len(x)


def test_a_thin_capsule_is_found_whole() -> None:
    mesh = extract(capsule, resolution=128, box=UNIT)
    radius = 1.5 * 2 / 128
    assert mesh.components == 1
    assert mesh.volume == pytest.approx(np.pi * radius**2 * (1.4 + 4 / 3 * radius), rel=0.15)


def test_all_of_many_small_spheres_are_found() -> None:
    close = torch.cdist(CENTERS, CENTERS) < 0.06 + 4 / 128
    # Spheres that touch, or nearly, may be extracted as one.
    assert int(close.sum()) == len(CENTERS)
    assert extract(spheres, resolution=128, box=UNIT).components == len(CENTERS)


def test_genus_of_a_torus() -> None:
    mesh = extract(torus, resolution=48, box=UNIT)
    pairs = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    edges = np.unique(np.sort(pairs), axis=0)
    assert len(mesh.vertices) - len(edges) + len(mesh.faces) == 0


def test_the_surface_is_where_it_is_to_second_order() -> None:
    errors = []
    for resolution in (16, 32, 64, 128):
        mesh = extract(ball(0.513), resolution=resolution, box=UNIT)
        radius = np.linalg.norm(mesh.vertices, axis=1)
        assert np.abs(mesh.vertices.mean(0)).max() < 1e-8
        area, volume = 4 * np.pi * 0.513**2, 4 / 3 * np.pi * 0.513**3
        errors.append([np.abs(radius - 0.513).mean(), area - mesh.area, volume - mesh.volume])
    orders = np.polyfit(np.log([16, 32, 64, 128]), np.log(np.abs(errors)), 1)[0]
    assert np.allclose(orders, -2, atol=0.15)


@pytest.mark.parametrize("size", [1e-9, 1e9])
def test_units_do_not_matter(size: float) -> None:
    """Values and coordinates of any magnitude give the same mesh."""
    box = Box((-size,) * 3, (size,) * 3)
    mesh = extract(gyroid, resolution=32, box=UNIT)
    scaled = extract(lambda x: size * gyroid(x / size), resolution=32, box=box)
    assert np.array_equal(scaled.faces, mesh.faces)
    assert np.allclose(scaled.vertices / size, mesh.vertices, rtol=0, atol=1e-6)
    flat = extract(lambda x: 1e-9 * gyroid(x), resolution=32, box=UNIT)
    assert np.array_equal(flat.faces, mesh.faces)


def test_normals_point_outward() -> None:
    mesh = extract(ball(0.5), resolution=32, box=UNIT)
    assert (mesh.face_normals * mesh.vertices[mesh.faces].mean(1)).sum(1).min() > 0.45


def test_refined_vertices_lie_on_the_surface() -> None:
    mesh = extract(ball(0.513), resolution=32, box=UNIT, refine=3)
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 0.513).max() < 2e-6
    curve = extract(ball(0.513), resolution=32, box=SQUARE, refine=4)
    assert np.abs(np.linalg.norm(curve.vertices, axis=1) - 0.513).max() < 1e-8


def test_large_coordinates_lose_nothing() -> None:
    far = Box((1e6 - 1,) * 3, (1e6 + 1,) * 3)
    here, there = extract(ball(0.5), resolution=32, box=UNIT), extract(ball(0.5, 1e6), resolution=32, box=far)
    assert np.allclose(there.vertices - 1e6, here.vertices, rtol=0, atol=1e-6)


def test_cells_are_cubes_in_a_box_that_is_none() -> None:
    mesh = extract(ball(0.4), resolution=40, box=Box((-1, -0.5, -0.47), (1, 0.5, 0.5)))
    assert mesh.is_watertight
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 0.4).max() < 1e-3


@pytest.mark.parametrize("resolution", [2, 3, 7, 31, 65, 100])
def test_any_resolution_will_do(resolution: int) -> None:
    mesh = extract(ball(0.9), resolution=resolution, box=UNIT)
    assert mesh.is_watertight
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 0.9).max() < 0.9 / resolution


def test_another_level() -> None:
    assert np.allclose(
        extract(ball(0.3), resolution=32, box=UNIT, level=0.2).vertices,
        extract(ball(0.5), resolution=32, box=UNIT).vertices,
        atol=1e-7,
    )


def test_curves_enclose_positive_area() -> None:
    ring = extract(lambda x: (x.norm(dim=1) - 0.5).abs() - 0.2, resolution=100, box=SQUARE)
    assert ring.is_watertight
    assert ring.components == 2
    assert ring.volume == pytest.approx(np.pi * (0.49 - 0.09), rel=1e-4)
    outward = (ring.face_normals * ring.vertices[ring.faces].mean(1)).sum(1)
    assert ((outward > 0) == (np.linalg.norm(ring.vertices[ring.faces[:, 0]], axis=1) > 0.5)).all()


def test_a_surface_that_meets_the_box_is_open_there_and_said_so() -> None:
    with pytest.warns(ExtractionWarning, match=r"meets the box at z = -1; the mesh is open there"):
        mesh = extract(lambda x: (x - x.new_tensor([0, 0, -0.8])).norm(dim=1) - 0.5, resolution=40, box=UNIT)
    assert not mesh.is_watertight
    with pytest.warns(ExtractionWarning, match=r"x = -1, x = 1"):
        curve = extract(lambda x: x[:, 1] - 0.1, resolution=20, box=SQUARE)
    assert not curve.is_watertight
    assert curve.area == pytest.approx(2)


def test_the_box_of_the_field_is_used() -> None:
    field = Counted(ball(0.5))
    field.box = UNIT  # type: ignore[attr-defined]
    assert extract(field, resolution=16).is_watertight


def test_a_module_of_single_precision_works() -> None:
    class Ball(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.radius = torch.nn.Parameter(torch.tensor(0.5))

        def forward(self, x: Tensor) -> Tensor:
            return x.float().norm(dim=1) - self.radius

    mesh = extract(Ball(), resolution=32, box=UNIT)
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 0.5).max() < 2e-3


def test_nothing_to_extract() -> None:
    with pytest.raises(EmptyLevelSet, match=r"positive everywhere in the box from \(-1.0, -1.0, -1.0\) .* between 0.1"):
        extract(ball(-0.1), resolution=32, box=UNIT)
    with pytest.raises(EmptyLevelSet, match=r"minus 5 is negative everywhere"):
        extract(ball(0), resolution=32, box=UNIT, level=5)


def test_what_cannot_be_extracted_says_why() -> None:
    moving = Counted(ball(0.5))
    moving.times = 1  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match=r"extract\(f.at\(t\)\)"):
        extract(moving, box=UNIT)
    with pytest.raises(ValueError, match="at least 2 cells"):
        extract(torus, resolution=1, box=UNIT)
    with pytest.raises(ValueError, match="has no box of its own"):
        extract(torus)
    with pytest.raises(ValueError, match="2 or 3 dimensions"):
        extract(torus, box=Box((0,), (1,)))
    with pytest.raises(ValueError, match="not finite at .* points, first at"):
        extract(lambda x: x[:, 0].sqrt() - 0.5, resolution=16, box=UNIT)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        extract(torus, resolution=16, box=UNIT)


@pytest.mark.parametrize("space", [2, 3])
def test_a_field_far_from_zero_has_an_empty_level_set_at_any_resolution(space):
    box = Box((-1.0,) * space, (1.0,) * space)
    with pytest.raises(EmptyLevelSet, match="positive everywhere"):
        extract(lambda x: 10 + x[:, 0], box=box, resolution=256 if space == 2 else 64)


def test_a_surface_that_is_a_single_point_counts_as_vanished() -> None:
    with pytest.raises(EmptyLevelSet, match="is positive everywhere"):
        extract(lambda x: x.norm(dim=1), resolution=8, box=Box((-1.0, -1.0), (1.0, 1.0)))
