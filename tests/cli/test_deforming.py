"""`levelflow deform` as a user meets it."""

import json

import pytest
import torch

from levelflow import SIREN, Box, Budget, Circle, Placed, Sampling, fit, load, save
from levelflow.saving import describe

pytestmark = pytest.mark.filterwarnings("default")

HELD = {"name": "left", "region": {"box": {"lower": [-1, -1], "upper": [-0.2, 1]}}, "freeze": True}
RIGHT = {"name": "right", "region": {"box": {"lower": [0.2, -1], "upper": [1, 1]}}, "move": [0.1, 0.1]}
OPTIONS = ("--resolution", 24, "--steps", 30, "--blocks", 3)


@pytest.fixture(scope="module")
def disc(tmp_path_factory):
    """A file with a field of a disc of the radius 0.4, quickly fitted."""
    path = tmp_path_factory.mktemp("disc") / "disc.safetensors"
    network, sampling = SIREN(2, width=16, depth=2), Sampling(512, given=2000)
    save(fit(network, Circle(0.4), box=Box((-0.7, -0.7), (0.7, 0.7)), budget=Budget(150), sampling=sampling), path)
    return path


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def handles(folder, *asked):
    (folder / "handles.json").write_text(json.dumps({"handles": asked}))
    return "handles.json"


def test_a_disc_is_deformed_again_and_on_its_way(run, here, disc):
    asked = handles(here, HELD, RIGHT)
    code, out, err = run("deform", disc, "--handles", asked, *OPTIONS, "-o", "out")
    assert code == 0, err
    assert "handles met within" in out and "out: field.safetensors, 1 mesh, frames.png, report.json" in out
    assert describe("out/field.safetensors")["network"]["type"] == "Deformed"
    report = json.loads((here / "out" / "report.json").read_text())
    assert report["verb"] == "deform" and report["handles"]["mean"] < 0.05 and (here / "out" / "deformed.ply").exists()
    code, out, err = run(
        "deform", "out/field.safetensors", "--handles", asked, *OPTIONS, "--path", "--count", 2, "-o", "again"
    )
    assert code == 0, err
    assert "again: field.safetensors, 3 meshes" in out
    field = load("again/field.safetensors")
    assert isinstance(field, Placed) and field.times == 1
    right = torch.tensor([[0.6, 0.1]], dtype=torch.float64)
    assert field.at(1.0)(right) < field.at(0.0)(right)


def test_a_shape_is_fitted_first_and_an_interrupted_run_goes_on(run, here, monkeypatch):
    from levelflow.minimising import Progress

    held = {**HELD, "region": {"box": {"lower": [-1, -1, -1], "upper": [1, 1, -0.2]}}}
    top = {**RIGHT, "region": {"box": {"lower": [-1, -1, 0.2], "upper": [1, 1, 1]}}, "move": [0, 0, 0.1]}
    asked = handles(here, held, top)
    command = ("deform", "sphere", "--handles", asked, *OPTIONS, "--fit-steps", 60, "--width", 16, "--depth", 2)
    state, left = Progress.state, [5]

    def interrupted(self):
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        return state(self)

    monkeypatch.setattr("levelflow.cli.deforming.CHECKPOINT_SECONDS", 0.0)
    monkeypatch.setattr(Progress, "state", interrupted)
    assert run(*command)[0] != 0
    assert (here / "sphere-deform" / "rest.safetensors").exists()
    monkeypatch.setattr(Progress, "state", state)
    code, _, err = run(*command)
    assert code == 2 and "holds an interrupted run" in err
    code, out, err = run(*command, "--resume")
    assert code == 0, err
    assert "going on from step 5" in out and "volume" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--count", 0), "deform --count 0"),
        (("--blocks", 0), "--blocks 0: too few"),
        (("--stretch", -1), "Shell(stretch=-1"),
        (("-o", "handles.json"), "this is a file"),
        (("--resume",), "there is no interrupted run"),
    ],
)
def test_what_cannot_be_done_is_said(run, here, disc, arguments, message):
    code, _, err = run("deform", disc, "--handles", handles(here, HELD, RIGHT), *arguments)
    assert code == 2 and message in err


def test_bad_handles_are_told_before_anything_is_trained(run, here, disc):
    far = {"region": {"box": {"lower": [8, 8], "upper": [9, 9]}}, "freeze": True}
    code, _, err = run("deform", disc, "--handles", handles(here, far, RIGHT))
    assert code == 2 and "deform: the region of handle 1 holds no vertex of the surface" in err
