"""Solids with a formula: their distances against geometry, their samples against areas."""

from __future__ import annotations

import math

import pytest
import torch

from levelflow.boxes import Box
from levelflow.shapes import (
    Capsule,
    Circle,
    Cuboid,
    Cylinder,
    Dumbbell,
    Polygon,
    Rectangle,
    Rotated,
    SmoothUnion,
    Solid,
    Sphere,
    Torus,
    Translated,
)

ELL = ((0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 0.3), (0.0, 1.0))
EXACT: dict[str, tuple[Solid, float]] = {  # with their areas
    "sphere": (Sphere(0.5, center=(0.1, 0.2, 0.3)), math.pi),
    "box": (Cuboid((1, 2, 0.5)), 7.0),
    "rounded box": (Cuboid((1, 2, 0.5), radius=0.1), 2 * (1.44 + 0.54 + 0.24) + 0.2 * math.pi * 2.9 + 0.04 * math.pi),
    "ball as box": (Cuboid((1, 1, 1), radius=0.5), math.pi),
    "torus": (Torus(1, 0.4), 1.6 * math.pi**2),
    "cylinder": (Cylinder(0.4, 1.2), 2 * math.pi * (0.48 + 0.16)),
    "capsule": (Capsule(0.3, 0.8), 2 * math.pi * 0.3 * 0.8 + 4 * math.pi * 0.09),
    "dumbbell": (
        Dumbbell(0.5, 1.4, neck=0.3),
        2 * (2 * math.pi * 0.5 * (0.5 + 0.4)) + 2 * math.pi * 0.3 * 2 * 0.3,
    ),
    "circle": (Circle(0.4, center=(1, 2)), 0.8 * math.pi),
    "rectangle": (Rectangle((1, 2)), 6.0),
    "rounded rectangle": (Rectangle((1, 2), radius=0.3), 2 * (0.4 + 1.4) + 0.6 * math.pi),
    "polygon": (Polygon(ELL), 4 + 2 * math.hypot(1, 0.7)),
    "clockwise polygon": (Polygon(ELL[::-1]), 4 + 2 * math.hypot(1, 0.7)),
    "translated": (Translated(Torus(1, 0.4), (1, 2, 3)), 1.6 * math.pi**2),
    "rotated": (Rotated(Cuboid((1, 2, 0.5)), 0.7, axis=(1, 2, 3)), 7.0),
    "rotated in the plane": (Rotated(Rectangle((1, 2)), 0.7), 6.0),
}
MELTED = SmoothUnion(Sphere(0.5), Translated(Cuboid((0.6, 0.6, 0.6)), (0.6, 0, 0)), blend=0.2)
MELTED_DISCS = SmoothUnion(Circle(0.5), Circle(0.4, center=(0.7, 0)), blend=0.2)
ALL = {**{name: solid for name, (solid, _) in EXACT.items()}, "melted": MELTED, "melted discs": MELTED_DISCS}


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def gradient(solid: Solid, x: torch.Tensor) -> torch.Tensor:
    x = x.clone().requires_grad_()
    return torch.autograd.grad(solid.distance(x).sum(), x)[0]


@pytest.fixture(params=EXACT, name="solid")
def _solid(request: pytest.FixtureRequest) -> Solid:
    return EXACT[request.param][0]


@pytest.fixture(params=ALL, name="any_solid")
def _any_solid(request: pytest.FixtureRequest) -> Solid:
    return ALL[request.param]


def test_the_distance_has_a_gradient_of_length_one(solid: Solid) -> None:
    x = solid.box.expanded(0.5).uniform(2000, generator=generator())
    assert torch.allclose(gradient(solid, x).norm(dim=1), torch.ones(2000, dtype=x.dtype), atol=1e-12)


def test_the_distance_is_that_of_the_nearest_sample(solid: Solid) -> None:
    points, _ = solid.sample(20_000, generator=generator(1))
    x = solid.box.expanded(0.3).uniform(500, generator=generator(2))
    over = torch.cdist(x, points).amin(1) - solid.distance(x).abs()
    assert over.min() > -1e-12
    assert over.max() < 0.05
    assert over.median() < 0.005


def test_samples_lie_on_the_surface_and_in_the_box(any_solid: Solid) -> None:
    points, normals = any_solid.sample(1000, generator=generator())
    assert any_solid.distance(points).abs().max() < 1e-13
    assert any_solid.box.expanded(1e-12).contains(points).all()
    assert points.dtype == normals.dtype == torch.float64


def test_normals_are_the_gradient_of_the_distance(any_solid: Solid) -> None:
    points, normals = any_solid.sample(1000, generator=generator())
    direction = gradient(any_solid, points)
    assert torch.allclose(normals, direction / direction.norm(dim=1, keepdim=True), atol=1e-9)


