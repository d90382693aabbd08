"""Rivals of `evolve`: that they move fields as their formulas say, exactly where these are exact."""

from __future__ import annotations

import importlib
import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from levelflow import SIREN, Box, Placed, extract
from levelflow.evolution import Step, Vanished
from levelflow.fields import Field
from levelflow.flows import NormalOffset, Prescribed
from levelflow.jets import Jet
from levelflow.shapes import Mesh, Sphere, Torus
from tests.axisymmetric import ring

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks"
CUBE = Box((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch):
    """Imports a script of the folder as its neighbours do."""
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module


class Ball(Field):
    """|x| - r, with r the only weight."""

    def __init__(self, radius: float, space: int = 3) -> None:
        super().__init__()
        self.space, self.times, self.periodic = space, 0, ()
        self.radius = nn.Parameter(torch.tensor(radius, dtype=torch.float64))

    def push(self, jet: Jet) -> Jet:
        norm = jet.value.norm(dim=1)
        first = None if jet.first is None else torch.einsum("ni,nij->nj", jet.value / norm[:, None], jet.first)
        return Jet(norm - self.radius, first, None, jet.space)


class Half(Field):
    """Steepness times (<n, x> - c), with c the only weight."""

    def __init__(self, normal: tuple[float, ...], offset: float, steepness: float = 1.0) -> None:
        super().__init__()
        self.space, self.times, self.periodic = len(normal), 0, ()
        self.normal = steepness * torch.tensor(normal, dtype=torch.float64)
        self.offset = nn.Parameter(steepness * torch.tensor(offset, dtype=torch.float64))

    def push(self, jet: Jet) -> Jet:
        first = None if jet.first is None else torch.einsum("i,nij->nj", self.normal, jet.first)
        return Jet(jet.value @ self.normal - self.offset, first, None, jet.space)


def placed(field: Field) -> Placed:
    return Placed(field, CUBE if field.space == 3 else Box((-1.0, -1.0), (1.0, 1.0)))


def derivative(followers, field: Field) -> Tensor:
    """dx/dtheta of points with one weight, (n, d)."""
    (weight,) = field.parameters()
    x = followers.at(field)
    return torch.stack([torch.autograd.grad(column, weight, retain_graph=True)[0] for column in x.reshape(-1)]).reshape(
        x.shape
    )


@pytest.mark.parametrize("space", [2, 3])
def test_vertices_of_a_sphere_move_along_the_normal_with_its_radius(script, space):
    meshsdf, field = script("meshsdf"), placed(Ball(0.5, space))
    mesh = extract(field, resolution=12, refine=3)
    found = meshsdf.vertices(field, mesh, np.zeros_like(mesh.vertices))
    truth = found.points / found.points.norm(dim=1, keepdim=True)
    assert torch.equal(found.at(field), found.points)
    assert torch.allclose(derivative(found, field), truth, atol=1e-6)


@pytest.mark.parametrize("space", [2, 3])
def test_points_seen_on_a_sphere_move_along_their_rays_with_its_radius(script, space):
    r"""On a ray o + s r the sphere is met at $s = -o r - \sqrt{(o r)^2 - o^2 + \theta^2}$."""
    raymarching, field = script("raymarching"), placed(Ball(0.5, space))
    mesh = extract(field, resolution=12, refine=3)
    ray = torch.tensor([0.36, -0.48, 0.8][-space:], dtype=torch.float64)
    ray = ray / ray.norm()
    seen = raymarching.Rays([ray.tolist()], rays=15)
    found = seen(field, mesh, np.zeros_like(mesh.vertices))
    x = found.points
    assert len(x) > (50 if space == 3 else 4)
    assert torch.allclose(x.norm(dim=1), torch.tensor(0.5, dtype=torch.float64), atol=1e-6)
    cosine = (x / 0.5) @ ray
    assert (cosine < -raymarching.GRAZING).all() and cosine.max() > -0.7
    origin = x - 3 * ray
    root = ((origin @ ray) ** 2 - origin.square().sum(1) + 0.25).sqrt()
    assert torch.allclose(derivative(found, field), -ray * (0.5 / root)[:, None], rtol=1e-4)


def test_rays_along_the_normal_move_points_as_an_extraction_does(script):
    """Result 3 of the paper: the steps are the same, whatever the slope of the field."""
    meshsdf, raymarching = script("meshsdf"), script("raymarching")
    field = placed(Half((0.0, 0.6, 0.8), 0.1))
    mesh = extract(Placed(Ball(0.5), CUBE), resolution=8)
    seen = raymarching.Rays([(0.0, -0.6, -0.8)], rays=9)(field, mesh, np.zeros_like(mesh.vertices))
    same = meshsdf.vertices(field, Mesh(seen.points.numpy(), np.zeros((1, 3), int)), np.zeros((len(seen.points), 3)))
    assert torch.allclose(seen.response, same.response, atol=1e-6)


@pytest.mark.parametrize(("rival", "aside"), [("meshsdf", 0.3), ("raymarching", 0.0)])
def test_a_field_with_the_right_weight_is_moved_exactly(script, rival, aside):
    """Cauchy's step ends where it should if there is one weight, and the surface moves with it in a straight line."""
    evolve, steps = script(rival).evolve, list[Step]()
    moved = evolve(
        placed(Half((0.0, 0.0, 1.0), -0.2)), Prescribed((aside, 0.0, 0.5)), dt=0.1, steps=3, resolution=8,
        on_step=steps.append,
    )  # fmt: skip
    assert moved.box.times == ((0.0, pytest.approx(0.3)),)
    assert [step.number for step in steps] == [1, 2, 3] and max(step.gap for step in steps) < 1e-6
    for t, height in ((0.0, -0.2), (0.15, -0.125), (0.3, -0.05)):
        x = torch.tensor([[0.4, -0.7, height]], dtype=torch.float64)
        assert moved.at(t)(x).detach().abs() < 1e-6
    grown = evolve(placed(Ball(0.4)), NormalOffset(0.5), dt=0.1, steps=2, resolution=16)
    assert grown.field.fields[-1].radius.item() == pytest.approx(0.5, abs=2e-3)


def test_a_tangential_field_moves_what_rays_see_but_not_what_is_extracted(script):
    """Result 4 of the paper, on a tilted plane: a point dragged along it is taken to have moved along its ray."""
    field, along = placed(Half((0.0, 0.6, 0.8), 0.0)), Prescribed((0.0, 0.8, -0.6))
    still = script("meshsdf").evolve(field, along, dt=0.1, steps=1, resolution=8)
    assert abs(still.field.fields[-1].offset.item()) < 1e-6
    dragged = script("raymarching").evolve(field, along, dt=0.1, steps=1, resolution=8, directions=[(0.0, 0.0, -1.0)])
    # By |D| times the tangent of the angle between the ray and the normal, eq. 12.
    assert dragged.field.fields[-1].offset.item() == pytest.approx(-0.1 * 0.75, abs=1e-6)


def test_the_length_of_a_step_is_the_best_there_is(script, generator):
    meshsdf = script("meshsdf")
    field = placed(SIREN(3, width=16, depth=2, omega=2.0, dtype=torch.float64))
    x = CUBE.uniform(40, generator=generator)
    response, wanted = (0.01 * torch.randn(40, 3, generator=generator, dtype=torch.float64) for _ in range(2))
    seen = meshsdf.Followers(x, 100 * response, 1e-4 * wanted)
    start = [p.detach().clone() for p in field.parameters()]
    before = field(x).detach()
    meshsdf.descend(field, seen, meshsdf.GRADIENT(field.parameters()))
    ends = [p.detach().clone() for p in field.parameters()]

    def miss(share: float) -> float:
        with torch.no_grad():
            for p, a, b in zip(field.parameters(), start, ends, strict=True):
                p.copy_(a + share * (b - a))
            return float((field(x) - before + (seen.response * seen.displacement).sum(1)).square().sum())

    assert miss(1.0) < min(miss(0.9), miss(1.1), miss(0.0))


@pytest.mark.parametrize("sign", [1, -1])
def test_of_an_optimiser_only_the_direction_counts(script, sign):
    adam = partial(torch.optim.Adam, lr=1e-6)
    evolve = script("meshsdf").evolve
    moved = evolve(
        placed(Half((0.0, 0.0, 1.0), 0.0)), NormalOffset(sign), dt=0.1, steps=2, resolution=8, optimiser=adam
    )
    assert moved.field.fields[-1].offset.item() == pytest.approx(sign * 0.2, abs=1e-6)


def test_an_optimiser_takes_the_steps_if_one_is_given(script):
    """Plain descent at the rate 1/2 on f = |x| - r: the radius changes by half the mean of <n, D>."""
    evolve = script("meshsdf").evolve
    rate = partial(torch.optim.SGD, lr=0.5)
    grown = evolve(
        placed(Ball(0.4)), NormalOffset(0.5), dt=0.1, steps=2, parts=2, resolution=16, optimiser=rate, search=False
    )
    assert grown.field.fields[-1].radius.item() == pytest.approx(0.45, abs=1e-3)


def test_what_vanishes_is_said_to(script):
    with pytest.raises(Vanished, match=r"no surface left at t = 0.2") as caught:
        script("meshsdf").evolve(placed(Ball(0.3)), NormalOffset(-2.0), dt=0.2, steps=3, substeps=1, resolution=16)
    assert caught.value.field is not None


def test_values_between_vertices_are_linear(script, generator):
    mesh = extract(placed(Ball(0.5)), resolution=10)
    weight, rng = mesh.sample(50, generator=generator).points.numpy(), np.random.default_rng(0)
    matrix = rng.normal(size=(3, 2))
    found = script("raymarching").interpolated(mesh, mesh.vertices @ matrix + 1, weight)
    assert np.allclose(found, weight @ matrix + 1, atol=1e-9)
    assert math.isclose(found.mean(), (weight @ matrix + 1).mean())


def test_thin_rings_collapse_when_their_section_says(script, monkeypatch):
    following = script("following")
    monkeypatch.setattr(following, "TORUS", (1.0, 0.2, ring(1.0, 0.2)))
    torus = Torus(1.0, 0.2)
    mesh = extract(torus.distance, box=torus.box.expanded(0.1), resolution=64, refine=3)
    assert abs(following.collapse(mesh, 0.0)) < 1e-2


def test_the_order_and_the_limit_of_errors_are_found(script):
    row = script("following").extrapolated("first", [0.03 + 0.08 / n for n in (1, 2, 4)])
    assert row == ["first", "+11.000", "+7.000", "+5.000", "+3.000", "1.00"]


def test_a_section_has_its_tables_and_says_what_was_found(script, capsys):
    following = script("following")
    section = following.Section("A title", "How.", "It is so.", "It is.")
    add = section.table("row", "a", "b")
    add(["first", "1", "2"])
    assert capsys.readouterr().out.split() == ["A", "title", "row", "a", "b", "first", "1", "2"]
    parts = following.document([section], "it.png").split("\n\n")
    assert parts[-4:-1] == ["How.", "**Paper:** It is so.", "**Found:** It is."]
    assert parts[-1] == "| row | a | b |\n|---|---|---|\n| first | 1 | 2 |\n"
    assert any("(it.png)" in part for part in parts)


def test_a_ball_is_round_and_its_radius_known(script):
    following = script("following")
    mesh = extract(Sphere(0.5).distance, box=CUBE, resolution=24, refine=3)
    assert float(following.roundness(mesh)) == pytest.approx(1.0, abs=0.01)
    assert following.radial(mesh, 0.4) == pytest.approx(0.25, abs=1e-5)
