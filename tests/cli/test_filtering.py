"""`levelflow filter` as a user meets it."""

import json
import math

import pytest
import torch

from levelflow import Mesh, load
from levelflow.saving import describe

pytestmark = pytest.mark.filterwarnings("default")
SMALL = ("--width", "16", "--depth", "2", "--resolution", "24")


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_shape_is_fitted_and_filtered(run, here):
    code, out, err = run("filter", "torus", "--factor", 0.5, "--fit-steps", 60, "--steps", 5, "-o", "out", *SMALL)
    assert code == 0, err
    assert "the surface has moved by" in out
    names = sorted(path.name for path in (here / "out").iterdir())
    assert names == [
        "after.ply", "before.ply", "before.safetensors", "field.safetensors", "filter.png", "report.json"
    ]  # fmt: skip
    report = json.loads((here / "out" / "report.json").read_text())
    assert report["steps"] == 5 and report["settings"]["factor"] == 0.5
    assert report["threshold"] * report["wavelength"] == pytest.approx(2 * math.pi)
    volume = report["surfaces"]["after"]["volume"]
    assert Mesh.read(here / "out" / "after.ply").volume == pytest.approx(volume, rel=1e-3)
    provenance = describe("out/field.safetensors")["provenance"]
    assert provenance["verb"] == "filter" and provenance["inputs"] == ["torus"]


def test_a_field_is_filtered_as_it_is_with_lengths_by_its_size(run, here):
    run("fit", "sphere", "-o", "ball.safetensors", "--steps", 60, "--quiet", *SMALL[:4])
    code, out, err = run("filter", "ball.safetensors", "--relative", "--wavelength", 0.2, "--factor", 2, "--steps", 2,
                         "--threshold", 8, *SMALL)  # fmt: skip
    assert code == 0, err
    assert not (here / "ball-filter" / "before.safetensors").exists() and "filter.png" in out
    provenance = describe("ball-filter/field.safetensors")["provenance"]
    assert provenance["wavelength"] == pytest.approx(0.125, rel=0.3)
    assert provenance["threshold"] * provenance["wavelength"] == pytest.approx(1.6)
    assert torch.isfinite(load("ball-filter/field.safetensors")(torch.zeros(1, 3))).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("filter", "sphere", "-o", "FILE"), "this is a file"),
        (("filter", "sphere", "--resume"), "there is no interrupted run in sphere-filter"),
        (
            ("filter", "sphere", "--factor=-1"),
            "filter --factor -1 --wavelength None --threshold None: the",
        ),
        (("filter", "sphere", "--wavelength", 0), "least 0, and the others positive"),
    ],
)
def test_wrong_use_is_explained(run, here, arguments, message):
    (here / "FILE").write_text("a letter")
    code, _, err = run(*arguments)
    assert code == 2 and message in err