@pytest.mark.parametrize("name", [name for name in EXACT if name not in ("rotated", "rotated in the plane")])
def test_the_box_is_tight(name: str) -> None:
    solid = EXACT[name][0]
    found = Box.around(solid.sample(20_000, generator=generator())[0])
    assert torch.allclose(torch.tensor(found.lower), torch.tensor(solid.box.lower), atol=0.03)
    assert torch.allclose(torch.tensor(found.upper), torch.tensor(solid.box.upper), atol=0.03)


@pytest.mark.parametrize("name", EXACT)
def test_samples_are_uniform_by_area(name: str) -> None:
    """Area times the mean of <x - c, n> / d is the volume; a shell of the distance has the volume area * width."""
    solid, area = EXACT[name]
    d = solid.box.space
    points, normals = solid.sample(100_000, generator=generator())
    box = solid.box.expanded(0.1)
    x = box.uniform(200_000, generator=generator(1))
    inside = (solid.distance(x) < 0).double().mean().item() * math.prod(box.size)
    flux = area * ((points - points.new_tensor(box.center)) * normals).sum(1).mean().item() / d
    assert flux == pytest.approx(inside, rel=0.02)
    # In every half of the box the share of the samples is the share of the thin shell.
    shell = x[solid.distance(x).abs() < 0.02]
    for axis in range(d):
        cut = box.center[axis] + 0.15 * box.size[axis]
        expected = (shell[:, axis] > cut).double().mean().item()
        spread = 4 / math.sqrt(len(shell))
        assert (points[:, axis] > cut).double().mean().item() == pytest.approx(expected, abs=spread + 0.01)


@pytest.mark.parametrize("name", EXACT)
def test_the_area_is_that_of_a_thin_shell(name: str) -> None:
    solid, area = EXACT[name]
    x = (box := solid.box.expanded(0.1)).uniform(300_000, generator=generator())
    shell = (solid.distance(x).abs() < 0.02).double().mean().item() * math.prod(box.size)
    assert shell / 0.04 == pytest.approx(area, rel=0.03)


def test_the_same_seed_gives_the_same_samples(any_solid: Solid) -> None:
    first, second = (any_solid.sample(100, generator=generator(7)) for _ in range(2))
    assert torch.equal(first.points, second.points)
    assert torch.equal(first.normals, second.normals)
    assert first.points.shape == first.normals.shape == (100, any_solid.box.space)


def test_the_dtype_of_the_argument_is_kept(any_solid: Solid) -> None:
    x = any_solid.box.uniform(50, generator=generator())
    single = any_solid.distance(x.float())
    assert single.dtype == torch.float32
    assert torch.allclose(single.double(), any_solid.distance(x), atol=1e-5)


@pytest.mark.parametrize(
    ("solid", "x", "expected"),
    [
        (Sphere(2), (0, 0, 0), -2),
        (Cuboid((2, 4, 6)), (0, 0, 0), -1),
        (Cuboid((2, 4, 6)), (4, 6, 3), 5),
        (Cuboid((2, 2, 2), radius=0.5), (0, 0, 0), -1),
        (Cuboid((2, 2, 2), radius=0.5), (1.5, 1.5, 1.5), math.sqrt(3) - 0.5),
        (Torus(1, 0.25), (1, 0, 0), -0.25),
        (Torus(1, 0.25), (0, 0, 0), 0.75),
        (Cylinder(1, 4), (0, 0, 0), -1),
        (Cylinder(1, 4), (4, 0, 6), 5),
        (Capsule(0.5, 2), (0, 0, 2), 0.5),
        (Dumbbell(0.5, 1.4, neck=0.3), (0, 0, 0), -0.3),
        (Dumbbell(0.5, 1.4, neck=0.3), (0, 0, 0.7), -0.5),
        (Dumbbell(0.5, 1.4, neck=0.3), (0, 0, 0.35), -math.hypot(0.3, 0.05)),
        (Rectangle((2, 4)), (4, 6), 5),
        (Polygon(((0, 0), (4, 0), (4, 4))), (3, 1), -1),
        (Polygon(((0, 0), (4, 0), (4, 4))), (-3, -4), 5),
    ],
    ids=str,
)
def test_distances_worked_out_by_hand(solid: Solid, x: tuple[float, ...], expected: float) -> None:
    assert solid.distance(torch.tensor([x], dtype=torch.float64)).item() == pytest.approx(expected, abs=1e-14)


def test_a_rotation_turns_by_the_right_hand_rule() -> None:
    x_axis = torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64)
    turned = Rotated(Sphere(0.1, center=(1, 0, 0)), math.pi / 2, axis=(0, 0, 2))
    assert turned.distance(x_axis @ turned.matrix().T).item() == pytest.approx(-0.1)
    assert torch.allclose(x_axis @ turned.matrix().T, x_axis.roll(1, 1), atol=1e-15)
    flat = Rotated(Circle(0.1, center=(1, 0)), math.pi / 2)
    assert flat.distance(torch.tensor([[0.0, 1.0]])).item() == pytest.approx(-0.1)


