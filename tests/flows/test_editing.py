"""Edits: handles arrive, what is rigid stays rigid, and a surface meshed anew is as good as one carried along."""

from __future__ import annotations

import numpy as np
import pytest

from levelflow.boxes import Box
from levelflow.extraction import extract
from levelflow.flows import (
    AsRigidAsPossible,
    BlendedMotions,
    Edit,
    Flow,
    ThinShell,
    edge_distortion,
    handle_error,
    volume_change,
)
from levelflow.handles import BoxRegion, Handle, HandleWarning, SphereRegion
from levelflow.shapes import Capsule, Mesh
from tests.flows.test_densifying import bar, ring, tube, turned
from tests.shapes.test_distance import globe

LOW, HIGH = BoxRegion(Box((-2, -2, -1), (2, 2, 0.5))), BoxRegion(Box((-2, -2, 5.5), (2, 2, 7)))
LEFT, RIGHT = BoxRegion(Box((-3, -2), (-1.5, 2))), BoxRegion(Box((1.5, -2), (3, 2)))
ALL = [ThinShell(), BlendedMotions(), BlendedMotions(1.0, 0.1), AsRigidAsPossible()]


def together(mesh: Mesh, handles: list[Handle], densify, steps: int) -> Mesh:
    """An edit whose handles all go the same way, which is warned of."""
    with pytest.warns(HandleWarning, match="all handles ask for the same motion"):
        edit = Edit(mesh, handles, densify=densify)
    return edit.deformed(steps=steps)


def twist(angle: float) -> list[Handle]:
    return [Handle.fix(LOW), Handle.rotate(HIGH, angle=angle, axis=(0, 0, 1))]


@pytest.mark.parametrize("steps", [1, 3])
@pytest.mark.parametrize("densify", ALL, ids=repr)
def test_a_translation_of_all_handles_moves_the_whole(densify, steps: int) -> None:
    by = (1.0, -2.0, 0.5)
    after = together(tube(), [Handle.move(LOW, by=by), Handle.move(HIGH, by=by)], densify, steps)
    assert np.abs(after.vertices - tube().vertices - by).max() < 1e-9


@pytest.mark.parametrize("steps", [1, 7])
@pytest.mark.parametrize("densify", ALL[1:], ids=repr)
def test_a_rigid_motion_of_all_handles_moves_the_whole(densify, steps: int) -> None:
    low, high = (Handle(region, by=(0, 1, 0), angle=100, axis=(1, 2, 3), center=(1, 1, 1)) for region in (LOW, HIGH))
    after = together(tube(), [low, high], densify, steps)
    assert np.abs(after.vertices - low.target(tube().vertices, 1.0)).max() < 1e-8


@pytest.mark.parametrize("densify", ALL[1:], ids=repr)
def test_curves_in_the_plane_move_rigidly_too(densify) -> None:
    handles = [Handle.rotate(region, angle=-70, center=(0, 3)) for region in (LEFT, RIGHT)]
    after = together(ring(), handles, densify, 4)
    assert np.abs(after.vertices - handles[0].target(ring().vertices, 1.0)).max() < 1e-8


def test_a_uniform_scale_of_all_handles_is_reproduced() -> None:
    low, high = (Handle(region, scale=2.0, center=(0, 0, 0)) for region in (LOW, HIGH))
    after = together(tube(), [low, high], BlendedMotions(), 3)
    assert np.abs(after.vertices - 2 * tube().vertices).max() < 1e-8


def test_published_displacements_leave_a_turning_tube_behind_in_any_number_of_steps() -> None:
    handles = [Handle.rotate(region, angle=90, axis=(0, 0, 1)) for region in (LOW, HIGH)]
    exact = turned(tube().vertices, 90)
    for steps in (1, 20):
        after = together(tube(), handles, ThinShell(), steps)
        assert np.abs(after.vertices - exact).max() > 0.5


def test_a_twist_converges_to_the_exact_one() -> None:
    """With stretching alone the weights are linear along the tube, and so is the angle; first order in the steps."""
    x = tube().vertices
    turn = np.radians(90) * np.clip((x[:, 2] - 0.5) / 5, 0, 1)
    exact = np.stack(
        [np.cos(turn) * x[:, 0] - np.sin(turn) * x[:, 1], np.sin(turn) * x[:, 0] + np.cos(turn) * x[:, 1]], 1
    )
    errors = []
    for steps in (10, 20, 40):
        after = Edit(tube(), twist(90), densify=BlendedMotions(1.0, 0.0)).deformed(steps=steps)
        errors.append(np.abs(after.vertices - np.column_stack([exact, x[:, 2]])).max())
    assert errors[0] < 0.05
    assert np.array(errors[:-1]) / errors[1:] == pytest.approx([2, 2], rel=0.1)


def test_a_twist_in_steps_keeps_the_volume() -> None:
    losses = [-volume_change(tube(), Edit(tube(), twist(90)).deformed(steps=steps)) for steps in (1, 10, 40)]
    assert losses[0] > 0.2
    assert losses[1] < 0.03
    assert losses[2] < 0.01


