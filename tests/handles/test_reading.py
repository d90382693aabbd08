"""Handles from files: the documented example, and an answer to everything that may be wrong."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from levelflow.boxes import Box
from levelflow.handles import BoxRegion, Handle, PaintedRegion, PointsRegion, SphereRegion, handles_from, handles_in
from tests.handles.test_regions import ply

DOCUMENT = Path(__file__).resolve().parent.parent.parent / "docs" / "handles.md"
BALL = {"sphere": {"center": [0, 0, 1], "radius": 0.5}}
CURVE = {"sphere": {"center": [0, 1], "radius": 0.5}}


def written(folder: Path, content: object) -> Path:
    path = folder / "edit.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_the_documented_example(tmp_path: Path) -> None:
    example = re.search(r"```json\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)
    assert example
    feet, head, hands = handles_from(written(tmp_path, example[1]))
    assert feet == Handle.fix(BoxRegion(Box((-1, -1, -1), (1, -0.5, 1))), name="feet")
    assert head == Handle.rotate(
        SphereRegion((0, 0.8, 0), 0.25), angle=45, axis=(0, 1, 0), center=(0, 0.6, 0), name="head"
    )
    assert (hands.by, hands.scale, hands.name) == ((0, 0.3, 0), 1.2, "hands")
    assert isinstance(hands.region, PointsRegion)
    assert hands.region.points.tolist() == [[-0.9, 0, 0], [0.9, 0, 0]]


def test_paint_beside_the_file(tmp_path: Path) -> None:
    ply(tmp_path / "head.ply", "x y z red", [(0, 0, 0, 255), (1, 0, 0, 128), (2, 0, 0, 127)])
    paint = {"file": "head.ply", "property": "red", "above": 127, "reach": 0.4}
    (handle,) = handles_from(written(tmp_path, {"handles": [{"region": {"painted": paint}, "freeze": True}]}))
    assert isinstance(handle.region, PaintedRegion)
    assert handle.region.painted.tolist() == [True, True, False]
    assert (handle.region.reach, handle.name) == (0.4, "")


def test_handles_in_the_plane(tmp_path: Path) -> None:
    content = {"handles": [{"region": CURVE, "rotate": {"angle": 90}, "center": [0, 0]}]}
    (handle,) = handles_from(written(tmp_path, content))
    assert handle.target(np.array([[1.0, 0]]), 1.0) == pytest.approx(np.array([[0, 1]]))


def test_a_mark_at_the_start_of_the_file_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "edit.json"
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps({"handles": [{"region": BALL, "freeze": True}]}).encode())
    assert handles_from(path) == (Handle.fix(SphereRegion((0, 0, 1), 0.5)),)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is not valid JSON: Expecting value in line 1, column 1"),
        ('{"handles": [\n1,}', "is not valid JSON: .* in line 2, column 3"),
        ('{"handles": [], "handles": []}', "the key 'handles' is written twice in one object; leave one out"),
        ('{"handles": [NaN]}', "it holds NaN, which is no number .* write a finite number"),
        ([1], r"it is \[1.0\]; write an object with handles"),
        ({}, "it has no 'handles'; write it"),
        ({"handles": []}, r"`handles` is \[\]; write a list that is not empty"),
        ({"handles": {}}, r"`handles` is \{\}; write a list"),
        ({"handles": [{}], "scale": 1}, "it has the key 'scale', which is not known; known are handles"),
    ],
)
def test_files_that_hold_no_handles(tmp_path: Path, content: object, message: str) -> None:
    with pytest.raises(ValueError, match=f"^handles_from: 'edit.json'.* {message}"):
        handles_from(written(tmp_path, content))


@pytest.mark.parametrize(
    ("handle", "message"),
    [
        ("feet", 'it is "feet"; write an object with region'),
        ({"freeze": True}, "it has no 'region'"),
        ({"region": BALL}, 'it says nothing about what happens to the region; write `"freeze": true`'),
        ({"region": BALL, "mvoe": [0, 0, 1]}, "it has the key 'mvoe', which is not known; known are region, name"),
        ({"region": BALL, "freeze": True, "name": 3}, "`name` is 3.0; write a text"),
        ({"region": BALL, "freeze": False}, "`freeze` is false; write true, or leave it out"),
        ({"region": BALL, "freeze": True, "move": [0, 0, 1]}, "`freeze` and `move` contradict each other"),
        ({"region": BALL, "move": [0, 0, 1], "center": [0, 0, 0]}, "`center` is for `rotate` and `scale`"),
        ({"region": BALL, "move": 1}, "`move` is 1.0; write 3 numbers"),
        ({"region": BALL, "move": [0, 1]}, r"`Handle\(by=\(0.0, 1.0\)\)`: the region lies in R\^3"),
        ({"region": BALL, "move": [0, 0, "1"]}, r'`move\[2\]` is "1"; write a finite number'),
        ({"region": BALL, "move": [0, 0, True]}, r"`move\[2\]` is true; write a finite number"),
        ({"region": BALL, "move": [0, 0, 10**400]}, r"`move\[2\]` is Infinity; write a finite number"),
        ({"region": BALL, "rotate": 90}, "`rotate` is 90.0; write an object with angle, axis"),
        ({"region": BALL, "rotate": {"axis": [0, 0, 1]}}, "`rotate` has no 'angle'"),
        ({"region": BALL, "rotate": {"angle": 90}}, "in space an angle in degrees and an axis"),
        ({"region": BALL, "scale": 0}, "the scale must be a positive number"),
        ({"region": {}, "freeze": True}, "`region` has 0 keys; write exactly one of box, sphere, points, painted"),
        ({"region": {"ball": {}}, "freeze": True}, "`region` has the key 'ball', which is not known"),
        ({"region": {**BALL, "box": {}}, "freeze": True}, "`region` has 2 keys; write exactly one"),
        ({"region": {"box": {"lower": [0, 0, 0]}}, "freeze": True}, "`region.box` has no 'upper'"),
        ({"region": {"box": {"lower": [1, 1], "upper": [0, 2]}}, "freeze": True}, "Box: the lower corner"),
        (
            {"region": {"sphere": {"center": [0] * 20, "radius": 1}}, "freeze": True},
            r"center` is \[0.0.*\.\.\.; write 3",
        ),
        ({"region": {"points": {"near": [], "radius": 1}}, "freeze": True}, "`region.points.near` is .* not empty"),
        (
            {"region": {"points": {"near": [[0, 0], [0, 0, 0]], "radius": 1}}, "freeze": True},
            "`region.points.near` mixes points of the plane and of space",
        ),
        (
            {"region": {"painted": {"file": 1, "property": "red"}}, "freeze": True},
            "`region.painted.file` is 1.0; write",
        ),
        (
            {"region": {"painted": {"file": "../a.ply", "property": "red"}}, "freeze": True},
            '`region.painted.file` is "../a.ply"; name a file next to the JSON file',
        ),
        (
            {"region": {"painted": {"file": "/a.ply", "property": "red"}}, "freeze": True},
            '`region.painted.file` is "/a.ply"; name a file next to the JSON file',
        ),
    ],
)
def test_wrong_handles_are_named_with_what_to_write(tmp_path: Path, handle: object, message: str) -> None:
    good = {"region": BALL, "freeze": True, "name": "other"}
    with pytest.raises(ValueError, match=f"^handles_from: 'edit.json', handle 2: .*{message}"):
        handles_from(written(tmp_path, {"handles": [good, handle]}))


def test_a_text_is_read_like_a_file(tmp_path: Path) -> None:
    ply(tmp_path / "head.ply", "x y z red", [(0, 0, 0, 1), (1, 0, 0, 0)])
    paint = {"region": {"painted": {"file": "head.ply", "property": "red"}}, "freeze": True}
    first, second = handles_in(json.dumps({"handles": [{"region": BALL, "freeze": True}, paint]}), folder=tmp_path)
    assert first == Handle.fix(SphereRegion((0, 0, 1), 0.5)) and isinstance(second.region, PaintedRegion)
    with pytest.raises(ValueError, match="^handles_in: the text, handle 1: it has no 'region'"):
        handles_in('{"handles": [{"freeze": true}]}', folder=tmp_path)
    with pytest.raises(ValueError, match="^handles_in: the text is nested too deeply"):
        handles_in("[" * 100_000, folder=tmp_path)


def test_names_are_said_and_used_once(tmp_path: Path) -> None:
    handle = {"region": BALL, "freeze": True, "name": "head"}
    with pytest.raises(ValueError, match=r"handle 2 \('head'\): `name` is 'head', as for another handle"):
        handles_from(written(tmp_path, {"handles": [handle, handle]}))


def test_files_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="handles_from: there is no file .*looked in"):
        handles_from(tmp_path / "none.json")
    with pytest.raises(ValueError, match="is a folder; give the path of a JSON file in it"):
        handles_from(tmp_path)
    paint = {"painted": {"file": "none.ply", "property": "red"}}
    with pytest.raises(
        FileNotFoundError, match="'edit.json', handle 1: PaintedRegion.read: there is no file .*none.ply"
    ):
        handles_from(written(tmp_path, {"handles": [{"region": paint, "freeze": True}]}))
    path = tmp_path / "edit.json"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="'edit.json' is not text in UTF-8"):
        handles_from(path)
