"""Fields that follow the flow of their mesh, against where the flow brings what is round."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from levelflow.boxes import Box
from levelflow.conditions import Sampling
from levelflow.evolution import NotFollowed, Step, Vanished, _turned, evolve
from levelflow.extraction import extract
from levelflow.fields import Field, Placed
from levelflow.fitting import fit
from levelflow.flows.flow import Flow
from levelflow.keyframed import Keyframed
from levelflow.minimising import Budget
from levelflow.networks.siren import SIREN
from levelflow.saving import load, save
from levelflow.shapes import Circle, Rectangle, Sphere
from levelflow.shapes.mesh import Mesh

BOX = Box((-1.5, -1.5), (1.5, 1.5))
LITTLE = Sampling(n=512, given=3000)


class Growth(Flow):
    """Away from a centre, at a speed."""

    def __init__(self, speed: float, center: tuple[float, float] = (0.0, 0.0)) -> None:
        self.speed, self.center = speed, np.array(center)

    def __repr__(self) -> str:
        return f"Growth({self.speed})"

    def displacement(self, mesh: Mesh, dt: float, *, time: float) -> np.ndarray:
        away = mesh.vertices - self.center
        return self.speed * dt * away / np.linalg.norm(away, axis=1, keepdims=True)


class Turn(Flow):
    """A turn about the origin, by an angle per unit of time."""

    def displacement(self, mesh: Mesh, dt: float, *, time: float) -> np.ndarray:
        c, s = math.cos(dt), math.sin(dt)
        return mesh.vertices @ np.array([[c, s], [-s, c]]) - mesh.vertices


class Fixed(Flow):
    """The same for every mesh."""

    def __init__(self, value: object) -> None:
        self.value = value

    def displacement(self, mesh: Mesh, dt: float, *, time: float) -> np.ndarray:
        return self.value(mesh)  # type: ignore[operator]


@pytest.fixture(scope="module")
def disc() -> Placed:
    return fitted(Circle(0.6))


def fitted(shape: Circle | Rectangle) -> Placed:
    return fit(SIREN(2, width=32, depth=2), shape, box=BOX, budget=Budget(250), sampling=Sampling(1024, given=10_000))


def radii(field: Field) -> np.ndarray:
    return np.linalg.norm(extract(field, resolution=128, refine=3).vertices, axis=1)


def test_a_disc_grows_by_what_the_flow_says_and_stays_a_distance(disc: Placed) -> None:
    steps: list[Step] = []
    grown = evolve(disc, Growth(0.5), dt=0.1, steps=4, sampling=LITTLE, on_step=steps.append)
    for t in (0.0, 0.2, 0.3, 0.4):
        assert abs(radii(grown.at(t)) - 0.6 - 0.5 * t).max() < 6e-3
    assert [step.number for step in steps] == [1, 2, 3, 4] and steps[0].steps == 4
    assert all(step.gap <= 5e-4 * 1.5 for step in steps)
    slopes = grown.at(0.4).jet(torch.from_numpy(steps[-1].mesh.vertices.copy()), order=1).gradient.norm(dim=1)
    assert (slopes - 1).abs().max() < 0.05
    assert isinstance(grown.field, Keyframed) and grown.box.times == ((0.0, 0.4),)
    assert grown.provenance["flow"] == "Growth(0.5)"


def test_a_motion_along_the_surface_changes_nothing_however_long_the_step(disc: Placed) -> None:
    turned = evolve(disc, Turn(), dt=1.0, steps=1, sampling=LITTLE)
    assert abs(radii(turned.at(1.0)) - 0.6).max() < 4e-3


def test_a_rectangle_is_turned() -> None:
    turned = evolve(fitted(Rectangle((1.2, 0.6), radius=0.15)), Turn(), dt=0.2, steps=2, sampling=LITTLE)
    mesh = extract(turned.at(0.4), resolution=96, refine=3)
    c, s = math.cos(0.4), math.sin(0.4)
    back = torch.from_numpy(mesh.vertices @ np.array([[c, -s], [s, c]]))
    assert Rectangle((1.2, 0.6), radius=0.15).distance(back).abs().mean() < 2e-3


def test_it_goes_on_from_a_file_as_without_a_break(disc: Placed, tmp_path) -> None:
    whole = evolve(disc, Growth(0.3), dt=0.1, steps=2, sampling=LITTLE)
    half = evolve(disc, Growth(0.3), dt=0.1, steps=1, sampling=LITTLE)
    save(half, tmp_path / "half.safetensors")
    again = load(tmp_path / "half.safetensors")
    assert isinstance(again, Placed)
    more = evolve(again, Growth(0.3), dt=0.1, steps=1, sampling=LITTLE)
    x = BOX.uniform(50, generator=torch.Generator().manual_seed(0))
    t = torch.full((50, 1), 0.17, dtype=torch.float64)
    assert torch.equal(more(x, t), whole(x, t))


def test_two_discs_that_run_into_each_other_become_one() -> None:
    class Two(Circle):
        def distance(self, x):
            return torch.minimum(*(Circle(0.4, (c, 0.0)).distance(x) for c in (-0.5, 0.5)))

        def sample(self, n, *, generator):
            parts = [Circle(0.4, (c, 0.0)).sample(n // 2, generator=generator) for c in (-0.5, 0.5)]
            return type(parts[0])(*(torch.cat(pair) for pair in zip(*parts, strict=True)))

        @property
        def box(self):
            return Box((-0.9, -0.4), (0.9, 0.4))

    class Grow(Flow):
        def displacement(self, mesh, dt, *, time):
            return 0.5 * dt * np.asarray(mesh.vertex_normals)

    grown = evolve(fitted(Two(0.4)), Grow(), dt=0.15, steps=2, sampling=LITTLE, tolerance=3e-3)
    before, after = (extract(grown.at(t), resolution=96) for t in (0.0, 0.3))
    assert before.components == 2 and after.components == 1
    # Two discs of the radius r at a distance of 2 c: their lens is counted once.
    r, c = 0.55, 0.5
    lens = 2 * r * r * math.acos(c / r) - 2 * c * math.sqrt(r * r - c * c)
    assert after.volume == pytest.approx(2 * math.pi * r * r - lens, rel=0.02)


def test_what_vanishes_is_said_to(disc: Placed) -> None:
    class Mirror(Flow):
        """Nothing at first, then a mirror image, which is inside out."""

        def displacement(self, mesh, dt, *, time):
            return mesh.vertices * ([-2.0, 0.0] if time >= 1 else [0.0, 0.0])

    with pytest.raises(Vanished, match="nothing inside") as caught:
        evolve(disc, Mirror(), dt=1.0, steps=2, substeps=1, sampling=LITTLE)
    assert caught.value.field is not None and caught.value.field.box.times == ((0.0, 1.0),)


def test_a_surface_that_comes_to_the_box_needs_a_larger_one(disc: Placed) -> None:
    with pytest.raises(NotFollowed, match=r"t = 0.5 the surface meets the box.*more room") as caught:
        evolve(disc, Growth(2.0), dt=0.5, steps=2, sampling=LITTLE, tolerance=0.05)
    assert caught.value.field is not None


def test_what_cannot_be_followed_stops_with_what_there_is(disc: Placed, monkeypatch) -> None:
    monkeypatch.setattr("levelflow.evolution.HALVINGS", 1)
    monkeypatch.setattr("levelflow.evolution.ROUND", 2)
    with pytest.raises(NotFollowed, match=r"from t = 0 on the field does not follow .* in steps of 0.05") as caught:
        evolve(disc, Growth(2.0), dt=0.1, steps=2, sampling=LITTLE, tolerance=1e-6)
    assert caught.value.field is None


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"dt": 0.0, "steps": 1}, r"evolve\(dt=0, steps=1, substeps=4"),
        ({"dt": 1.0, "steps": 0}, "must be positive"),
        ({"dt": 1.0, "steps": 1, "tolerance": 0.0}, "must be positive"),
        ({"dt": 1.0, "steps": 1, "flow": Fixed(lambda mesh: mesh.vertices[:2])}, r"an array of the shape \(2, 2\)"),
        ({"dt": 1.0, "steps": 1, "flow": Fixed(lambda mesh: mesh.vertices * np.nan)}, "is not finite"),
        ({"dt": 1.0, "steps": 1, "flow": Fixed(lambda mesh: mesh.vertices * 0 + 9)}, "whole surface out of the box"),
    ],
    ids=["dt", "steps", "tolerance", "shape", "nan", "away"],
)
def test_wrong_use_is_explained(unchecked: None, disc: Placed, more: dict, message: str) -> None:
    with pytest.raises((ValueError, Vanished), match=message):
        evolve(disc, **{"flow": Growth(1.0), "sampling": LITTLE} | more)


def test_a_field_that_is_no_network_is_refused(unchecked: None, disc: Placed) -> None:
    with pytest.raises(TypeError, match="field of static networks in a box is needed.*this is a SIREN"):
        evolve(SIREN(2), Growth(1.0), dt=1.0, steps=1)
    with pytest.raises(TypeError, match="a Placed of a SIREN"):
        evolve(Placed(SIREN(2, 1), BOX.during((0.0, 1.0))), Growth(1.0), dt=1.0, steps=1)


def test_another_box_gives_the_motion_room(disc: Placed) -> None:
    roomy = Box((-2.0, -2.0), (2.0, 2.0))
    grown = evolve(disc, Growth(0.2), dt=0.1, steps=1, box=roomy, sampling=LITTLE)
    assert (grown.box.lower, grown.box.upper) == (roomy.lower, roomy.upper)
    assert abs(radii(grown.at(0.0)) - 0.6).max() < 4e-3
    assert abs(radii(grown.at(0.1)) - 0.62).max() < 5e-3


@pytest.mark.parametrize("space", [2, 3])
def test_normals_change_as_those_of_the_moved_surface_do(space: int, generator: torch.Generator) -> None:
    """Those of the faces become those of the moved faces, under any linear map, and all others turn in a rotation."""
    map_ = torch.eye(space, dtype=torch.float64) + 0.3 * torch.rand(space, space, generator=generator).double()
    shape = Circle(0.6) if space == 2 else Sphere(0.6)
    mesh = extract(shape.distance, box=Box((-1.0,) * space, (1.0,) * space), resolution=12)
    moved = Mesh(mesh.vertices @ map_.T.numpy(), mesh.faces)
    normals = torch.nn.functional.normalize(torch.randn(20, space, generator=generator).double(), dim=1)
    face = np.arange(20)
    found = _turned(mesh, moved, face, torch.from_numpy(np.asarray(mesh.face_normals)[face].copy()))
    assert found.numpy() == pytest.approx(np.asarray(moved.face_normals)[face], abs=1e-9)
    turn = torch.linalg.qr(map_)[0]
    turn[:, 0] *= torch.linalg.det(turn)
    turned = Mesh(mesh.vertices @ turn.T.numpy(), mesh.faces)
    assert _turned(mesh, turned, face, normals).numpy() == pytest.approx((normals @ turn.T).numpy(), abs=1e-9)
    assert _turned(mesh, Mesh(0 * mesh.vertices, mesh.faces), face, normals).numpy() == pytest.approx(normals.numpy())


def test_what_is_finer_than_the_mesh_stays() -> None:
    """A flow that moves nothing, followed on a mesh of a cell that is as large as the corners are round."""
    field = fitted(Rectangle((1.2, 0.8), radius=0.1))
    still = Fixed(lambda mesh: np.zeros_like(mesh.vertices))
    after = evolve(field, still, dt=1.0, steps=2, resolution=24, sampling=LITTLE)
    before, now = (extract(f, resolution=200, refine=3) for f in (field, after.at(2.0)))
    assert before.closest(now.vertices).distance.mean() < 1.5e-3


def test_one_mesh_all_the_way_strays_less_and_can_be_continued() -> None:
    """A turn in four steps, on cells as large as the corners are round."""
    field, quarter = fitted(Rectangle((1.2, 0.8), radius=0.1)), math.pi / 8
    start = extract(field, resolution=200, refine=3)
    turned = Mesh(start.vertices + Turn().displacement(start, 4 * quarter, time=0.0), start.faces)

    def error(after: Placed) -> float:
        now = extract(after.at(4 * quarter), resolution=200, refine=3)
        return float(turned.closest(now.vertices).distance.mean())

    anew, one = (
        evolve(field, Turn(), dt=quarter, steps=4, resolution=24, tolerance=2e-3, remesh=remesh, sampling=LITTLE)
        for remesh in (True, False)
    )
    assert error(one) < 0.7 * error(anew)
    half = evolve(field, Turn(), dt=quarter, steps=2, resolution=24, tolerance=2e-3, remesh=False, sampling=LITTLE)
    whole = evolve(half, Turn(), dt=quarter, steps=2, resolution=24, tolerance=2e-3, remesh=False, sampling=LITTLE)
    x = BOX.uniform(50, generator=torch.Generator().manual_seed(0))
    assert whole.at(4 * quarter)(x).tolist() == one.at(4 * quarter)(x).tolist()
