"""`levelflow family` and `levelflow morph --simplex` as a user meets them: circles whose place and radius are known."""

import json
import math

import numpy as np
import pytest
import torch
from PIL import Image

from levelflow import SIREN, Budget, Circle, Mesh, fit, load, save
from levelflow.boxes import Box
from levelflow.cli.families import intervals_in, motion_named

pytestmark = pytest.mark.filterwarnings("default")
SMALL = ("--width", 24, "--depth", 2, "--resolution", 48, "--quiet")


@pytest.fixture(scope="module")
def disc(tmp_path_factory):
    """A field of a disk of radius 1/2."""
    path = tmp_path_factory.mktemp("disc") / "disc.safetensors"
    save(fit(SIREN(2, width=24, depth=2), Circle(0.5), budget=Budget(150)), path)
    return path


@pytest.fixture
def here(disc, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "disc.safetensors").write_bytes(disc.read_bytes())
    angle = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    for name, radius in (("a", 0.4), ("b", 0.6), ("c", 0.8), ("d", 0.5)):
        curve = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        Mesh(curve, np.stack([np.arange(120), np.roll(np.arange(120), -1)], axis=1)).write(tmp_path / f"{name}.ply")
    return tmp_path


def radius(file):
    return math.sqrt(Mesh.read(file).volume / math.pi)


def test_velocities_carry_a_shape_through_all_parameters_without_training(run, here):
    code, out, err = run("family", "disc.safetensors", "--motion", "translation by=1,0", "--motion",
                         "translation by=0,0.5 + translation by=0,0.5", "--until", "1,-0.5:0.5", "-o", "out",
                         *SMALL[:-1])  # fmt: skip
    assert code == 0 and not err and "out: field.safetensors, 9 meshes, frames.png, report.json" in out, err
    field = load("out/field.safetensors")
    assert field.times == 2 and field.box.times == ((0.0, 1.0), (-0.5, 0.5)) and field.time == (0.0, 0.0)
    x = Circle(0.5).sample(50, generator=torch.Generator().manual_seed(0)).points
    for s, t in ((1.0, 0.5), (0.3, -0.5)):
        assert torch.allclose(field.at(s, t)(x + x.new_tensor([s, t])), field.at(0.0, 0.0)(x), atol=1e-6)
    names = {path.name for path in (here / "out").iterdir()}
    meshes = {f"t=+{s},{t}.ply" for s in ("0.000", "0.500", "1.000") for t in ("-0.500", "+0.000", "+0.500")}
    assert names == {"field.safetensors", "frames.png", "report.json"} | meshes
    assert np.allclose(Mesh.read("out/t=+1.000,-0.500.ply").box.center, [1.0, -0.5], atol=0.01)
    report = json.loads((here / "out" / "report.json").read_text())
    assert report["steps"] == 150 and report["seconds"]["training"] < 10 and report["accuracy"]["0,0"]["mean"] < 0.01
    # The first parameter runs to the right.
    assert [frame["time"] for frame in report["frames"]][:4] == [[0, -0.5], [0.5, -0.5], [1, -0.5], [0, 0]]
    with Image.open("out/frames.png") as picture:
        assert picture.width == 3 * 384
    assert run("render", "out/field.safetensors", "--time", "1,0", "-o", "x.png", "--size", 64)[0] == 0
    code, _, err = run("export", "out/field.safetensors", "--path", "0,0:1,0:1,0.5", "-o", "film", "--frames", 3,
                       "--resolution", 24)  # fmt: skip
    assert code == 0, err


def test_curvature_among_the_motions_is_trained(run, here):
    code, _, err = run("family", "a.ply", "--motion", "translation by=0.4,0", "--motion", "curvature rate=0.03",
                       "-o", "out", "--steps", 300, "--grid", "2,2", *SMALL)  # fmt: skip
    assert code == 0 and not err, err
    assert load("out/field.safetensors").provenance["equation"].startswith("Family(Transport(Constant(")
    for s in (0, 1):
        for t, r in ((0, 0.4), (1, math.sqrt(0.16 - 0.06))):
            file = f"out/t=+{s}.000,+{t}.000.ply"
            assert radius(file) == pytest.approx(r, rel=0.06)
            assert np.allclose(Mesh.read(file).box.center, [0.4 * s, 0.0], atol=0.03)
    code, _, err = run("render", "out/field.safetensors", "--time", "1,0.5", "-o", "x.png", "--size", 64)
    assert code == 0, err


def test_one_motion_is_a_row_three_are_corners_and_what_does_not_commute_is_said(run, here):
    common = ("disc.safetensors", *SMALL)
    code, _, err = run("family", *common, "--motion", "rotation", "-o", "one")
    assert code == 0 and not err and len(list((here / "one").glob("t=*.ply"))) == 5
    three = [("--motion", f"translation by=0,{b}") for b in (1, 2)] + [("--motion", "source rate=0.5")]
    code, _, err = run("family", *common, *(word for pair in three for word in pair), "-o", "three")
    assert code == 0 and "warning: Transported: not all motions of the family commute." in err and "Source" in err
    assert err.count("warning") == 1 and (here / "three" / "t=+1.000,+0.000,+1.000.ply").exists()
    assert len(list((here / "three").glob("t=*.ply"))) == 8
    pair = ("--motion", "translation by=1,0", "--motion", "translation by=0,1")
    code, _, err = run("family", *common, *pair, "--distil", "--steps", 3, "--grid", "2,2", "-o", "net")
    assert code == 0 and json.loads((here / "net" / "report.json").read_text())["settings"]["distil"] is True


