"""Pictures with derivatives: against areas, and against finite differences for every kind of motion."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from levelflow.boxes import Box
from levelflow.extraction import extract
from levelflow.rendering.camera import Camera
from levelflow.rendering.differentiable import differentiable_image, vertex_normals
from levelflow.rendering.rasterising import rasterise
from levelflow.shapes.analytic import Sphere, Torus

CUBE = Box((-1, -1, -1), (1, 1, 1))
SQUARE = torch.tensor([[-0.5, -0.4, 0.0], [0.5, -0.4, 0.0], [0.5, 0.4, 0.0], [-0.5, 0.4, 0.0]], dtype=torch.float64)
HALVES = torch.tensor([[0, 1, 2], [0, 2, 3]])


def icosahedron() -> tuple[Tensor, Tensor]:
    """Twelve vertices, stretched; each is a corner of large triangles."""
    golden = (1 + 5**0.5) / 2
    corners = [(0, s, t * golden) for s in (-1, 1) for t in (-1, 1)]
    vertices = np.array([p[k:] + p[:k] for p in corners for k in range(3)]) / math.hypot(1, golden)
    from scipy.spatial import ConvexHull

    hull = ConvexHull(vertices)
    faces = np.where(
        (np.linalg.det(vertices[hull.simplices]) > 0)[:, None], hull.simplices, hull.simplices[:, ::-1]
    ).astype(np.int64)
    return torch.tensor(vertices * [0.8, 0.7, 0.6]), torch.tensor(faces)


def weights(size: int) -> Tensor:
    """A smooth functional of pictures."""
    y, x = torch.meshgrid(*[torch.linspace(-1, 1, size, dtype=torch.float64)] * 2, indexing="ij")
    return torch.stack([torch.cos(1.3 * x + 0.4) * torch.cos(y - 0.3), torch.sin(x - y), 1 + 0.5 * x], dim=-1)


def rotated(vertices: Tensor, axis: int, angle: Tensor) -> Tensor:
    turn = torch.zeros(3, 3, dtype=torch.float64)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    turn[i, j], turn[j, i] = -1, 1
    return vertices @ torch.matrix_exp(angle * turn).T


MOTIONS = {
    **{f"translation {i}": (lambda v, s, i=i: v + s * torch.eye(3, dtype=v.dtype)[i]) for i in range(3)},
    "scale": lambda v, s: v * (1 + s),
    **{f"rotation {i}": (lambda v, s, i=i: rotated(v, i, s)) for i in range(3)},
}


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize(
    ("shape", "size", "tolerance"), [(Sphere(0.7), 128, 0.01), (Torus(0.55, 0.25), 256, 0.03)], ids=["ball", "ring"]
)
def test_rigid_motions_and_scale_agree_with_finite_differences(shape, size, tolerance, orthographic) -> None:
    mesh = extract(shape.distance, resolution=16, box=CUBE, refine=3)
    vertices, faces = torch.tensor(mesh.vertices * [1.0, 0.8, 1.2]), torch.tensor(mesh.faces)
    camera, functional = Camera((1.2, 1.5, 4.0), orthographic=orthographic), weights(size)

    def loss(v: Tensor) -> Tensor:
        colours = 0.6 + 0.4 * vertex_normals(v, faces)
        return (differentiable_image(v, faces, colours, camera, height=size, width=size) * functional).mean()

    exact, differences = [], []
    for motion in MOTIONS.values():
        s = torch.zeros((), dtype=torch.float64, requires_grad=True)
        exact.append(float(torch.autograd.grad(loss(motion(vertices, s)), s)[0]))
        with torch.no_grad():
            steps = [torch.tensor(h, dtype=torch.float64) for h in (0.008, 0.016)]
            slopes = [(loss(motion(vertices, h)) - loss(motion(vertices, -h))) / (2 * h) for h in steps]
        differences.append(float(sum(slopes)) / len(slopes))
    # The scale, which moves the whole silhouette, has the greatest derivative.
    scale = max(map(abs, differences))
    assert np.abs(np.subtract(exact, differences)).max() < tolerance * scale


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("shaded", [False, True])
def test_single_vertices_agree_with_finite_differences(shaded: bool, orthographic: bool) -> None:
    size, (vertices, faces) = 160, icosahedron()
    camera, functional = Camera((0.5, 0.7, 4.0), orthographic=orthographic), weights(size)
    own = torch.rand(12, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))

    def loss(v: Tensor) -> Tensor:
        colours = 0.6 + 0.4 * vertex_normals(v, faces) if shaded else own
        return (differentiable_image(v, faces, colours, camera, height=size, width=size) * functional).mean()

    points = camera.project(vertices.numpy(), height=size, width=size)
    from scipy.spatial import ConvexHull

    outline = ConvexHull(points[:, :2]).vertices
    inner = [i for i in range(12) if i not in outline and points[i, 2] > np.median(points[:, 2])]
    assert len(outline) >= 6
    assert inner
    v = vertices.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(loss(v), v)
    for i in (*outline[:3].tolist(), inner[0]):
        slopes = torch.zeros(3, dtype=torch.float64)
        for axis in range(3):
            step = torch.zeros_like(vertices)
            step[i, axis] = 0.02
            with torch.no_grad():
                slopes[axis] = (loss(vertices + step) - loss(vertices - step)) / 0.04
        assert torch.allclose(gradient[i], slopes, rtol=0, atol=0.03 * float(slopes.abs().max())), i
    # What is behind is neither seen nor felt, unless it shades what is seen.
    hidden = [i for i in range(12) if i not in outline and i not in inner]
    if not shaded:
        assert not gradient[hidden].any()


@pytest.mark.parametrize("angle", [0.0, 0.3, 0.8, 1.2])
def test_the_sum_of_a_picture_is_the_area_and_its_derivative_the_length_of_the_outline(angle: float) -> None:
    camera, size = Camera((0, 0, 5), orthographic=True), 150
    unit = camera.footprint(height=size, width=size)
    white = torch.ones(4, 1, dtype=torch.float64)

    def area(v: Tensor) -> Tensor:
        return differentiable_image(v, HALVES, white, camera, height=size, width=size).sum() * unit**2

    v = rotated(SQUARE, 2, torch.tensor(angle, dtype=torch.float64))
    assert float(area(v)) == pytest.approx(0.8, rel=3e-3)
    s = torch.ones((), dtype=torch.float64, requires_grad=True)
    (growth,) = torch.autograd.grad(area(s * v), s)
    assert float(growth) == pytest.approx(1.6, rel=0.02)
    shift = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    (force,) = torch.autograd.grad(area(v + shift), shift)
    assert force.abs().max() < 0.03


def test_a_surface_before_another_is_blended_with_it() -> None:
    camera, size = Camera((0, 0, 5), orthographic=True), 120
    unit = camera.footprint(height=size, width=size)
    wall = torch.tensor([[2.0, 2.0, 1.0]]) * SQUARE - torch.tensor([0.0, 0.0, 0.5])
    faces = torch.cat([HALVES, HALVES + 4])
    colours = torch.tensor([[1.0]] * 4 + [[0.25]] * 4, dtype=torch.float64)
    moved = torch.tensor([0.123, 0.05, 0.0], dtype=torch.float64, requires_grad=True)
    scale = torch.ones((), dtype=torch.float64, requires_grad=True)
    vertices = torch.cat([scale * SQUARE + moved, wall])
    picture = differentiable_image(vertices, faces, colours, camera, height=size, width=size)
    total = picture.sum() * unit**2
    assert float(total.detach()) == pytest.approx(0.8 + 0.25 * (3.2 - 0.8), rel=5e-3)
    growth, shift = torch.autograd.grad(total, (scale, moved))
    assert float(growth) == pytest.approx(0.75 * 1.6, rel=0.02)
    assert shift.abs().max() < 0.03


def test_away_from_silhouettes_it_is_the_plain_picture() -> None:
    mesh = extract(Sphere(0.6).distance, resolution=20, box=CUBE)
    camera = Camera.around(CUBE)
    vertices, faces = torch.tensor(mesh.vertices), torch.tensor(mesh.faces)
    ground = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64)
    picture = differentiable_image(vertices, faces, vertices, camera, height=60, width=80, background=ground)
    raster = rasterise(mesh, camera, height=60, width=80)
    plain = raster.place(raster.interpolate(mesh.vertices[mesh.faces]), background=ground.numpy())
    differs = np.abs(picture.numpy() - plain).max(2) > 1e-9
    inner = np.ones_like(raster.mask)
    for axis in (0, 1):
        for step in (-1, 1):
            inner &= np.roll(raster.mask, step, axis) == raster.mask
    assert not differs[inner].any()
    assert differs.sum() > 40


def test_a_picture_tells_where_and_how_large_a_ball_is() -> None:
    mesh = extract(Sphere(0.5).distance, resolution=10, box=CUBE)
    vertices, faces = torch.tensor(mesh.vertices), torch.tensor(mesh.faces)
    camera, white = Camera((0, 0, 5), orthographic=True), torch.ones(len(vertices), 1, dtype=torch.float64)

    def picture(p: Tensor) -> Tensor:
        moved = vertices * p[3] + p[:3]
        return differentiable_image(moved, faces, white, camera, height=48, width=48)

    wanted = picture(torch.tensor([0.2, -0.15, 0.0, 1.2], dtype=torch.float64))
    p = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.Adam([p], lr=0.02)
    for _ in range(60):
        optimiser.zero_grad()
        ((picture(p) - wanted) ** 2).mean().backward()
        optimiser.step()
    assert torch.allclose(p[[0, 1, 3]], torch.tensor([0.2, -0.15, 1.2], dtype=torch.float64), atol=0.01)


def test_vertex_normals_of_a_ball_and_the_dtype_of_the_picture() -> None:
    mesh = extract(Sphere(0.6).distance, resolution=24, box=CUBE, refine=3)
    vertices, faces = torch.tensor(mesh.vertices), torch.tensor(mesh.faces)
    normals = vertex_normals(vertices, faces)
    assert torch.allclose(normals.norm(dim=1), torch.ones(1, dtype=torch.float64))
    assert ((normals * vertices).sum(1) / 0.6).min() > 0.98
    picture = differentiable_image(
        vertices.float(), faces, normals.float(), Camera((0, 0, 5)), height=16, width=16, background=1.0
    )
    assert picture.dtype == torch.float32
    assert picture[0, 0].tolist() == [1.0, 1.0, 1.0]


def test_what_lies_behind_the_eye_is_left_out() -> None:
    vertices = torch.cat([SQUARE, SQUARE + torch.tensor([0.0, 0.0, 10.0])]).requires_grad_()
    faces = torch.cat([HALVES, HALVES + 4, torch.tensor([[0, 1, 5]])])
    colours = torch.ones(8, 1, dtype=torch.float64)
    picture = differentiable_image(vertices, faces, colours, Camera((0, 0, 5)), height=32, width=32)
    picture.sum().backward()
    assert torch.isfinite(vertices.grad).all()
    assert not vertices.grad[4:].any()


def test_pictures_that_cannot_be(unchecked: None) -> None:
    camera = Camera((0, 0, 5))
    with pytest.raises(ValueError, match="at least one pixel"):
        differentiable_image(SQUARE, HALVES, SQUARE, camera, height=0, width=4)
    with pytest.raises(ValueError, match="give one for each"):
        differentiable_image(SQUARE, HALVES, SQUARE[:2], camera, height=4, width=4)
