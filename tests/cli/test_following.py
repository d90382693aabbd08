"""`levelflow evolve` and `levelflow edit` as a user meets them."""

import json

import pytest
import torch

from levelflow import SIREN, Box, Budget, Sampling, Sphere, fit, load, save
from levelflow.cli.following import Following
from levelflow.saving import describe

pytestmark = pytest.mark.filterwarnings("default")

HELD = {"name": "bottom", "region": {"box": {"lower": [-1, -1, -1], "upper": [1, 1, -0.2]}}, "freeze": True}
TOP = {"name": "top", "region": {"box": {"lower": [-1, -1, 0.2], "upper": [1, 1, 1]}}, "move": [0, 0, 0.2]}


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    """A file with a field of a sphere of the radius 0.4, quickly fitted."""
    path = tmp_path_factory.mktemp("ball") / "ball.safetensors"
    box = Box((-0.7,) * 3, (0.7,) * 3)
    save(
        fit(
            SIREN(3, width=32, depth=2), Sphere(0.4), box=box, budget=Budget(200), sampling=Sampling(1024, given=10_000)
        ),
        path,
    )
    return path


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def handles(folder, *asked):
    (folder / "handles.json").write_text(json.dumps({"handles": asked}))
    return "handles.json"


OPTIONS = ("--resolution", 32)


def test_a_ball_follows_an_offset_and_goes_on_where_it_was(run, here, ball):
    more = ("--flow", "offset", "--rate", 0.5, "--dt", 0.1, *OPTIONS, "-o", "out")
    code, out, err = run("evolve", ball, "--count", 1, *more)
    assert code == 0, err
    assert "step 1 of 1: t = 0.1, followed within" in out and "2 meshes, frames.png, report.json" in out
    code, out, err = run("evolve", ball, "--count", 2, "--resume", *more)
    assert code == 0, err
    assert "going on from step 1 of 2" in out
    field = load("out/field.safetensors")
    assert field.box.times == ((0.0, 0.2),) and describe("out/field.safetensors")["network"]["type"] == "Keyframed"
    report = json.loads((here / "out" / "report.json").read_text())
    assert len(report["followed"]) == 2 and report["settings"]["flow"] == "offset"
    code, _, err = run("evolve", ball, "--count", 2, "--resume", *more, "--seed", 3)
    assert code == 2 and "was made with" in err


def test_a_handle_pulls_a_ball(run, here, ball):
    code, out, err = run("edit", ball, "--handles", handles(here, HELD, TOP), "--count", 2, *OPTIONS, "-o", "out")
    assert code == 0, err
    assert "step 2 of 2" in out and "handles met within" in out
    field = load("out/field.safetensors")
    top = field.at(1.0)(torch.tensor([[0.0, 0.0, 0.6], [0.0, 0.0, -0.4]], dtype=torch.float64))
    assert top.abs().max() < 0.03
    assert field.box.upper[2] > 0.6


def test_an_evolution_is_edited_at_a_time(run, here, ball):
    run("lift", ball, "-o", "moving.safetensors", "--times=0:1")
    options = ("--handles", handles(here, HELD, TOP), "--count", 1, *OPTIONS, "-o", "out")
    code, _, err = run("edit", "moving.safetensors", *options)
    assert code == 2 and "edit moving.safetensors: the field moves from t = 0 to 1; say when with --time 0.5" in err
    code, out, err = run("edit", "moving.safetensors", "--time", "0.5", *options)
    assert code == 0 and "handles met within" in out and "fitting" not in err, err
    code, _, err = run("edit", "sphere", "--time", "0.5", *options)
    assert code == 2 and "edit sphere --time 0.5: a shape stands still" in err


def test_handles_take_hold_of_few_large_triangles(run, here, monkeypatch):
    def begun(*_):
        raise ValueError("the handles are good")

    monkeypatch.setattr(Following, "begun", begun)
    # No vertex of the box lies in the middle of its top; of the surface that is edited many do.
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    sides = ["4 0 1 3 2", "4 4 6 7 5", "4 0 4 5 1", "4 2 3 7 6", "4 0 2 6 4", "4 1 5 7 3"]
    (here / "box.off").write_text("\n".join(["OFF", "8 6 0", *("{} {} {}".format(*c) for c in corners), *sides]))
    top = {"region": {"sphere": {"center": [0.5, 0.5, 1], "radius": 0.2}}, "move": [0, 0, 0.1]}
    _, _, err = run("edit", "box.off", "--handles", handles(here, top), *OPTIONS)
    assert "the handles are good" in err
    far = {"region": {"sphere": {"center": [5, 5, 5], "radius": 0.2}}, "move": [0, 0, 0.1]}
    code, _, err = run("edit", "box.off", "--handles", handles(here, far), *OPTIONS)
    assert code == 2 and "the region of handle 1 holds no vertex" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("evolve", "sphere", "--flow", "wind"), "--flow wind: known are curvature, taubin, offset, area"),
        (("evolve", "sphere", "--flow", "area+lose"), "each with +keep"),
        (("evolve", "sphere", "--dt", 0), "--dt 0"),
        (("evolve", "sphere", "--resume"), "there is no evolution in sphere-evolve"),
        (("evolve", "sphere", "-o", "FILE"), "this is a file"),
        (("edit", "sphere", "--handles", "none.json"), "none.json"),
        (("edit", "sphere", "--handles", "FILE", "--rigid", "wax"), "known are blended, arap, shell"),
    ],
)
def test_wrong_use_is_explained(run, here, arguments, message):
    (here / "FILE").write_text("a letter")
    code, _, err = run(*arguments)
    assert code != 0 and message in err


def test_a_field_that_moves_is_refused(run, here, ball):
    run("lift", ball, "-o", "moving.safetensors", "--times=0:1")
    code, _, err = run("evolve", "moving.safetensors")
    assert code == 2 and "the field moves" in err


def test_a_shape_is_smoothed_at_its_volume(run, here):
    code, _, err = run("smooth", "rounded-cuboid", "--keep-volume", "--steps", 3, "--times", "0,1", "--resolution", 16,
                       "--width", 8, "--depth", 1, "-o", "out")  # fmt: skip
    assert code == 0, err
    assert describe("out/field.safetensors")["provenance"]["equation"].startswith("VolumePreserving(MeanCurvature(")
