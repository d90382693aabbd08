"""Which motions of a family are told not to commute, and by how much."""

from __future__ import annotations

import math
import warnings

import pytest

from levelflow import SIREN, Box, Budget, Circle, Sampling, Transported, load, save, solve
from levelflow.equations import (
    Constant,
    Family,
    MeanCurvature,
    Regional,
    Rotation,
    Source,
    SphereMask,
    Stationary,
    Transport,
    Twist,
)
from levelflow.equations.commuting import warn_of_order
from levelflow.fields import Placed

PLANE, SPACE = Box((-1.0, -1.0), (1.0, 1.0)), Box((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))
EAST, NORTH, TURN = Transport((1.0, 0.0)), Transport((0.0, 1.0)), Transport(Rotation(0.5))
GROW, SMOOTH = Transport(Source((0.0, 0.0), 0.5)), MeanCurvature(0.1)
MIDDLE, CORNER = SphereMask((0.0, 0.0), 0.3, 0.2), SphereMask((0.5, 0.5), 0.3, 0.2)


def told(*motions, box=PLANE, ends=(0.0, 1.0), start=0.0):
    """The warning, or nothing."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        family = Family(*motions)
        warn_of_order(family, box.during(*[ends] * len(motions)), [start] * len(motions), "So be it.", call="test")
    assert len(found) < 2
    return str(found[0].message) if found else ""


@pytest.mark.parametrize(
    ("motions", "box"),
    [
        ((EAST, NORTH), PLANE),
        ((EAST, EAST + NORTH, Stationary()), PLANE),
        ((TURN, Transport(Rotation(-2.0))), PLANE),
        ((TURN, GROW), PLANE),
        ((Transport(Rotation(1.0)), Transport(Twist(2.0)), Transport((0.0, 0.0, 0.0))), SPACE),
        ((EAST, SMOOTH), PLANE),
        ((SMOOTH, TURN + NORTH), PLANE),
        ((SMOOTH, SMOOTH), PLANE),
        ((TURN, Regional(SMOOTH, MIDDLE)), PLANE),
    ],
)
def test_motions_that_commute_are_not_complained_of(motions, box):
    assert told(*motions, box=box) == ""


@pytest.mark.parametrize(
    ("motions", "box", "parts"),
    [
        ((EAST, TURN), PLANE, (f"{EAST!r} before {TURN!r} takes points up to 0.495 away", "25 % of the box")),
        (
            (EAST, SMOOTH, GROW),
            PLANE,
            (f"{GROW!r} has a strain of", f"lengths, on which {SMOOTH!r} depends", f"{EAST!r} before {GROW!r}"),
        ),
        ((Transport(Twist(1.0)), MeanCurvature(1.0)), SPACE, ("it changes lengths",)),
        ((EAST, Regional(SMOOTH, CORNER)), PLANE, (f"{EAST!r} takes points to where the mask of Regional",)),
        ((TURN, Regional(SMOOTH, CORNER)), PLANE, ("to where the mask of Regional", "is another, by up to 1.")),
        ((Regional(EAST, MIDDLE), NORTH), PLANE, ("% of the box",)),
    ],
)
def test_motions_that_do_not_commute_are_named_with_the_size(motions, box, parts):
    found = told(*motions, box=box)
    assert all(part in found for part in parts), found
    assert found.startswith("test: not all motions of the family commute.") and found.endswith("first. So be it.")


def test_a_turn_and_a_push_end_as_far_apart_as_they_should():
    """Of a push by b and a turn by an angle a the two orders differ by (R - I) b everywhere: 2 sin(a / 2) |b|."""
    assert f"{2 * math.sin(0.25):.3g} away" in told(EAST, TURN)
    assert f"{2 * 2 * math.sin(0.5):.3g} away" in told(EAST, TURN, ends=(-2.0, 1.0))
    assert told(EAST, TURN, ends=(0.0, 0.01)) == ""


@pytest.mark.filterwarnings("ignore:sample_surface")
def test_solving_and_carrying_warn_once_and_loading_does_not(tmp_path):
    quick = {"budget": Budget(2), "sampling": Sampling(64, given=500)}
    with pytest.warns(UserWarning, match="Training settles between the two orders") as found:
        solve(
            Family(EAST, TURN), SIREN(2, 2, width=8), at={(0.0, 0.0): Circle(0.5)}, until=(1.0, 1.0), box=PLANE, **quick
        )
    assert sum("commute" in str(one.message) for one in found) == 1
    static = Placed(SIREN(2, width=8), PLANE)
    with pytest.warns(UserWarning, match="They run in the order in which they are given") as found:
        field = Transported(Family(EAST, TURN), static, box=PLANE.during((0.0, 1.0), (0.0, 1.0)))
    assert len(found) == 1
    save(field, tmp_path / "f.safetensors")
    assert repr(load(tmp_path / "f.safetensors").motion) == repr(field.motion)
    Transported(Family(EAST, Transport(Constant((0.0, 2.0)))), static, box=PLANE.during((0.0, 1.0), (0.0, 1.0)))
