"""Boxes: what they contain, what is drawn from them, and their similarity."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from levelflow.boxes import Box, Frame

BOX = Box((1, -2), (4, 3), ((2, 5),))


def test_a_frame_takes_the_longest_side_to_the_interval_from_minus_one_to_one() -> None:
    corners = torch.tensor([BOX.lower, BOX.upper], dtype=torch.float64)
    exact = torch.tensor([[-0.6, -1], [0.6, 1]], dtype=torch.float64)
    assert BOX.frame == Frame(center=(2.5, 0.5), scale=2.5)
    assert torch.allclose(BOX.frame.to_unit(corners), exact, atol=1e-15)
    assert torch.allclose(BOX.frame.from_unit(exact), corners, atol=1e-15)


def test_there_and_back_is_the_identity_far_from_the_origin(generator: torch.Generator) -> None:
    frame = Frame((1e6, -3e6), 0.7)
    x = torch.tensor(frame.center) + torch.rand(100, 2, generator=generator, dtype=torch.float64)
    assert torch.allclose(frame.from_unit(frame.to_unit(x)), x, rtol=1e-15)


def test_points_keep_their_dtype_and_lose_nothing_else() -> None:
    x = torch.tensor([[1e6 + 0.5, 0.25]])
    unit = Frame((1e6, 0.0), 2.0).to_unit(x)
    assert unit.dtype == torch.float32
    assert unit.tolist() == [[0.25, 0.125]]


def test_the_frame_of_a_single_point_has_the_scale_one() -> None:
    assert Box((1, 1), (1, 1)).frame == Frame((1.0, 1.0), 1.0)


def test_sizes_and_centres() -> None:
    assert (BOX.space, BOX.center, BOX.size) == (2, (2.5, 0.5), (3.0, 5.0))


def test_the_box_around_points_is_the_same_for_arrays_and_tensors(generator: torch.Generator) -> None:
    x = torch.rand(50, 3, generator=generator, dtype=torch.float64)
    assert Box.around(x) == Box.around(x.numpy())
    assert Box.around(x).contains(x).all()
    assert not Box.around(x[1:-1]).expanded(-1e-9).contains(x).all()


def test_expanding_moves_every_side_out() -> None:
    assert BOX.expanded(0.5) == Box((0.5, -2.5), (4.5, 3.5), ((2, 5),))


def test_a_box_during_other_times_is_the_same_in_space() -> None:
    assert BOX.during((0, 1), (2, 3)) == Box((1, -2), (4, 3), ((0, 1), (2, 3)))
    assert BOX.during().times == ()


def test_the_union_contains_both_and_has_the_times_of_the_first() -> None:
    assert BOX.union(Box((0, 0), (2, 7)), Box((3, -3), (3, 0))) == Box((0, -3), (4, 7), ((2, 5),))
    assert BOX.union() == BOX


def test_a_box_contains_its_sides_and_not_what_lies_beyond() -> None:
    x = torch.tensor([[1.0, 0.0], [4.0, 3.0], [0.999, 0.0], [2.0, 3.001]])
    assert BOX.contains(x).tolist() == [True, True, False, False]


def test_uniform_points_fill_the_box_evenly(generator: torch.Generator) -> None:
    x = BOX.uniform(40_000, generator=generator)
    assert x.dtype == torch.float64 and BOX.contains(x).all()
    cells = ((x - torch.tensor(BOX.lower)) / torch.tensor(BOX.size) * 4).long()
    share = torch.bincount(4 * cells[:, 0] + cells[:, 1], minlength=16) / len(x)
    assert (share - 1 / 16).abs().max() < 5 * math.sqrt(1 / 16 / len(x))


def test_uniform_times_fill_the_intervals(generator: torch.Generator) -> None:
    t = BOX.during((2, 5), (-1, -1)).uniform_times(10_000, generator=generator, dtype=torch.float32)
    assert t.shape == (10_000, 2) and t.dtype == torch.float32
    assert t[:, 0].min() >= 2 and t[:, 0].max() <= 5 and abs(t[:, 0].mean() - 3.5) < 0.05
    assert (t[:, 1] == -1).all()
    assert BOX.during().uniform_times(3, generator=generator).shape == (3, 0)


@pytest.mark.usefixtures("unchecked")
def test_numbers_of_any_kind_become_floats() -> None:
    box = Box(np.array([0, 1]), torch.tensor([2.0, 3.0]), [(0, 1)])  # type: ignore[arg-type]
    assert box == Box((0.0, 1.0), (2.0, 3.0), ((0.0, 1.0),))
    assert all(type(value) is float for value in (*box.lower, *box.upper, *box.times[0]))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((0, 0), (1, 1, 1)), "the corners have 2 and 3 coordinates; give the same number"),
        (((), ()), "the corners have 0 and 0 coordinates"),
        (((0, math.nan), (1, 1)), "must be finite numbers"),
        (((0, 0), (1, math.inf)), "must be finite numbers"),
        (((0, 2), (1, 1)), r"the lower corner \(0.0, 2.0\) is not below the upper corner \(1.0, 1.0\)"),
        (((0, 0), (1, 1), ((1, 0),)), r"the times \(\(1.0, 0.0\),\) must be pairs \(first, last\) in order"),
        (((0, 0), (1, 1), ((0, math.nan),)), "must be pairs"),
    ],
)
def test_corners_and_times_that_make_no_box_are_refused(arguments: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=f"^Box: .*{message}"):
        Box(*arguments)


def test_points_come_in_on_the_other_side_along_the_axes_that_repeat() -> None:
    box = Box((1, -2), (4, 0))
    x = torch.tensor([[1.5, -1.0], [4.5, -1.0], [-5.0, 3.0], [1.0, 0.0]], dtype=torch.float64)
    assert torch.equal(box.wrapped(x, (0,)), torch.tensor([[1.5, -1.0], [1.5, -1.0], [1.0, 3.0], [1.0, 0.0]]).double())
    assert torch.equal(box.wrapped(x, ()), x)
    assert BOX.wrapped(x.new_tensor([BOX.upper]), range(BOX.space)).tolist() == [list(BOX.lower)]


def test_a_cube_is_as_long_on_all_sides_as_the_longest() -> None:
    cube = Box((0.0, 1.0, -4.0), (2.0, 2.0, 0.0)).during((0.0, 1.0)).cube()
    assert (cube.lower, cube.upper, cube.times) == ((-1.0, -0.5, -4.0), (3.0, 3.5, 0.0), ((0.0, 1.0),))
