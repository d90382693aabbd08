import threading
import time

import pytest

from levelflow import Box
from levelflow.boxes import Frame
from levelflow.viewer.frames import Frames, Glance, Rank, Superseded, shared_frames
from levelflow.viewer.packing import unpack
from levelflow.viewer.viewed import Surface, Viewed, ViewedField
from tests.export.moving import growing


class Slow(Viewed):
    """Takes steps until it is let go, and notes which frames took them."""

    def __init__(self):
        self.name, self.box, self.quantities = "slow", Box((-1.0,) * 3, (1.0,) * 3, ((0.0, 9.0),)), ()
        self.log, self.go = [], {}

    def surface(self, time, *, resolution, pause=lambda: None):
        go = self.go.setdefault(tuple(time), threading.Event())
        while not go.wait(0.002):
            pause()
            self.log.append(tuple(time))
        pause()
        self.log.append("done")
        return Surface(tuple(time), None, {}, "")

    def values(self, x, time):
        raise NotImplementedError

    def snapshot(self, time, *, resolution):
        raise NotImplementedError


def in_thread(call):
    found = []

    def run():
        try:
            found.append(call())
        except BaseException as error:
            found.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    return thread, found


def until(condition):
    end = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.001)


def test_a_frame_is_computed_once_and_is_the_surface():
    frames = Frames([ViewedField(growing(), name="")])
    data = frames.get(0, (0.5,), resolution=16)
    header, arrays = unpack(data)
    assert header["time"] == [0.5] and len(arrays["position"])
    assert frames.get(0, (0.5,), resolution=16) is data and frames.size == len(data)
    assert frames.get(0, (0.5,), resolution=12) is not data


def test_the_frames_not_used_for_longest_go():
    viewed = ViewedField(growing(), name="")
    size = len(Frames([viewed]).get(0, (1.0,), resolution=12))
    frames = Frames([viewed], room=int(2.5 * size))
    first = frames.get(0, (1.0,), resolution=12)
    frames.get(0, (0.9,), resolution=12)
    assert frames.get(0, (1.0,), resolution=12) is first
    frames.get(0, (0.8,), resolution=12)
    assert frames.get(0, (1.0,), resolution=12) is first and frames.size <= frames.room
    small = Frames([viewed], room=1)
    assert small.get(0, (1.0,), resolution=12) is small.get(0, (1.0,), resolution=12)


def test_two_who_want_the_same_wait_for_one():
    slow = Slow()
    frames = Frames([slow])
    threads = [in_thread(lambda: frames.get(0, (1.0,), resolution=8)) for _ in range(2)]
    until(lambda: slow.log)
    slow.go[1.0,].set()
    for thread, _ in threads:
        thread.join()
    assert slow.log.count("done") == 1 and threads[0][1][0] is threads[1][1][0]


def test_what_is_looked_at_comes_first():
    slow = Slow()
    frames = Frames([slow])
    ahead, _ = in_thread(lambda: frames.get(0, (1.0,), resolution=8, rank=Rank.AHEAD))
    until(lambda: (1.0,) in slow.log)
    now, _ = in_thread(lambda: frames.get(0, (2.0,), resolution=8))
    until(lambda: (2.0,) in slow.log)
    time.sleep(0.02)
    mark = len(slow.log)
    time.sleep(0.03)
    assert set(slow.log[mark:]) == {(2.0,)}
    # Whoever asks for it now makes the other as urgent.
    again, _ = in_thread(lambda: frames.get(0, (1.0,), resolution=8))
    until(lambda: (1.0,) in slow.log[mark:])
    for t in (1.0, 2.0):
        slow.go[t,].set()
    for thread in (ahead, now, again):
        thread.join()
    assert slow.log.count("done") == 2


def test_what_was_wanted_soon_is_given_up_when_the_eye_moves_on():
    slow = Slow()
    frames = Frames([slow])
    soon, found = in_thread(lambda: frames.get(0, (1.0,), resolution=8, rank=Rank.SOON, glance=Glance("page", 1)))
    until(lambda: (1.0,) in slow.log)
    slow.go[2.0,] = threading.Event()
    slow.go[2.0,].set()
    frames.get(0, (2.0,), resolution=8, glance=Glance("another page", 5))
    assert not found
    frames.get(0, (2.0,), resolution=8, glance=Glance("page", 2))
    soon.join()
    (error,) = found
    assert isinstance(error, Superseded) and "glance 1 is over" in str(error)
    slow.go[1.0,].set()
    assert frames.get(0, (1.0,), resolution=8)


def test_an_error_is_told_and_not_kept():
    frames = Frames([ViewedField(growing(), name="")])
    for _ in range(2):
        with pytest.raises(ValueError, match=r"at\(7\): the field was solved for times"):
            frames.get(0, (7.0,), resolution=8)
    assert frames.size == 0


def test_like_shapes_share_their_place_and_unlike_ones_do_not():
    near = [Box((-1.0,) * 3, (1.0,) * 3), Box((0.0,) * 3, (3.0,) * 3)]
    assert shared_frames(near) == [Frame((1.0,) * 3, 2.0)] * 2
    far = [Box((-1.0,) * 3, (1.0,) * 3), Box((5.0,) * 3, (6.0,) * 3)]
    assert shared_frames(far) == [box.frame for box in far]
    large = [Box((-1.0,) * 3, (1.0,) * 3), Box((-50.0,) * 3, (50.0,) * 3)]
    assert shared_frames(large) == [box.frame for box in large]
    assert len({frame.center for frame in shared_frames([near[0], Box((0.0, 0.0), (1.0, 1.0))])}) == 2
