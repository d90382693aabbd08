"""Frames as they are asked for: kept while there is room, and computed so that what is looked at comes first."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from levelflow.boxes import Box, Frame
from levelflow.viewer.packing import pack
from levelflow.viewer.viewed import Viewed

ROOM = 512 << 20
"""The bytes of frames that are kept."""


class Rank(IntEnum):
    """How urgent a frame is: work waits while there is more urgent work."""

    NOW = 0
    SOON = 1
    AHEAD = 2


class Superseded(Exception):
    """The eye has moved on: nobody waits for this frame any more."""


class Glance(NamedTuple):
    """Where a page looks: pages number their glances, and what was wanted soon for an old one is given up."""

    page: str = ""
    number: int = 0


@dataclass(eq=False)
class _Job:
    """A frame that is being computed."""

    rank: Rank
    glance: Glance
    result: Future[bytes]


Key = tuple[int, tuple[float, ...], int]


class Frames:
    """The packed frames of what is viewed, computed in the thread that asks and kept for the next.

    Two threads that want the same frame compute it once. While a frame is computed NOW, work for others pauses.

    Args:
        viewed: What is viewed.
        room: The bytes that may be kept; the frames not used for longest go first.

    Attributes:
        frames: The similarity between the units of each and those of the page. It is the same for all where that shows
            them well, so that they are seen in their places.
    """

    def __init__(self, viewed: Sequence[Viewed], *, room: int = ROOM) -> None:
        self.viewed, self.room = tuple(viewed), room
        self.frames = shared_frames([one.box for one in viewed])
        self._kept: OrderedDict[Key, bytes] = OrderedDict()
        self._jobs: dict[Key, _Job] = {}
        self._latest: dict[str, int] = {}
        self._changed = threading.Condition()

    @property
    def size(self) -> int:
        """The bytes that are kept."""
        return sum(map(len, self._kept.values()))

    def get(
        self,
        i: int,
        time: Sequence[float],
        *,
        resolution: int,
        rank: Rank = Rank.NOW,
        glance: Glance = Glance(),  # noqa: B008
    ) -> bytes:
        """The packed surface of the i-th at a time.

        Raises:
            Superseded: If the page has turned to something else before a frame of rank SOON was there.
            ValueError: If there is no such time.
        """
        key = (i, tuple(time), resolution)
        with self._changed:
            self._latest[glance.page] = max(glance.number, self._latest.get(glance.page, 0))
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
            job = self._jobs.get(key)
            mine = job is None
            if job is None:
                job = self._jobs[key] = _Job(rank, glance, Future())
            else:
                job.rank, job.glance = min(rank, job.rank), glance
            self._changed.notify_all()
        if mine:
            self._compute(key, job)
        return job.result.result()

    def _compute(self, key: Key, job: _Job) -> None:
        i, time, resolution = key
        try:
            surface = self.viewed[i].surface(time, resolution=resolution, pause=lambda: self._wait_turn(job))
            data = pack(surface, self.frames[i])
        except BaseException as error:
            self._done(key)
            job.result.set_exception(error)
        else:
            self._done(key, data)
            job.result.set_result(data)

    def _done(self, key: Key, data: bytes | None = None) -> None:
        with self._changed:
            del self._jobs[key]
            if data is not None:
                self._kept[key] = data
                while len(self._kept) > 1 and self.size > self.room:
                    self._kept.popitem(last=False)
            self._changed.notify_all()

    def _wait_turn(self, job: _Job) -> None:
        with self._changed:
            while True:
                if job.rank is Rank.SOON and self._latest.get(job.glance.page, 0) > job.glance.number:
                    raise Superseded(f"glance {job.glance.number} is over")
                if all(other.rank >= job.rank for other in self._jobs.values()):
                    return
                self._changed.wait()


def shared_frames(boxes: Sequence[Box]) -> list[Frame]:
    """One similarity to the box [-1, 1]^d for all boxes that overlap and have like sizes; else each gets its own."""
    first = boxes[0]
    alike = all(
        box.space == first.space
        and 1 / 3 < max(box.size) / (max(first.size) or 1.0) < 3
        and all(a < d and c < b for a, b, c, d in zip(box.lower, box.upper, first.lower, first.upper, strict=True))
        for box in boxes
    )
    return [first.union(*boxes).frame] * len(boxes) if alike else [box.frame for box in boxes]