def test_as_rigid_as_possible_does_a_large_turn_in_one_step() -> None:
    """Less is lost than with blended motions in one step, and edges are stretched less."""
    rigid, blended = (
        Edit(tube(), twist(90), densify=densify).deformed(steps=1)
        for densify in (AsRigidAsPossible(), BlendedMotions())
    )
    assert -volume_change(tube(), rigid) < 0.5 * -volume_change(tube(), blended)
    assert edge_distortion(tube(), rigid) < 0.9 * edge_distortion(tube(), blended)


@pytest.mark.parametrize("densify", ALL, ids=repr)
def test_handles_arrive_and_frozen_regions_stay(densify) -> None:
    mesh = bar()
    left, right = BoxRegion(Box((-1, -1, -1), (-0.8, 1, 1))), BoxRegion(Box((0.8, -1, -1), (1, 1, 1)))
    handles = [Handle.fix(left), Handle(right, by=(0, 0.5, 0), angle=40, axis=(0, 0, 1), scale=1.3)]
    edit = Edit(mesh, handles, densify=densify)
    after = edit.deformed(steps=5)
    held = mesh.vertices[:, 0] <= -0.8 + 1e-9
    moved = mesh.vertices[:, 0] >= 0.8 - 1e-9
    assert np.abs(after.vertices - mesh.vertices)[held].max() < 1e-12
    assert np.abs(after.vertices - handles[1].target(mesh.vertices, 1.0))[moved].max() < 1e-10
    assert handle_error(edit, after).max < 1e-10
    assert handle_error(edit, mesh).mean > 0.1


def test_each_step_is_its_part_of_the_way() -> None:
    edit, mesh = Edit(tube(), twist(90)), tube()
    assert isinstance(edit, Flow)
    top = mesh.vertices[:, 2] > 5.6
    half = mesh.vertices + edit.displacement(mesh, 0.5, time=0.0)
    assert np.abs(half - turned(mesh.vertices, 45))[top].max() < 1e-12
    rest = edit.displacement(Mesh(half, mesh.faces), 0.25, time=0.5)
    assert np.abs(half + rest - turned(mesh.vertices, 67.5))[top].max() < 1e-12


def test_a_surface_that_is_meshed_anew_after_each_step_arrives_as_well() -> None:
    """As when a field follows: another mesh at each step, whose vertices no one has seen before."""
    box = Box((-0.6, -0.4, -1), (0.9, 0.4, 1))
    mesh = extract(Capsule(0.25, 1.0).distance, box=box, resolution=40, refine=3)
    top, foot = SphereRegion((0, 0, 0.7), 0.2), BoxRegion(Box((-1, -1, -1), (1, 1, -0.5)))
    edit = Edit(mesh, [Handle.fix(foot), Handle(top, by=(0.3, 0, 0), angle=60, axis=(0, 1, 0))])
    anew, counts = mesh, set()
    for step in range(5):
        moved = Mesh(anew.vertices + edit.displacement(anew, 0.2, time=0.2 * step), anew.faces)
        anew = extract(moved.distance, box=box, resolution=40, refine=3)
        counts.add(len(anew.vertices))
    assert len(counts) == 5
    carried = edit.deformed(steps=5)
    assert handle_error(edit, anew).max < 0.01
    assert carried.closest(anew.vertices).distance.max() < 0.02
    assert anew.closest(carried.vertices).distance.max() < 0.02


def test_a_part_that_comes_close_is_not_taken_along() -> None:
    """The region is a box much wider than the ball in it; the box, not the ball, is moved over another ball."""
    ball = globe(12).vertices / 4
    mesh = Mesh(
        np.concatenate([ball, ball + [2, 0, 0]]), np.concatenate([globe(12).faces, globe(12).faces + len(ball)])
    )
    wide = BoxRegion(Box((-1, -1, -1), (1, 1, 1)))
    far = SphereRegion((2.25, 0, 0), 0.1)
    edit = Edit(mesh, [Handle.move(wide, by=(1, 0, 0)), Handle.fix(far)])
    after = edit.deformed(steps=4)
    assert np.abs(after.vertices[: len(ball)] - ball - [1, 0, 0]).max() < 1e-12
    assert np.abs(after.vertices[len(ball) :] - mesh.vertices[len(ball) :]).max() < 1e-9


def test_what_two_handles_want_in_different_places_by_then_is_free() -> None:
    mesh, waist = tube(), BoxRegion(Box((-2, -2, 2.9), (2, 2, 3.1)))
    edit = Edit(mesh, [Handle.move(LOW, by=(0, 0, 3.0)), Handle.fix(waist), Handle.fix(HIGH)])
    x = np.array(mesh.vertices)
    low = x[:, 2] <= 0.5
    x[low] += [0, 0, 2.7]
    low_by_then, high = edit.pulls(Mesh(x, mesh.faces), 0.9, 1.0)
    wanted_twice = np.abs(x[:, 2] - 3) <= 0.1
    assert (wanted_twice & low).any()
    assert set(np.flatnonzero(low & ~wanted_twice)) < set(low_by_then.vertices)
    assert not wanted_twice[low_by_then.vertices].any()
    assert len(high.vertices) == 5 * 32 + 1


