"""The page: one HTML document with its style and scripts in it, and in a file of its own also the frames."""

from __future__ import annotations

import base64
import html
import json
import re
import zlib
from collections.abc import Callable, Sequence
from importlib import resources
from typing import Any

import numpy as np

from levelflow._version import __version__
from levelflow.boxes import Frame
from levelflow.extraction import EmptyLevelSet
from levelflow.viewer.editing import Editing
from levelflow.viewer.frames import shared_frames
from levelflow.viewer.packing import pack
from levelflow.viewer.viewed import Viewed

SCRIPTS = ("mathematics.js", "frames.js", "drawing.js", "panes.js", "handles.js", "editing.js", "page.js")
# Values of f on a grid, for the level sets on the clipping plane of a page that has nobody to ask.
_GRID = 40


def page(meta: dict[str, Any], *, frames: dict[str, Any] | None = None) -> str:
    """The document. With `frames` it is complete in itself; without, it asks the server that it came from.

    A policy in its head forbids the browser to load anything from elsewhere.
    """
    folder = resources.files("levelflow.viewer") / "assets"
    scripts = "\n".join((folder / name).read_text("utf-8") for name in SCRIPTS)
    parts = {
        "connect": "'none'" if frames is not None else "'self'",
        "title": html.escape(" · ".join(one["name"] for one in meta["viewed"])),
        "style": (folder / "page.css").read_text("utf-8"),
        "meta": _embedded(meta),
        "frames": _embedded(frames),
        "scripts": scripts,
    }
    return re.sub("@([a-z]+)@", lambda place: parts[place[1]], (folder / "page.html").read_text("utf-8"))


def description(
    viewed: Sequence[Viewed],
    times: Sequence[Sequence[float]],
    *,
    resolution: int,
    preview: int,
    editing: Editing | None = None,
) -> dict[str, Any]:
    """What the page has to know: what is shown, in which units, the values of each slider, and handles."""
    return {
        "version": __version__,
        "resolution": resolution,
        "preview": preview,
        "times": [list(values) for values in times],
        "viewed": [
            {
                "name": one.name,
                "space": one.box.space,
                "times": one.box.times,
                "shares": one.shares,
                "center": [*frame.center, 0.0][:3],
                "scale": frame.scale,
                "lower": _in_page(one.box.lower, frame),
                "upper": _in_page(one.box.upper, frame),
                "quantities": [quantity._asdict() for quantity in one.quantities],
            }
            for one, frame in zip(viewed, shared_frames([one.box for one in viewed]), strict=True)
        ],
        "editing": editing.description() if editing is not None else None,
    }


def sliders(viewed: Sequence[Viewed], *, steps: int = 48) -> list[list[float]]:
    """The values of a slider for each time or parameter, over the intervals of all that is viewed."""
    number = max(len(one.box.times) for one in viewed)
    intervals = [[one.box.times[j] for one in viewed if len(one.box.times) > j] for j in range(number)]
    return [
        [
            float(f"{value:.9g}") + 0.0
            for value in np.linspace(min(a for a, _ in interval), max(b for _, b in interval), steps + 1)
        ]
        for interval in intervals
    ]


def standalone(
    viewed: Sequence[Viewed],
    times: Sequence[float],
    *,
    resolution: int = 64,
    editing: Editing | None = None,
    on_frame: Callable[[Viewed, float | None], None] | None = None,
) -> str:
    """A document with the surfaces at some times in it, which needs no server and no network.

    Positions have 16 bits, normals and colours 8; frames are deflated.

    Args:
        viewed: What to show, of at most one time each.
        times: When; each is shown at those in its interval, and what stands still at all of them.
        resolution: Cells along the longest side of the box.
        editing: The handles of the first, which then can be placed and saved, but deform nothing.
        on_frame: Called for each frame that is in.

    Raises:
        EmptyLevelSet: If there is no surface at any of the times.
        ValueError: If something has several parameters, or none of the times is in its interval.
    """
    frames = shared_frames([one.box for one in viewed])
    times = list(times) if any(one.box.times for one in viewed) else []
    packed: list[dict[str, dict[str, str]]] = []
    found = False
    for one, frame in zip(viewed, frames, strict=True):
        if len(one.box.times) > 1:
            raise ValueError(
                f"standalone: {one.name} has {len(one.box.times)} parameters, and a page in a file has one slider; "
                "leave --html out to look at all of them, or show a Walk through them (--path)."
            )
        mine: dict[str, dict[str, str]] = {}
        for time in _times_of(one, times):
            surface = one.surface(time, resolution=resolution)
            found |= surface.mesh is not None
            mine[",".join(repr(t) for t in time)] = {
                "surface": _deflated(pack(surface, frame, compact=True)),
                "grid": _deflated(_grid(one, time, frame)),
            }
            if on_frame is not None:
                on_frame(one, time[0] if time else None)
        packed.append(mine)
    if not found:
        raise EmptyLevelSet(f"standalone: there is no surface at any of the times {times}; ask for others.")
    meta = description(viewed, [times] if times else [], resolution=resolution, preview=resolution, editing=editing)
    return page(meta, frames={"grid": _GRID, "packed": packed})


def _times_of(one: Viewed, times: Sequence[float]) -> list[tuple[float, ...]]:
    """Those of the times at which it can be shown."""
    if not one.box.times:
        return [()]
    first, last = one.box.times[0]
    slack = 1e-9 * max(abs(first), abs(last))
    inside: list[tuple[float, ...]] = [(t,) for t in times if first - slack <= t <= last + slack]
    if not inside:
        raise ValueError(
            f"standalone: {one.name} was solved for times from {first:g} to {last:g}, and none of {list(times)} is "
            "among them; ask for others."
        )
    return inside


def _grid(one: Viewed, time: Sequence[float], frame: Frame) -> bytes:
    """Values of f / scale at the points of a grid on [-1, 1]^3 (x fastest): their greatest, and 8 bits for each.

    The numbers are spaced like the square root, so that they are finest at the surface.
    """
    line = np.linspace(-1, 1, _GRID)
    z = line if one.box.space == 3 else np.zeros(1)
    points = np.stack(np.meshgrid(z, line, line, indexing="ij")[::-1], axis=-1).reshape(-1, 3)[:, : one.box.space]
    values = one.values(np.array(frame.center) + frame.scale * points, time) / frame.scale
    most = float(np.abs(values).max()) or 1.0
    numbers = np.round(127 * np.sign(values) * np.sqrt(np.abs(values) / most)).astype(np.int8)
    return np.float32(most).tobytes() + numbers.tobytes()


def _in_page(corner: Sequence[float], frame: Frame) -> list[float]:
    return [*((a - c) / frame.scale for a, c in zip(corner, frame.center, strict=True)), 0.0][:3]


def _deflated(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 9)).decode()


def _embedded(value: Any) -> str:
    """JSON that can stand in a script element: nothing in it can end the element."""
    return json.dumps(value, separators=(",", ":")).replace("<", "\\u003c")