@pytest.mark.parametrize("solid", [Torus(), Cuboid((1, 2, 0.5)), MELTED], ids=["torus", "box", "melted"])
def test_distances_move_with_the_solid(solid: Solid) -> None:
    moved = Translated(Rotated(solid, 1.1, axis=(1, -2, 0.5)), (3, 2, 1))
    x = solid.box.uniform(200, generator=generator())
    turn = moved.solid.matrix()  # type: ignore[attr-defined]
    assert torch.allclose(moved.distance(x @ turn.T + torch.tensor([3, 2, 1])), solid.distance(x), atol=1e-13)


def test_a_smooth_union_is_the_union_away_from_the_blend() -> None:
    a, b = MELTED.first, MELTED.second
    x = MELTED.box.expanded(0.3).uniform(5000, generator=generator())
    first, second, field = a.distance(x), b.distance(x), MELTED.distance(x)
    lowered = torch.minimum(first, second) - field
    assert (lowered[(first - second).abs() >= 0.2] == 0).all()
    assert lowered.min() >= 0
    assert lowered.max() <= 0.05
    assert lowered.max() > 0.04


@pytest.mark.parametrize("solid", [MELTED, MELTED_DISCS], ids=["space", "plane"])
def test_a_smooth_union_never_exceeds_the_distance(solid: SmoothUnion) -> None:
    points, _ = solid.sample(20_000, generator=generator())
    x = solid.box.expanded(0.3).uniform(500, generator=generator(1))
    assert (torch.cdist(x, points).amin(1) - solid.distance(x).abs()).min() > -1e-9
    assert gradient(solid, x).norm(dim=1).max() <= 1 + 1e-12


def test_samples_of_a_smooth_union_are_uniform_by_area() -> None:
    """With a blend so small that it does not matter, two overlapping spheres: zones have areas 2 pi r h."""
    union = SmoothUnion(Sphere(0.5), Sphere(0.5, center=(0.6, 0, 0)), blend=1e-6)
    points, _ = union.sample(40_000, generator=generator())
    assert (points[:, 0] < 0).double().mean().item() == pytest.approx(0.5 / 1.6, abs=0.01)
    assert (points[:, 0] < 0.15).double().mean().item() == pytest.approx(0.65 / 1.6, abs=0.01)


SQUARE = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
x2, x3 = torch.zeros(4, 2), torch.zeros(4, 3)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sphere(-1), r"`Sphere\(radius=-1\)`: the radius must be positive"),
        (lambda: Sphere(math.nan), "must be positive and finite"),
        (lambda: Sphere(1, center=(0, 0)), "must be 3 finite numbers"),
        (lambda: Circle(1, center=(0, math.inf)), "must be 2 finite numbers"),
        (lambda: Cuboid((1, 0, 1)), "the sides must be positive"),
        (lambda: Cuboid((1, 1)), "must be 3 finite numbers"),
        (lambda: Cuboid((1, 2, 3), radius=0.6), "half the shortest side, 0.5"),
        (lambda: Rectangle((1, 2), radius=-0.1), "between 0 and half"),
        (lambda: Torus(1, 1.5), "`minor` must be below `major`"),
        (lambda: Cylinder(1, -2), r"`Cylinder\(height=-2\)`"),
        (lambda: Capsule(0, 1), r"`Capsule\(radius=0\)`"),
        (lambda: Dumbbell(0.3, 1, neck=0.4), "thinner than the balls"),
        (lambda: Dumbbell(0.5, 0.7, neck=0.3), "length must be above 0.8"),
        (lambda: Polygon(((0, 0), (1, 0))), "at least three"),
        (lambda: Polygon(((0, 0), (1, 0), (math.nan, 1))), "vertex 2 is not finite"),
        (lambda: Polygon((*SQUARE, (0, 1))), "vertex 3 and the next are both"),
        (lambda: Polygon((SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3])), "edges 0 and 2 cross"),
        (lambda: Polygon(((0, 0), (2, 0), (1, 0))), "edges 0 and 1 cross or touch"),
        (lambda: Translated(Sphere(), (1, 2)), r"the solid is in R\^3"),
        (lambda: Rotated(Sphere(), 1, axis=(0, 0, 0)), "not all zero"),
        (lambda: Rotated(Sphere(), 1, axis=(0, 1)), "three finite numbers"),
        (lambda: Rotated(Sphere(), math.inf), "finite number of radians"),
        (lambda: SmoothUnion(Sphere(), Torus(), blend=0), "must be a positive length"),
        (lambda: SmoothUnion(Sphere(), Circle()), r"R\^3, the second in R\^2"),
        (lambda: Sphere().distance(x2), r"`Sphere.distance\(x\)`: x has the shape \(4, 2\); wanted is \(n, 3\)"),
        (lambda: Circle().distance(x3), r"wanted is \(n, 2\)"),
    ],
)
def test_bad_parameters_are_refused(make, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
