import numpy as np
import pytest

from levelflow.export.scene import Scene, kept, origin
from levelflow.export.snapshots import Snapshot, snapshots
from tests.export.moving import growing


def test_evenly_spaced_times_are_whole_frames():
    assert Scene().frames([-1.0, -0.9, -0.8]) == (0.0, 1.0, 2.0)
    assert Scene().frames([0.0, 0.1, 1.0]) == (0.0, 0.2, 2.0)
    assert Scene().frames([5.0]) == (0.0,) and Scene().frames([]) == ()


def test_the_pace_is_seconds_of_film_by_units_of_time():
    assert Scene(fps=10).seconds_per_time([0.0, 1.0, 2.0]) == pytest.approx(0.1)
    assert Scene(fps=10).seconds_per_time([3.0]) == pytest.approx(0.1)


@pytest.mark.parametrize("name", ["metres_per_unit", "fps"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("inf"), float("nan")])
def test_lengths_and_rates_are_positive(name, value):
    with pytest.raises(ValueError, match=rf"Scene\({name}=.*positive"):
        Scene(**{name: value})


def test_coordinates_have_their_origin_at_the_shape_only_if_it_is_far_away():
    near, far = (list(snapshots(growing(c), [0.0], resolution=8)) for c in ((1.0, 2.0, 3.0), (1e5, 2.0, 3.0)))
    assert not origin(near).any()
    assert np.allclose(origin(far), (1e5, 2, 3), atol=0.1)


def test_there_has_to_be_a_surface():
    with pytest.raises(ValueError, match="write_x: none of the 1 snapshots holds a surface"):
        kept([Snapshot(0.0, None)], call="write_x")
    with pytest.raises(ValueError, match="write_x: this format holds surfaces, no curves"):
        kept(list(snapshots(growing(space=2), [0.0], resolution=8)), call="write_x")