def test_mixtures_of_circles_have_the_mean_of_their_radii(run, here):
    code, _, err = run(
        "morph", "a.ply", "b.ply", "c.ply", "--simplex", "--grid", 2, "-o", "out", "--steps", 300, *SMALL
    )
    assert code == 0 and not err, err
    for b, c in ((0, 0), (0.5, 0), (1, 0), (0, 0.5), (0.5, 0.5), (0, 1)):
        assert radius(f"out/t=+{b:.3f},+{c:.3f}.ply") == pytest.approx(0.4 + 0.2 * b + 0.4 * c, rel=0.05)
    with Image.open("out/frames.png") as picture:
        # A triangle, whose top is in the middle of the sheet.
        assert picture.width == 3 * 384 and np.ptp(np.array(picture)[100:300, :300].reshape(-1, 3), axis=0).max() == 0
    assert load("out/field.safetensors").provenance["shares"] == ["a", "b", "c"]
    code, _, err = run("film", "out/field.safetensors", "-o", "x.gif")
    assert code == 2 and "such as --path 0,0:1,0:0,1, or" in err
    assert "with --time 0.333,0.333." in run("mesh", "out/field.safetensors", "-o", "x.ply")[2]
    for option in (("--time", "0.8,0.8"), ("--path", "0,0:0.9,0.2")):
        code, _, err = run("film", "out/field.safetensors", *option, "--turntable", 9, "-o", "x.gif")
        assert code == 2 and "these are the shares of b, c, and their sum is 1." in err and "the share of a" in err


def test_four_shapes_are_mixed_over_a_tetrahedron(run, here):
    code, _, err = run("morph", *(f"{name}.ply" for name in "abcd"), "--simplex", "-o", "out", "--steps", 30, *SMALL)
    assert code == 0, err
    times = [frame["time"] for frame in json.loads((here / "out" / "report.json").read_text())["frames"]]
    assert len(times) == 11 and times[:2] == [[0, 0, 0], [1, 0, 0]] and times[-1] == [0.25] * 3


def test_motions_have_the_units_that_were_asked_for():
    """Half the box of a field is 0.625: half the side of the shape and a margin of an eighth of the side."""
    box = Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    for text, relative, found in (
        ("translation by=1,2,0", False, "Transport(Constant(velocity=(1.0, 2.0, 0.0)))"),
        ("translation by=1,2,0", True, "Transport(Constant(velocity=(0.625, 1.25, 0.0)))"),
        ("curvature rate=2", True, "MeanCurvature(rate=0.78125)"),
        ("curvature rate=2 + curvature", False, "MeanCurvature(rate=2.0) + MeanCurvature(rate=0.000390625)"),
        ("rotation rate=1 center=1,0,0 axis=0,0,1", True,
         "Transport(Rotation(rate=1.0, axis=(0.0, 0.0, 1.0), center=(1.125, 0.5, 0.5)))"),
        ("sink rate=2 reach=0.1", False, "Transport(Source(center=(0.5, 0.5, 0.5), strength=-2.0, width=0.1))"),
    ):  # fmt: skip
        assert repr(motion_named(text, box, relative=relative)) == found
    assert intervals_in("2,1:-1", 2) == [(0.0, 2.0), (-1.0, 1.0)] and intervals_in(None, 1) == [(0.0, 1.0)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("family", "a.ply"), "Missing option '--motion'"),
        (("family", "a.ply", "--motion", "wind by=1"), '--motion "wind by=1": known are curvature, translation'),
        (("family", "a.ply", "--motion", "curvature by=1,0"), "'by=1,0' is not understood; a curvature takes rate=..."),
        (("family", "a.ply", "--motion", "rotation rate=1 rate=2"), "'rate=2' is not understood"),
        (("family", "a.ply", "--motion", "rotation rate"), "takes rate=... axis=... center=..."),
        (("family", "a.ply", "--motion", "rotation rate=fast"), "rate=fast is no number"),
        (("family", "a.ply", "--motion", "rotation axis=up"), "--motion axis up: give numbers"),
        (
            ("family", "a.ply", "--motion", "rotation center=0,0,0"),
            "--motion center 0,0,0: the shape has 2 coordinates",
        ),
        (("family", "a.ply", "--motion", "translation by=1,0,0"), "--motion by 1,0,0: the shape has 2 coordinates"),
        (("family", "a.ply", "--motion", "curvature rate=-1"), "the rate must be positive"),
        (("family", "a.ply", "--motion", "twist"), "three space coordinates"),
        (("family", "a.ply", "--motion", "rotation", "--until", "1,1"), "there are 1 motion(s); give where"),
        (("family", "a.ply", "--motion", "rotation", "--until", "0"), "it goes, such as 1."),
        (("family", "a.ply", "--motion", "rotation", "--motion", "curvature", "--until", "soon,1"), "such as 1,-1:1"),
        (("family", "a.ply", "--motion", "rotation", "--until", "0:1:2"), "--until 0:1:2: there are 1 motion(s)"),
        (("family", "a.ply", "--motion", "rotation", "--grid", "1"), "the number of values for each, at least 2"),
        (("family", "a.ply", "--motion", "rotation", "--grid", "2,2"), "such as 3."),
        (("morph", "a.ply", "b.ply", "--simplex"), "two shapes have a line between them"),
        (("morph", "a.ply", "b.ply", "c.ply", "--simplex", "--grid", "0"), "the steps along a side of the triangle"),
        (("morph", "a.ply", "b.ply", "c.ply", "--simplex", "--times", "0,1"), "a mixture has shares and no time"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_wrong_use_is_answered_in_a_sentence(run, unchecked, here, arguments, message):
    code, out, err = run(*arguments, "-o", "out", *SMALL)
    assert code == 2 and message in err.replace("│", "").replace("\n", " "), err
    assert "Traceback" not in out + err and not (here / "out").exists()
