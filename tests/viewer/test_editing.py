"""Handles on the page, from the side of Python: what is in their file, and the surface that they make."""

from __future__ import annotations

import json
import threading

import numpy as np
import pytest

from levelflow import Box, Sphere, extract
from levelflow.flows import Edit
from levelflow.handles import Handle, SphereRegion, handles_from
from levelflow.viewer.editing import STEPS, WAYS, Editing
from levelflow.viewer.frames import Superseded
from tests.handles.test_regions import ply

BOTTOM = {"name": "bottom", "region": {"sphere": {"center": [0, -0.5, 0], "radius": 0.3}}, "freeze": True}
TOP = {"region": {"sphere": {"center": [0, 0.5, 0], "radius": 0.3}}, "move": [0.1, 0.2, 0]}
TURNED = {"region": TOP["region"], "rotate": {"axis": [0, 1, 0], "angle": 40}}


def text(*handles):
    return json.dumps({"handles": handles})


@pytest.fixture(scope="module")
def ball():
    return extract(Sphere(0.5).distance, box=Box((-0.6,) * 3, (0.6,) * 3), resolution=20)


@pytest.fixture
def editing(ball, tmp_path):
    return Editing(ball, tmp_path / "handles.json", command="levelflow edit ball")


def test_what_is_saved_is_what_is_read(editing):
    assert editing.description()["handles"] == [] and not editing.file.exists()
    editing.save(text(BOTTOM, TOP))
    fixed, moved = handles_from(editing.file)
    assert fixed == Handle.fix(SphereRegion((0, -0.5, 0), 0.3), name="bottom") and moved.by == (0.1, 0.2, 0.0)
    described = editing.description()
    assert described["handles"] == [BOTTOM, TOP] and described["middles"] == [None, None]
    assert (described["file"], described["command"], described["ways"]) == (
        "handles.json",
        "levelflow edit ball",
        ["blended", "arap", "shell"],
    )
    # One handle a line, and no other file beside it.
    assert len(editing.file.read_text().splitlines()) == 6 and list(editing.file.parent.iterdir()) == [editing.file]


def test_what_is_no_handle_leaves_the_file_as_it_was(editing):
    editing.save(text(BOTTOM))
    before = editing.file.read_bytes()
    for wrong, message in (("", " is not valid JSON"), (text(), r": `handles` is \[\]; write a list")):
        with pytest.raises(ValueError, match=f"handles_in: the text{message}"):
            editing.save(wrong)
    assert editing.file.read_bytes() == before


@pytest.mark.parametrize("way", WAYS)
def test_the_surface_is_that_of_the_edit_and_says_where_it_was(editing, ball, way):
    surface = editing.deformed(text(BOTTOM, TURNED), way=way)
    handles = [
        Handle.fix(SphereRegion((0, -0.5, 0), 0.3)),
        Handle.rotate(SphereRegion((0, 0.5, 0), 0.3), angle=40, axis=(0, 1, 0)),
    ]
    after = Edit(ball, handles, densify=WAYS[way]).deformed(steps=STEPS)
    assert np.abs(surface.mesh.vertices - after.vertices).max() < 1e-12 and not surface.note
    before = np.stack([surface.quantities[axis] for axis in "xyz"], 1)
    assert (before == ball.vertices).all() and (surface.mesh.faces == ball.faces).all()
    held, upper = surface.quantities["held"], before[:, 1] > 0
    assert set(held[upper]) == {0, 2} and set(held[~upper]) == {0, 1}
    assert np.abs(surface.mesh.vertices[held == 1] - before[held == 1]).max() < 1e-12


def test_a_curve_in_the_plane(tmp_path):
    disc = extract(lambda x: x.norm(dim=1) - 0.5, box=Box((-0.6,) * 2, (0.6,) * 2), resolution=32)
    surface = Editing(disc, tmp_path / "h.json", command="").deformed(
        text({"region": {"box": {"lower": [-1, -1], "upper": [1, -0.2]}}, "freeze": True},
             {"region": {"sphere": {"center": [0, 0.5], "radius": 0.1}}, "move": [0, 0.3]}), steps=1
    )  # fmt: skip
    assert set(surface.quantities) == {"x", "y", "held"} and surface.mesh.vertices[:, 1].max() == pytest.approx(
        0.8, abs=0.01
    )


def test_odd_and_wrong_handles_are_answered(editing):
    assert "all handles are frozen, so nothing moves" in editing.deformed(text(BOTTOM), steps=1).note
    assert "all handles ask for the same motion" in editing.deformed(text(TOP), steps=1).note
    far = {"region": {"sphere": {"center": [3, 0, 0], "radius": 0.3}}, "freeze": True}
    with pytest.raises(
        ValueError, match="Edit: the region of handle 2 holds no vertex of the surface; the nearest one"
    ):
        editing.deformed(text(BOTTOM, far))
    large = {"region": {"sphere": {"center": [0, 0.5, 0], "radius": 0.98}}, "move": [0, 0.1, 0]}
    with pytest.raises(ValueError, match=r"Edit: handle 1 \('bottom'\) and handle 2 both hold \d+ vertices"):
        editing.deformed(text(BOTTOM, large))
    with pytest.raises(ValueError, match="there is no way 'wax'; known are blended, arap, shell"):
        editing.deformed(text(TOP), way="wax")


def test_an_edit_that_a_page_has_turned_from_is_given_up(editing, monkeypatch):
    begun, resumed = threading.Event(), threading.Event()
    displacement = Edit.displacement

    def slow(self, *arguments, **named):
        begun.set()
        resumed.wait(20)
        return displacement(self, *arguments, **named)

    monkeypatch.setattr(Edit, "displacement", slow)
    given_up = []

    def first():
        try:
            editing.deformed(text(BOTTOM, TOP), page="a")
        except Superseded as error:
            given_up.append(str(error))

    threads = [threading.Thread(target=first)]
    threads[0].start()
    begun.wait(20)
    threads.append(threading.Thread(target=lambda: editing.deformed(text(BOTTOM, TOP), steps=1, page="a")))
    threads[1].start()
    while editing._asked["a"] < 2:
        pass
    resumed.set()
    for thread in threads:
        thread.join()
    assert given_up == ["edit 1 is over"]


def test_painted_regions_are_known_by_their_middles(editing, ball):
    ply(editing.file.parent / "ball.ply", "x y z red", [(*v, 255 * (v[1] > 0.3)) for v in ball.vertices])
    paint = {"region": {"painted": {"file": "ball.ply", "property": "red"}}, "move": [0, 0.1, 0]}
    editing.save(text(BOTTOM, paint))
    _, (x, y, z) = editing.description()["middles"]
    assert abs(x) < 0.01 and abs(z) < 0.01 and 0.3 < y < 0.5
    held = editing.deformed(text(BOTTOM, paint), steps=1).quantities["held"]
    assert ((held == 2) == (ball.vertices[:, 1] > 0.3)).all()


def test_files_that_cannot_be_edited_are_refused(ball, tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no folder '.*none'; make it first"):
        Editing(ball, tmp_path / "none" / "h.json", command="")
    (tmp_path / "h.json").write_text("[]")
    with pytest.raises(ValueError, match=r"handles_from: 'h.json': it is \[\]; write an object with handles"):
        Editing(ball, tmp_path / "h.json", command="")
    flat = {"region": {"sphere": {"center": [0, 1], "radius": 0.5}}, "freeze": True}
    (tmp_path / "h.json").write_text(text(flat))
    with pytest.raises(ValueError, match=r"there is a region in R\^2, and the surface lies in R\^3; name another file"):
        Editing(ball, tmp_path / "h.json", command="")