def test_a_handle_that_loses_the_surface_is_warned_of() -> None:
    mesh = tube()
    edit = Edit(mesh, [Handle.fix(LOW, name="foot"), Handle.move(HIGH, by=(0, 0, 9), name="head")])
    with pytest.warns(HandleWarning, match=r"at time 0.5 handle 2 \('head'\) holds no vertex any more"):
        move = edit.displacement(mesh, 0.5, time=0.5)
    assert np.abs(move).max() < 1e-9


@pytest.mark.filterwarnings("ignore:Edit. at time 0.5 handle:levelflow.handles.HandleWarning")
def test_a_surface_that_no_handle_holds_is_refused() -> None:
    mesh = tube()
    away = Mesh(mesh.vertices + [0, 90, 0], mesh.faces)
    with pytest.raises(ValueError, match=r"Edit: at time 0.5 no handle holds any of the 1570 vertices of the mesh"):
        Edit(mesh, twist(90)).displacement(away, 0.5, time=0.5)


def test_bodies_without_a_handle_are_warned_of_and_stay() -> None:
    n = len(globe(8).vertices)
    mesh = Mesh(
        np.concatenate([globe(8).vertices, globe(8).vertices + [4, 0, 0]]),
        np.concatenate([globe(8).faces, globe(8).faces + n]),
    )
    caps = [SphereRegion((0, 0, z), 0.8) for z in (-1, 1)]
    with pytest.warns(
        HandleWarning, match=rf"no handle holds any of the bodies that {n} of {2 * n} vertices belong to"
    ):
        edit = Edit(mesh, [Handle.fix(caps[0]), Handle.move(caps[1], by=(0, 0, 1))])
    after = edit.deformed(steps=2)
    assert not (after.vertices - mesh.vertices)[n:].any()
    assert after.vertices[:n, 2].max() == pytest.approx(2)


def test_an_edit_says_how_far_it_is_and_can_be_ended() -> None:
    seen: list[Mesh] = []

    def on_step(mesh: Mesh) -> None:
        seen.append(mesh)
        if len(seen) > 2:
            raise StopIteration

    edit = Edit(tube(), twist(90))
    assert edit.deformed(steps=2, on_step=on_step) is seen[1] and seen[0] is not seen[1]
    with pytest.raises(StopIteration):
        edit.deformed(steps=2, on_step=on_step)
    assert len(seen) == 3


def test_bad_edits_are_refused() -> None:
    with pytest.raises(ValueError, match="Edit: there are no handles"):
        Edit(tube(), [])
    with pytest.raises(ValueError, match=r"Edit: the region of handle 1 .* is 3 away"):
        Edit(tube(), [Handle.fix(SphereRegion((0, 0, 10), 1.0)), *twist(3)])
    with pytest.raises(ValueError, match="Edit: handle 1 and handle 3 both hold .* want them in different places"):
        Edit(tube(), [*twist(3), Handle.move(LOW, by=(1, 0, 0))])
    edit = Edit(tube(), twist(90))
    for dt, time in ((0.6, 0.5), (0.0, 0.5), (-0.1, 0.5), (0.5, -0.1), (np.nan, 0.0)):
        with pytest.raises(ValueError, match=r"Edit.displacement\(dt=.*, time=.*\): an edit runs from time 0 to 1"):
            edit.displacement(tube(), dt, time=time)
    with pytest.raises(ValueError, match=r"Edit.deformed\(steps=0\): at least one step is needed"):
        edit.deformed(steps=0)


def test_measures_of_known_changes() -> None:
    mesh = tube()
    double, rigid = Mesh(2 * mesh.vertices, mesh.faces), Mesh(turned(mesh.vertices, 33) + 1, mesh.faces)
    assert volume_change(mesh, double) == pytest.approx(7)
    assert edge_distortion(mesh, double) == pytest.approx(np.log(2))
    assert (volume_change(mesh, rigid), edge_distortion(mesh, rigid)) == pytest.approx((0, 0), abs=1e-12)
    assert edge_distortion(ring(), Mesh(ring().vertices / 3, ring().faces)) == pytest.approx(np.log(3))
    # An edge without length says nothing.
    collapsed = np.array(mesh.vertices)
    collapsed[1] = collapsed[0]
    assert np.isfinite(edge_distortion(mesh, Mesh(collapsed, mesh.faces)))
    up = Edit(mesh, [Handle.move(HIGH, by=(0, 0, 0.25)), Handle.fix(LOW)])
    raised = np.array(mesh.vertices)
    raised[raised[:, 2] > 5.99, 2] += 0.25
    assert handle_error(up, Mesh(raised, mesh.faces)).max < 0.01


def test_what_cannot_be_measured_says_why() -> None:
    flat = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    with pytest.raises(ValueError, match="volume_change: .* encloses no volume"):
        volume_change(flat, flat)
    with pytest.raises(ValueError, match="edge_distortion: .* have different faces"):
        edge_distortion(flat, tube())
