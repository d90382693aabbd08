"""Regions of their own rate as a user meets them: a curve in the plane, a part of which stands still."""

import json

import numpy as np
import pytest
import torch

from levelflow import Mesh, load
from levelflow.cli.masking import mask_of, region_named

pytestmark = pytest.mark.filterwarnings("default")
QUICK = ("--times", "0,1", "--resolution", 48, "--width", 32, "--depth", 2, "--quiet")


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An ellipse, and the same painted black on its left, painted elsewhere, in other colours, and in space."""
    monkeypatch.chdir(tmp_path)
    angle = np.linspace(0, 2 * np.pi, 240, endpoint=False)
    curve = np.stack([np.cos(angle), 0.5 * np.sin(angle)], axis=1)
    Mesh(curve, np.stack([np.arange(240), np.roll(np.arange(240), -1)], axis=1)).write(tmp_path / "curve.ply")
    grey = np.where(curve[:, 0] < -0.2, 0, 255)
    paint("half.ply", curve, grey)
    paint("white.ply", curve, np.full(240, 255))
    paint("black.ply", curve, np.zeros(240, int))
    paint("there.ply", curve + 5.0, grey)
    paint("large.ply", 100 * curve, grey)
    paint("space.ply", np.c_[curve, np.zeros(240)], grey)
    paint("nan.ply", np.r_[curve[:-1], [[np.nan, 0.0]]], grey)
    paint("weights.ply", curve, np.linspace(0, 1, 240), "weight")
    paint("wild.ply", curve, np.linspace(0, 7, 240), "weight")
    return tmp_path


def paint(name, points, values, by=None):
    axes = "xyz"[: points.shape[1]]
    lines = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    lines += [f"property double {axis}" for axis in axes]
    lines += [f"property float {by}"] if by else [f"property uchar {c}" for c in ("red", "green", "blue")]
    rows = [" ".join(map(str, [*p, *[v] * (1 if by else 3)])) for p, v in zip(points, values, strict=True)]
    with open(name, "w") as file:
        file.write("\n".join([*lines, "end_header", *rows]) + "\n")


def moved(folder, left):
    """How far the curve has moved to the left of a line, and to the right of another."""
    first, last = (Mesh.read(f"{folder}/t=+{t}.000.ply") for t in (0, 1))
    distance, x = first.closest(last.vertices).distance, last.vertices[:, 0]
    return distance[x < left].max(), distance[x > left + 0.4].max()


@pytest.mark.parametrize(
    "where",
    [
        ("--fix", "sphere -1,0,0.7", "--fix", "box -inf,-1,-0.2,1"),
        ("--only", "box -0.1,-2,2,2", "--soft", "0.1"),
        ("--mask", "half.ply"),
    ],
    ids=lambda value: " ".join(value[:2]),
)
def test_what_is_fixed_stands_still_and_the_rest_is_smoothed(run, here, where):
    code, _, err = run("smooth", "curve.ply", "--rate", "0.1", *where, "-o", "out", "--steps", 160, *QUICK)
    assert code == 0 and not err, err
    still, smoothed = moved("out", -0.25)
    assert still < 0.03 and smoothed > 0.1
    report = json.loads((here / "out" / "report.json").read_text())
    assert report["settings"]["equation"].startswith("Regional(MeanCurvature(rate=0.")
    assert load("out/field.safetensors").provenance["inputs"] == ["curve.ply", *[w for w in where if "half" in w]]


def test_a_masked_velocity_carries_the_shape_without_a_network_of_time(run, here):
    """The right half is pushed by 0.3, and the left stays where it is to the last digit."""
    code, _, err = run("advect", "curve.ply", "--velocity", "translation", "--by", "0.3,0", "--fix", "box -2,-2,-0.2,2",
                       "--mask", "white.ply", "--soft", "0.5", "-o", "out", "--steps", 150, *QUICK)  # fmt: skip
    assert code == 0 and not err, err
    field = load("out/field.safetensors")
    x = torch.tensor(Mesh.read("curve.ply").vertices)
    left, right = x[x[:, 0] < -0.2], x[x[:, 0] > 0.4]
    assert torch.equal(field.at(1.0)(left), field.at(0.0)(left)) and "PaintedMask('white.ply')" in repr(field.motion)
    assert torch.allclose(field.at(1.0)(right + right.new_tensor([0.3, 0.0])), field.at(0.0)(right), atol=1e-4)
    code, _, err = run("render", "out/field.safetensors", "--time", "1", "-o", "x.png", "--size", 64)
    assert code == 0, err


def test_properties_of_vertices_are_masks_and_what_fixes_nothing_is_said(here):
    curve = Mesh.read("curve.ply")
    middles = torch.tensor(curve.vertices[20:220])
    values = mask_of(curve, here / "weights.ply", "weight", None, None, 0.05, relative=False)(middles)
    assert np.allclose(values, np.arange(20, 220) / 239, atol=0.03)
    for mask, fix, message in (
        (None, ["sphere 9,9,1"], r'--fix "sphere 9,9,1": all of the surface from \(-1, -0.5.*\) moves at full speed'),
        (here / "white.ply", None, "--mask .*white.ply: all of the surface .* moves at full speed"),
    ):
        with pytest.warns(UserWarning, match=message):
            mask_of(curve, mask, None, fix, None, None, relative=False)
    assert mask_of(curve, None, None, None, None, None, relative=True) is None
    half = mask_of(curve, None, None, ["sphere 1,0,0.25"], None, 0.125, relative=True)
    assert half.center == pytest.approx((1.25, 0.0)) and (half.radius, half.soft) == pytest.approx((0.3125, 0.15625))


def test_regions_have_the_place_and_size_that_the_shape_gives_them():
    mask = region_named("--fix", "sphere 1,0,0,0.5", soft=0.1, origin=(10.0, 20.0, 30.0), length=2.0)
    assert repr(mask) == "SphereMask(center=(12.0, 20.0, 30.0), radius=1.0, soft=0.1, inside=0.0, outside=1.0)"
    mask = region_named("--only", "box 0,-inf,1,2", soft=0.1, origin=(0.0, 0.0), length=1.0)
    assert repr(mask) == "BoxMask(lower=(0.0, -inf), upper=(1.0, 2.0), soft=0.1, inside=1.0, outside=0.0)"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--fix", "blob 1,2"), '--fix "blob 1,2": known are "box x0,y0,x1,y1" and "sphere x,y,r"'),
        (("--fix", "sphere 1,2,3,4"), 'the shape has 2 coordinates; give "sphere x,y,r"'),
        (("--only", "box a,b"), "--only box a,b: give numbers with commas"),
        (("--only", "box"), "--only box : give numbers with commas"),
        (("--fix", "box 1,1,0,2"), "the lower corner is not below the upper one"),
        (("--fix", "sphere 0,0,-1"), "a positive radius"),
        (("--fix", "sphere 0,0,1", "--soft", "0"), "--soft 0: give the width of the edge, a positive length"),
        (("--soft", "1"), "there is no edge to be soft; name a region"),
        (("--mask-by", "weight"), "name the painted mesh as well, with --mask"),
        (("--only", "sphere 0,0,1", "--only", "sphere 1,0,1"), "--only is given 2 times; give one region"),
        (("--only", "sphere 9,9,1"), "nothing of the surface from (-1, -0.5"),
        (("--mask", "black.ply"), "--mask black.ply: nothing of the surface"),
        (("--mask", "none.ply"), "there is no file"),
        (("--mask", "curve.ply"), "the vertices of 'curve.ply' have no colours"),
        (("--mask", "weights.ply"), "no colours, only weight; one of these is the mask by='weight' (--mask-by weight)"),
        (("--mask", "half.ply", "--mask-by", "weight"), "no such property, only red, green, blue"),
        (("--mask", "wild.ply", "--mask-by", "weight"), "the values go from 0 to 7"),
        (("--mask", "nan.ply"), "1 of 240 vertices have a position or value that is not finite"),
        (("--mask", "there.ply"), "it is the paint of something else, from (4, 4.5) to (6, 5.5); half of the shape"),
        (("--mask", "large.ply"), "Paint the shape itself, in its own place and units"),
        (("--mask", "space.ply"), "its vertices have 3 coordinates, the shape has 2"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_wrong_use_is_answered_in_a_sentence(run, unchecked, here, arguments, message):
    for call in ("smooth", "advect"):
        code, out, err = run(call, "curve.ply", *arguments, "-o", "out", *QUICK)
        assert code == 2 and message in err, err
        assert "Traceback" not in out + err and not (here / "out").exists()
