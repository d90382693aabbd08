"""Handles from a JSON file, with an answer to everything that may be wrong in it; `docs/handles.md` shows the form."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from levelflow.boxes import Box
from levelflow.handles.handle import Handle
from levelflow.handles.regions import BoxRegion, PaintedRegion, PointsRegion, Region, SphereRegion


def handles_from(path: str | Path) -> tuple[Handle, ...]:
    """The handles that a JSON file describes.

    The file is an object with one key, `handles`: a list of objects. Each has a `region` (one of `box`, `sphere`,
    `points`, `painted`), and either `"freeze": true` or at least one of `move`, `rotate` and `scale`; a `name` and,
    for turning and scaling, a `center` may be added. All lengths are in the units of the shape, angles in degrees.

    Raises:
        FileNotFoundError: If there is no such file, or a file of paint that it names.
        ValueError: If it holds anything else; the message names the file, the handle, the key, what was found and what
            is to be written instead.
    """
    path = Path(path)
    where = f"handles_from: {path.name!r}"
    if not path.exists():
        raise FileNotFoundError(f"handles_from: there is no file {str(path)!r} (looked in {Path.cwd()}).")
    if path.is_dir():
        raise ValueError(f"handles_from: {str(path)!r} is a folder; give the path of a JSON file in it.")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{where} is not text in UTF-8; a JSON file of handles is wanted.") from None
    return _read(text, path.parent, where)


def handles_in(text: str, *, folder: str | Path) -> tuple[Handle, ...]:
    """The handles that the text of such a file describes; files of paint are looked for in the folder.

    Raises:
        FileNotFoundError: If there is no file of paint that it names.
        ValueError: If it holds anything else, as for `handles_from`.
    """
    return _read(text, Path(folder), "handles_in: the text")


def _read(text: str, folder: Path, where: str) -> tuple[Handle, ...]:
    try:
        found = json.loads(text, object_pairs_hook=_without_doubles, parse_int=float, parse_constant=_not_finite)
        described = _list(_keys(found, required=("handles",))["handles"], "handles")
    except json.JSONDecodeError as error:
        raise ValueError(
            f"{where} is not valid JSON: {error.msg} in line {error.lineno}, column {error.colno}."
        ) from None
    except RecursionError:
        raise ValueError(f"{where} is nested too deeply; handles are at most five levels deep.") from None
    except _Wrong as wrong:
        raise ValueError(f"{where}: {wrong}") from None
    handles: list[Handle] = []
    for number, item in enumerate(described, 1):
        name = item.get("name") if isinstance(item, dict) else None
        title = f"handle {number}" + (f" ({name!r})" if isinstance(name, str) else "")
        try:
            handle = _handle(item, folder)
            if handle.name and handle.name in [other.name for other in handles]:
                raise _Wrong(f"`name` is {handle.name!r}, as for another handle. Give each a name of its own.")
        except (_Wrong, ValueError, FileNotFoundError) as error:
            kind = FileNotFoundError if isinstance(error, FileNotFoundError) else ValueError
            raise kind(f"{where}, {title}: {error}") from None
        handles.append(handle)
    return tuple(handles)


class _Wrong(Exception):
    """Something in the file is not as it must be; the message says what and what to write."""


def _handle(item: object, folder: Path) -> Handle:
    item = _keys(item, required=("region",), optional=("name", "freeze", "move", "rotate", "scale", "center"))
    name = item.get("name", "")
    if not isinstance(name, str):
        raise _Wrong(f"`name` is {_shown(name)}; write a text.")
    motions = [key for key in ("move", "rotate", "scale") if key in item]
    if "freeze" in item:
        if item["freeze"] is not True:
            raise _Wrong(f"`freeze` is {_shown(item['freeze'])}; write true, or leave it out.")
        if motions:
            raise _Wrong(f"`freeze` and `{motions[0]}` contradict each other; leave one out.")
    elif not motions:
        raise _Wrong('it says nothing about what happens to the region; write `"freeze": true`, `move` or `rotate`.')
    if "center" in item and motions in ([], ["move"]):
        raise _Wrong("`center` is for `rotate` and `scale`; leave it out.")
    turn = _keys(item["rotate"], required=("angle",), optional=("axis",), key="rotate") if "rotate" in item else {}
    return Handle(
        _region(item["region"], folder),
        by=_vector(item["move"], "move") if "move" in item else (),
        angle=_number(turn["angle"], "rotate.angle") if turn else 0.0,
        axis=_vector(turn["axis"], "rotate.axis") if "axis" in turn else (),
        scale=_number(item["scale"], "scale") if "scale" in item else 1.0,
        center=_vector(item["center"], "center") if "center" in item else (),
        name=name,
    )


def _region(value: object, folder: Path) -> Region:
    region = _keys(value, optional=tuple(_REGIONS), key="region")
    if len(region) != 1:
        raise _Wrong(f"`region` has {len(region)} keys; write exactly one of {', '.join(_REGIONS)}.")
    ((kind, described),) = region.items()
    return _REGIONS[kind](described, folder)


def _box(value: object, folder: Path) -> Region:
    box = _keys(value, required=("lower", "upper"), key="region.box")
    return BoxRegion(Box(_vector(box["lower"], "region.box.lower"), _vector(box["upper"], "region.box.upper")))


def _sphere(value: object, folder: Path) -> Region:
    sphere = _keys(value, required=("center", "radius"), key="region.sphere")
    return SphereRegion(
        _vector(sphere["center"], "region.sphere.center"), _number(sphere["radius"], "region.sphere.radius")
    )


def _points(value: object, folder: Path) -> Region:
    points = _keys(value, required=("near", "radius"), key="region.points")
    rows = [
        _vector(row, f"region.points.near[{i}]") for i, row in enumerate(_list(points["near"], "region.points.near"))
    ]
    if len({len(row) for row in rows}) > 1:
        raise _Wrong("`region.points.near` mixes points of the plane and of space.")
    return PointsRegion(np.array(rows), _number(points["radius"], "region.points.radius"))


def _painted(value: object, folder: Path) -> Region:
    paint = _keys(value, required=("file", "property"), optional=("above", "reach"), key="region.painted")
    for key in ("file", "property"):
        if not isinstance(paint[key], str):
            raise _Wrong(f"`region.painted.{key}` is {_shown(paint[key])}; write a text.")
    if Path(paint["file"]).is_absolute() or ".." in Path(paint["file"]).parts:
        raise _Wrong(f"`region.painted.file` is {_shown(paint['file'])}; name a file next to the JSON file.")
    return PaintedRegion.read(
        folder / paint["file"],
        paint["property"],
        above=_number(paint["above"], "region.painted.above") if "above" in paint else 0.5,
        reach=_number(paint["reach"], "region.painted.reach") if "reach" in paint else None,
    )


_REGIONS: dict[str, Callable[[object, Path], Region]] = {
    "box": _box,
    "sphere": _sphere,
    "points": _points,
    "painted": _painted,
}


def _keys(
    value: object, *, required: tuple[str, ...] = (), optional: tuple[str, ...] = (), key: str = ""
) -> Mapping[str, Any]:
    """An object with all the required keys and no unknown ones."""
    known = (*required, *optional)
    what = f"`{key}`" if key else "it"
    if not isinstance(value, dict):
        raise _Wrong(f"{what} is {_shown(value)}; write an object with {', '.join(known)}.")
    if unknown := [name for name in value if name not in known]:
        raise _Wrong(f"{what} has the key {unknown[0]!r}, which is not known; known are {', '.join(known)}.")
    if missing := [name for name in required if name not in value]:
        raise _Wrong(f"{what} has no {missing[0]!r}; write it.")
    return value


def _list(value: object, key: str) -> list:
    if not isinstance(value, list) or not value:
        raise _Wrong(f"`{key}` is {_shown(value)}; write a list that is not empty.")
    return value


def _vector(value: object, key: str) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) not in (2, 3):
        raise _Wrong(f"`{key}` is {_shown(value)}; write 3 numbers, such as [0, 0.1, 0], or 2 in the plane.")
    return tuple(_number(part, f"{key}[{i}]") for i, part in enumerate(value))


def _number(value: object, key: str) -> float:
    # 1e999 is read as infinity.
    if not isinstance(value, float) or not math.isfinite(value):
        raise _Wrong(f"`{key}` is {_shown(value)}; write a finite number.")
    return value


def _shown(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:37] + "..."


def _without_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(doubles := [key for i, (key, _) in enumerate(pairs) if key in dict(pairs[:i])]):
        raise _Wrong(f"the key {doubles[0]!r} is written twice in one object; leave one out.")
    return dict(pairs)


def _not_finite(word: str) -> NoReturn:
    raise _Wrong(f"it holds {word}, which is no number that something can be moved by; write a finite number.")
