"""Deformations: handles are met, rigid ones cost nothing, and the result is a field like any other."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator

import numpy as np
import pytest
import torch
from jaxtyping import config
from torch import Tensor

from levelflow.boxes import Box
from levelflow.conditions import Sampling
from levelflow.deformation import Elastic, Motion, deform, invertible
from levelflow.elasticity import Shell
from levelflow.extraction import extract
from levelflow.fields import Continued, Deformed, Placed
from levelflow.fitting import fit
from levelflow.handles import BoxRegion, Handle, HandleWarning
from levelflow.minimising import Budget, Divergence, Progress
from levelflow.networks.invertible import InvertibleResNet
from levelflow.networks.periodic import Periodic
from levelflow.networks.siren import SIREN
from levelflow.saving import load, save
from levelflow.shapes import Circle, Rectangle
from tests.fields import Explicit, placed, siren

# A bar ten times as long as a unit, away from the origin.
BAR, CENTER = Rectangle((16.0, 4.0), radius=1.0), (20.0, -30.0)
LEFT, RIGHT = BoxRegion(Box((5, -40), (14, -20))), BoxRegion(Box((26, -40), (35, -20)))
# Few steps with few points are enough to see what is asked for, but for the last digits of the handles.
pytestmark = pytest.mark.filterwarnings("ignore:deform. the handles are missed")
QUICK = {"network": invertible(2, blocks=4), "budget": Budget(120), "n": 128, "resolution": 40}


def bar() -> Placed:
    """The bar itself, as exact as its formula."""

    def distance(x: Tensor, t: Tensor) -> Tensor:
        return BAR.distance(10 * x) / 10  # in half sides of the box

    return Placed(Explicit(distance, 2), Box((10, -40), (30, -20)))


def disc() -> Placed:
    """A field of a disc that can be written, quickly fitted."""
    box, sampling = Box((10, -40), (30, -20)), Sampling(512, given=2000)
    return fit(SIREN(2, width=16, depth=2), Circle(5.0, CENTER), box=box, budget=Budget(150), sampling=sampling)


@pytest.fixture(scope="module", autouse=True)
def unchecked_throughout() -> Iterator[None]:
    """A deformation has many small calls, and their types are checked by the tests of their modules."""
    config.update("jaxtyping_disable", True)
    yield
    config.update("jaxtyping_disable", False)


@pytest.fixture(scope="module")
def bent() -> Placed:
    """The bar with its right end turned by 60 degrees and raised."""
    return deform(bar(), [Handle.fix(LEFT), Handle(RIGHT, by=(-2, 4), angle=60)], **QUICK)


def test_handles_go_where_they_are_to_go(bent: Placed) -> None:
    assert bent.provenance["handles"]["mean"] < 0.05
    handle = Handle(RIGHT, by=(-2, 4), angle=60)
    x = extract(bar(), resolution=64, refine=3).vertices
    right = torch.tensor(handle.target(x[RIGHT.distance(x) == 0], 1.0))
    left = torch.tensor(x[LEFT.distance(x) == 0])
    assert bent(right).abs().mean() < 0.05 and bent(left).abs().mean() < 0.05
    assert bent.box.contains(right).all() and bent.box.contains(torch.tensor([bar().box.lower, bar().box.upper])).all()


def test_nothing_is_torn_and_the_field_stays_a_distance_at_its_surface(bent: Placed) -> None:
    surface = extract(bent, resolution=96, refine=2)
    assert surface.components == 1 and surface.is_watertight
    slopes = bent.jet(torch.tensor(surface.vertices)).gradient.norm(dim=1)
    assert slopes.quantile(0.02) > 0.6 and slopes.quantile(0.98) < 1.5


def test_energies_that_are_told_are_those_of_the_carried_curve(bent: Placed) -> None:
    """Stretching, by the lengths of the segments of a mesh that the inverse carries along."""
    deformation = bent.field.deformation
    surface = extract(bar(), resolution=512, refine=3)
    y = bent.box.frame.to_unit(torch.tensor(surface.vertices))
    x = deformation.inverse(y).double()
    i, j = torch.tensor(surface.faces).T
    rest, now = (torch.linalg.vector_norm(p[i] - p[j], dim=1).double() for p in (y.double(), x))
    known = rest > 0.2 * rest.mean()
    energy = ((1 - (rest / now) ** 2) ** 2 * now)[known].sum() / rest[known].sum()
    assert abs(energy / bent.provenance["energy"]["stretching"] - 1) < 0.1


def test_a_rigid_motion_of_the_whole_is_found_and_costs_nothing() -> None:
    handles = [Handle(region, by=(1, 2), angle=20, center=CENTER) for region in (LEFT, RIGHT)]
    with pytest.warns(HandleWarning, match="deform: all handles ask for the same motion"):
        field = deform(bar(), handles, **(QUICK | {"budget": Budget(200)}))
    assert field.provenance["handles"]["mean"] < 0.02
    assert field.provenance["energy"]["stretching"] < 1e-3


def test_stiff_plates_bend_less_and_soft_ones_stretch_less() -> None:
    handles = [Handle.fix(LEFT), Handle(RIGHT, by=(-2, 4), angle=60)]
    energies = [
        deform(bar(), handles, shell=shell, **QUICK).provenance["energy"] for shell in (Shell(0.1, 0), Shell(0, 0.01))
    ]
    assert energies[0]["stretching"] < energies[1]["stretching"]
    assert energies[1]["bending"] < energies[0]["bending"]


def test_no_energy_at_all_follows_the_first_guess() -> None:
    field = deform(bar(), [Handle.fix(LEFT), Handle.move(RIGHT, by=(0, 3))], shell=Shell(0, 0, 0), **QUICK)
    assert field.provenance["handles"]["mean"] < 0.05


def test_a_deformed_field_is_written_read_and_deformed_again(tmp_path) -> None:
    field = disc()
    top = BoxRegion(Box((5, -28), (35, -20)))
    low = BoxRegion(Box((5, -40), (35, -32)))
    once = deform(field, [Handle.fix(low), Handle.move(top, by=(3, 0))], **QUICK)
    save(once, tmp_path / "once.safetensors")
    read = load(tmp_path / "once.safetensors")
    assert isinstance(read, Placed) and read.provenance == once.provenance
    x = once.box.uniform(100, generator=torch.Generator().manual_seed(0))
    assert torch.equal(read(x), once(x))
    moved = BoxRegion(Box((5, -28), (40, -15)))
    twice = deform(read, [Handle.fix(low), Handle.move(moved, by=(-3, 0))], **QUICK)
    assert isinstance(twice.field, Deformed) and twice.provenance["handles"]["mean"] < 0.1
    # There and back: the top is where it was.
    a, b = (extract(f, resolution=64, refine=2) for f in (field, twice))
    assert a.closest(b.vertices).distance.mean() < 0.3 and b.components == a.components


def test_the_way_there_is_a_field_in_time() -> None:
    handle = Handle(RIGHT, by=(-2, 4), angle=60)
    field = deform(bar(), [Handle.fix(LEFT), handle], path=True, **(QUICK | {"network": invertible(2, 1, blocks=4)}))
    assert field.times == 1 and field.box.times == ((0.0, 1.0),)
    x = extract(bar(), resolution=64, refine=3).vertices
    right = x[RIGHT.distance(x) == 0]
    for t in (0.0, 0.5, 1.0):
        assert field.at(t)(torch.tensor(handle.target(right, t))).abs().mean() < 0.15
    rest = extract(bar(), resolution=64)
    assert rest.closest(extract(field.at(0.0), resolution=64).vertices).distance.mean() < 0.3


def test_a_body_without_handles_stays_where_it_is() -> None:
    def two(x: Tensor, t: Tensor) -> Tensor:
        return torch.minimum((x - x.new_tensor([0.5, 0])).norm(dim=1), (x + x.new_tensor([0.5, 0])).norm(dim=1)) - 0.3

    field = Placed(Explicit(two, 2), Box((-1, -1), (1, 1)))
    handles = [
        Handle.fix(BoxRegion(Box((0, -1), (1, -0.1)))),
        Handle.move(BoxRegion(Box((0, 0.2), (1, 1))), by=(0.1, 0.2)),
    ]
    with pytest.warns(HandleWarning, match="deform: no handle holds any of the bodies"):
        moved = deform(field, handles, **QUICK)
    angle = torch.linspace(0, 2 * math.pi, 20, dtype=torch.float64)
    still = torch.stack([0.3 * angle.cos() - 0.5, 0.3 * angle.sin()], dim=1)
    assert moved(still).abs().mean() < 0.02


def test_an_interrupted_deformation_goes_on_with_the_same_bits() -> None:
    handles = [Handle.fix(LEFT), Handle.move(RIGHT, by=(0, 2))]
    quick = QUICK | {"n": 64, "budget": Budget(30)}
    kept = {}

    def on_step(progress: Progress) -> None:
        if progress.step == 20:
            kept.update({name: value.clone() for name, value in progress.state().items()})

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HandleWarning)
        whole = deform(bar(), handles, on_step=on_step, **quick)
        resumed = deform(bar(), handles, state=kept, **quick)
    for a, b in zip(whole.parameters(), resumed.parameters(), strict=True):
        assert torch.equal(a, b)


def test_points_of_the_surface_are_followed_while_the_network_learns() -> None:
    network = invertible(2).double()
    motion = Motion.of(bar(), [Handle.fix(LEFT), Handle.move(RIGHT, by=(0, 2))], path=False, resolution=32)
    generator = torch.Generator().manual_seed(0)
    elastic = Elastic(network, motion, bar(), Shell(), n=64, generator=generator)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += 0.02 * torch.randn(parameter.shape, generator=generator)
    y, t = elastic.y, elastic.t
    for _ in range(6):
        elastic.memory["x"], _ = elastic._followed(elastic.memory["x"], y, t)
    assert (network(elastic.memory["x"], t) - y).abs().max() < 1e-12
    some = slice(0, 50)
    assert (network.inverse(y[some]) - elastic.memory["x"][some]).abs().max() < 1e-11


def test_the_gradient_of_the_energy_is_that_of_the_inverse() -> None:
    """Against the derivative along a direction of the weights of the energy at D^-1(y), the points found anew."""
    network = invertible(2).double()
    generator = torch.Generator().manual_seed(0)
    motion = Motion.of(bar(), [Handle.fix(LEFT), Handle.move(RIGHT, by=(0, 2))], path=False, resolution=32)
    elastic = Elastic(network, motion, bar(), Shell(1.0, 0.01), n=64, generator=generator)
    parameters = list(network.parameters())
    direction = [torch.randn(p.shape, generator=generator, dtype=p.dtype) for p in parameters]
    with torch.no_grad():
        for p, v in zip(parameters, direction, strict=True):
            p += 0.1 * v

    def batch():
        for _ in range(8):
            elastic.memory["x"], back = elastic._followed(elastic.memory["x"], elastic.y, elastic.t)
        return elastic.memory["x"], elastic.t, elastic.normal, elastic.shares, back

    def energy(step: float) -> float:
        with torch.no_grad():
            for p, v in zip(parameters, direction, strict=True):
                p += step * v
            value = float(elastic.loss(*batch()).mean())
            for p, v in zip(parameters, direction, strict=True):
                p -= step * v
        return value

    elastic.loss(*batch()).mean().backward()
    slope = sum(float((p.grad * v).sum()) for p, v in zip(parameters, direction, strict=True))
    measured = (energy(1e-5) - energy(-1e-5)) / 2e-5
    assert abs(slope / measured - 1) < 1e-4


def test_handles_that_are_missed_are_told() -> None:
    with pytest.warns(HandleWarning, match=r"deform: the handles are missed by .* or --blocks 2"):
        deform(
            bar(), [Handle.fix(LEFT), Handle(RIGHT, angle=170)], network=invertible(2, blocks=1),
            budget=Budget(30), n=64, resolution=32,
        )  # fmt: skip


def test_a_deformation_that_diverges_returns_the_last_good_field() -> None:
    network = invertible(2)
    with torch.no_grad():
        list(network.parameters())[1].fill_(math.nan)
    handles = [Handle.fix(LEFT), Handle.move(RIGHT, by=(0, 2))]
    with pytest.raises(Divergence) as failed:
        deform(bar(), handles, **(QUICK | {"network": network}))
    assert isinstance(failed.value.field, Placed)


@pytest.mark.parametrize(
    ("field", "error", "message"),
    [
        (siren(2), TypeError, "deform: a field in a box is needed, .* this is a SIREN"),
        (placed(2, 1), ValueError, r"deform: the field depends on 1 time\(s\)"),
        (
            Placed(Periodic(SIREN(3, width=4), axes=(0,)), Box((-1, -1), (1, 1))),
            ValueError,
            "deform: the field is periodic",
        ),
    ],
)
def test_what_cannot_be_deformed_is_refused(field, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        deform(field, [Handle.fix(LEFT)])


def test_a_network_of_another_space_is_refused() -> None:
    with pytest.raises(ValueError, match=r"the network has 3 space and 0 time .* wanted is invertible\(2, 0\)"):
        deform(bar(), [Handle.fix(LEFT), Handle.move(RIGHT, by=(0, 1))], network=InvertibleResNet(3), resolution=32)


def test_bad_handles_are_answered_as_in_an_edit() -> None:
    nowhere = BoxRegion(Box((100, 100), (101, 101)))
    with pytest.raises(ValueError, match="deform: the region of handle 1 holds no vertex of the surface"):
        deform(bar(), [Handle.fix(nowhere)], **QUICK)
    with pytest.raises(ValueError, match="deform: there are no handles"):
        deform(bar(), [], **QUICK)


@pytest.mark.parametrize("field", [siren(2), placed(2, 1)])
def test_only_static_fields_in_a_box_are_continued(field) -> None:
    with pytest.raises(ValueError, match=r"Continued: the field has (no box|1 time)"):
        Continued(field)


def test_beyond_its_box_a_field_grows_like_the_distance() -> None:
    field = Continued(placed(2))
    x = torch.tensor([[0.0, 0.0], [4.0, 3.0], [7.0, 7.0]], dtype=torch.float64)
    nearest, gap = torch.tensor([[1.0, 0.0], [4.0, 3.0], [4.0, 3.0]]).double(), torch.tensor([1.0, 0.0, 5.0]).double()
    assert torch.allclose(field(x), placed(2)(nearest) + gap)
    jet = field.jet(x, order=1)
    assert np.allclose(jet.gradient[2].detach(), [0.6, 0.8])
