"""`levelflow retime` and loops as a user meets them: files that are read back, filmed and exported."""

import re

import numpy as np
import pytest
import torch
import trimesh

from levelflow import SIREN, Circle, Placed, Retimed, Transported, equations, load, save
from levelflow.saving import describe
from tests.fields import periodic, placed, points

pytestmark = pytest.mark.filterwarnings("default")


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a field of space, one of space-time, a loop, one with two parameters, and one that is carried."""
    monkeypatch.chdir(tmp_path)
    moving, loop = placed(3, 1), Placed(periodic(3, 1, loop=True), placed(3, 1).box)
    middle = torch.tensor([moving.box.center], dtype=torch.float64)
    for network, field in ((moving.field, moving), (loop.field.network, loop)):
        network.last.bias.data -= field.at(3.5)(middle).detach() / field.box.frame.scale
    for name, field in (("still", placed(3)), ("moving", moving), ("family", placed(2, 2)), ("loop", loop)):
        field.provenance = {"verb": "solve", "equation": "MeanCurvature(rate=0.1)"}
        save(field, f"{name}.safetensors")
    disc = Placed(SIREN(2, width=4, depth=1), Circle(0.5).box.expanded(1.0))
    carried = Transported(equations.Transport(equations.Constant((1.0, 0.0))), disc, box=disc.box.during((0.0, 1.0)))
    save(carried, "carried.safetensors")
    (tmp_path / "FILE").write_text("a letter")
    return tmp_path


def test_help_shows_how_keys_are_written(run):
    assert "0:0,1:0.5,2:0.5,3:1" in run("retime", "--help")[1].replace("\n", "")
    assert "retime" in run("--help")[1] and "--loop" in run("morph", "--help")[1]


def test_a_field_is_shown_to_another_clock(run, here):
    code, out, _ = run("retime", "moving.safetensors", "-o", "new/eased.safetensors", "--keys", "0:2,1:3.5,2:3.5,3:5")
    assert code == 0 and out == "new/eased.safetensors: 4 keys, t from 0 to 3\n"
    moving, eased = load("moving.safetensors"), load("new/eased.safetensors")
    assert isinstance(eased, Retimed) and eased.ease == 1 and eased.box == moving.box.during((0.0, 3.0))
    x, _ = points(moving)
    for t, moment in ((0.0, 2.0), (0.5, 2.75), (1.5, 3.5), (3.0, 5.0)):
        assert torch.equal(eased.at(t)(x), moving.at(moment)(x))
    assert eased.provenance == {"verb": "retime", "input": "moving.safetensors"}
    assert eased.field.provenance == moving.provenance
    (clock,) = describe("new/eased.safetensors")["retimed"]
    assert clock == {"keys": [[0, 2], [1, 3.5], [2, 3.5], [3, 5]], "ease": 1.0, "field": moving.provenance}


def test_there_and_back_is_a_loop_whose_film_does_not_repeat_its_first_frame(run, here):
    assert run("retime", "moving.safetensors", "-o", "back.safetensors", "--keys", "0:2,1:5,2:2", "--ease=0")[1] == (
        "back.safetensors: 3 keys, t from 0 to 2; the last is the first again\n"
    )
    common = ("--frames", 4, "--size", 32, "--resolution", 12)
    from PIL import Image

    pictures = {}
    for name in ("back", "loop"):
        code, out, err = run("film", f"{name}.safetensors", "-o", f"{name}.gif", *common)
        assert code == 0 and "4 frames" in out, err
        with Image.open(f"{name}.gif") as film:
            pictures[name] = [np.asarray(film.seek(i) or film.convert("RGB")).astype(int) for i in range(4)]
    # At an even speed to t = 5 and back, the second quarter of the way is the fourth.
    assert np.abs(pictures["back"][1] - pictures["back"][3]).mean() < 4
    assert (
        np.abs(pictures["back"][1] - pictures["back"][2]).mean()
        > np.abs(pictures["back"][1] - pictures["back"][3]).mean()
    )


def test_what_is_retimed_is_drawn_exported_and_retimed_again(run, here):
    assert run("retime", "moving.safetensors", "-o", "a.safetensors", "--keys", "0:2,1:5")[0] == 0
    assert run("retime", "a.safetensors", "-o", "b.safetensors", "--keys", "0:0,5:1", "--ease", 0)[0] == 0
    assert run("retime", "carried.safetensors", "-o", "c.safetensors", "--keys", "0:1,2:0")[0] == 0
    assert load("b.safetensors").field.moment(0.5) == 3.5 and load("c.safetensors").at(2.0).box.space == 2
    small = ("--size", 64, "--resolution", 16)
    for colour in ("curvature", "residual"):
        common = ("--colour", colour, *small)
        assert run("render", "b.safetensors", "--time", 2.5, "-o", "x.png", "--by", "mesh", *common)[0] == 0
        code, _, err = run("film", "b.safetensors", "-o", "x.gif", "--frames", 2, *common)
        assert code == 0, err
    code, out, err = run("export", "b.safetensors", "--times", "0,2.5,5", "-o", "film.glb", "--resolution", 12)
    assert code == 0 and "film.glb: 3 frames" in out, err
    moving = ("export", "moving.safetensors", "--times", "3.5", "-o", "half.ply", "--resolution", 12)
    assert run(*moving)[0] == 0
    half, same = trimesh.load_scene("film.glb").geometry["t = 2.5"], trimesh.load("half.ply")
    assert np.array_equal(half.faces, same.faces) and np.allclose(half.extents, same.extents, atol=1e-6)
    for rest in (("-o", "x.npz"), ("-o", "folder")):
        assert run("export", "a.safetensors", "--times", "0,1", "--resolution", 8, *rest)[0] == 0
    assert run("view", "a.safetensors", "--html", "a.html", "--times", "0,1", "--resolution", 8)[0] == 0
    assert run("mesh", "a.safetensors", "--time", 0.5, "-o", "a.ply", "--resolution", 8)[0] == 0


@pytest.mark.parametrize(
    ("field", "keys", "message"),
    [
        ("still", "0:0,1:1", r"retime still.safetensors: the field does not depend on time"),
        ("family", "0:0,1:1", r"has 2 times or parameters; .*levelflow slice family.safetensors --time :,0.5 -o"),
        ("moving", "0:2", r"--keys 0:2: give two times or more, each as new:old: 0:0,1:0.5"),
        ("moving", "soon", r"--keys soon: give two times or more"),
        ("moving", "0:2,1:3:4", r"--keys 0:2,1:3:4: give two times or more"),
        ("moving", "0:2,1:inf", r"--keys 0:2,1:inf: give two times or more"),
        ("moving", "0:2,1:3,1:4", r"--keys 0:2,1:3,1:4: a new time is there twice"),
        ("moving", "0:2,1:9", r"of the old times, at\(9\): the field was solved for times from 2 to 5"),
        ("none", "0:0,1:1", "there is no file"),
        ("FILE", "0:0,1:1", "is not a field"),
    ],
)
def test_wrong_use_is_answered_in_a_sentence(run, unchecked, here, field, keys, message):
    before = sorted(here.iterdir())
    name = field if field == "FILE" else f"{field}.safetensors"
    code, out, err = run("retime", name, "-o", "new/out.safetensors", "--keys", keys)
    assert code == 2 and re.search(message, err.replace("\n", " ")), err
    assert "Traceback" not in out + err and sorted(here.iterdir()) == before


def test_other_mistakes_are_answered_as_well(run, here):
    keys = ("--keys", "0:2,1:5")
    code, _, err = run("retime", "moving.safetensors", "-o", "out.ply", *keys)
    assert code == 2 and "retime -o out.ply: a field is a .safetensors file; name it out.safetensors" in err
    code, _, err = run("retime", "moving.safetensors", "-o", "out.safetensors", *keys, "--ease", 2)
    assert code == 2 and "Retimed(ease=2): give a number from 0" in err
    assert run("retime", "moving.safetensors", "-o", "out.safetensors")[0] == 2
    assert run("retime", "moving.safetensors", "-o", "eased.safetensors", *keys)[0] == 0
    code, _, err = run("lift", "eased.safetensors", "-o", "x.safetensors", "--width", 20)
    assert code == 2 and "this field is retimed; give the one that it was made from" in err


def test_a_morph_that_loops_ends_where_it_began(run, here):
    small = ("--width", 8, "--depth", 1, "--resolution", 12, "--quiet", "--steps")
    code, _, err = run("morph", "sphere", "torus", "--loop", "-o", "out", *small, 40)
    assert code == 0, err
    field = load("out/field.safetensors")
    assert field.loops and field.box.times == ((0.0, 1.0),) and set(field.provenance["accuracy"]) == {"0", "0.5"}
    assert field.provenance["equation"] == "Morph(towards 2 target(s) at t = 0.5, 1)"
    assert len(list((here / "out").glob("t=*.ply"))) == 9
    x = field.box.uniform(50, generator=torch.Generator().manual_seed(0))
    assert torch.allclose(field.at(0.0)(x), field.at(1.0)(x), rtol=0, atol=1e-5)
    code, _, err = run("morph", "sphere", "torus", "cuboid", "--loop", "--times", "0,0.5", "-o", "three", *small, 2)
    assert code == 0 and load("three/field.safetensors").box.times == ((0.0, 1.0),), err
