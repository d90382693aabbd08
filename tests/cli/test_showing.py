"""The commands that show surfaces, as a user meets them."""

import sys

import numpy as np
import pytest

from levelflow import SIREN, Box, Placed, equations, save
from levelflow.networks.lifting import lift

pytestmark = pytest.mark.filterwarnings("default")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a moving field, a still one, one without a surface, and a cloud of points."""
    monkeypatch.chdir(tmp_path)
    box, network = Box((-1, -1, -1), (1, 1, 1)), SIREN(width=16, depth=1)
    network.last.bias.data -= network(Box((0, 0, 0), (0, 0, 0)).uniform(1, generator=_generator()).float()).detach()
    moving = Placed(lift(network), box.during((0.0, 1.0)))
    moving.provenance["equation"] = repr(equations.MeanCurvature(0.1))
    save(moving, "moving.safetensors")
    moving.provenance["equation"] = "Morph(towards 1 target(s) at t = 1)"
    save(moving, "morph.safetensors")
    save(Placed(network, box), "still.safetensors")
    pair = Placed(lift(network, time=2), box.during((0.0, 1.0), (-1.0, 3.0)))
    pair.provenance["equation"] = repr(equations.Family(equations.MeanCurvature(0.1), equations.Stationary()))
    save(pair, "pair.safetensors")
    network.last.bias.data += 100
    save(Placed(network, box), "empty.safetensors")
    np.savetxt("cloud.xyz", np.random.default_rng(0).normal(size=(40, 3)))
    return tmp_path


def _generator():
    import torch

    return torch.Generator().manual_seed(0)


def picture(path):
    from PIL import Image

    return np.array(Image.open(path).convert("RGB"))


def test_pictures_of_fields_meshes_and_built_ins(run, folder):
    code, out, _ = run("render", "moving.safetensors", "--time", 0.5, "-o", "x.png", "--size", "80x60")
    assert code == 0 and "80 x 60 pixels" in out
    assert picture("x.png").shape == (60, 80, 3)
    assert run("render", "still.safetensors", "-o", "y.png", "--size", 60, "--by", "mesh", "-q")[:2] == (0, "")
    assert run("render", "torus", "-o", "z.jpg", "--size", 60, "--up", "z", "--elevation", -20)[0] == 0
    views = [picture(name) for name in ("y.png", "z.jpg")]
    assert all(np.ptp(view.reshape(-1, 3), axis=0).min() > 50 for view in views)
    for colour in ("clay", "normal", "curvature"):
        assert run("render", "sphere", "-o", f"{colour}.png", "--size", 64, "--colour", colour)[0] == 0
    assert run("render", "still.safetensors", "-o", "k.png", "--size", 64, "--colour", "curvature")[0] == 0
    assert (
        run("render", "moving.safetensors", "--time", 0.5, "-o", "r.png", "--size", 64, "--colour", "residual")[0] == 0
    )
    assert not np.array_equal(picture("clay.png"), picture("normal.png"))
    assert not np.array_equal(picture("k.png"), picture("r.png"))


def test_a_traced_picture_agrees_with_that_of_the_mesh(run, folder):
    for by in ("trace", "mesh"):
        assert run("render", "still.safetensors", "-o", f"{by}.png", "--size", 96, "--by", by, "--azimuth", 70)[0] == 0
    assert np.abs(picture("trace.png").astype(int) - picture("mesh.png")).mean() < 6


def test_films_in_time_and_around(run, folder):
    code, out, err = run("film", "moving.safetensors", "-o", "x.gif", "--frames", 3, "--size", 48, "--resolution", 16)
    assert code == 0 and "3 frames of 48 x 48 pixels" in out, err
    code, out, _ = run("film", "moving.safetensors", "-o", "x.mp4", "--times", "0:1:3", "--size", 48, "--turntable",
                       90, "--bounce", "--resolution", 16, "--fps", 8, "--colour", "curvature")  # fmt: skip
    assert code == 0 and "4 frames of 48 x 48 pixels, 0.5 s" in out
    code, _, err = run("film", "moving.safetensors", "-o", "r.gif", "--frames", 2, "--size", 64, "--resolution", 16,
                       "--colour", "residual")  # fmt: skip
    assert code == 0, err
    for shape in ("torus", "still.safetensors"):
        code, out, _ = run("film", shape, "-o", "t.gif", "--turntable", 360, "--frames", 4, "--size", 64,
                           "--colour", "curvature", "--resolution", 16)  # fmt: skip
        assert code == 0 and "4 frames" in out
    assert run("film", "moving.safetensors", "-o", "s.gif", "--time", 0.5, "--turntable", 90, "--frames", 2,
               "--size", 32, "--colour", "normal", "--resolution", 16, "-q")[:2] == (0, "")  # fmt: skip


def test_fields_of_several_parameters_are_shown_at_a_point_and_on_a_walk(run, folder):
    common = ("--size", 64, "--resolution", 16)
    for colour in ("clay", "curvature", "residual"):
        code, _, err = run("render", "pair.safetensors", "--time", "0.5,-1", "-o", f"{colour}.png", "--colour", colour,
                           *common)  # fmt: skip
        assert code == 0, err
        code, out, err = run("film", "pair.safetensors", "--path", "0,-1:1,-1:1,3", "--frames", 3, "-o", "x.gif",
                             "--colour", colour, *common)  # fmt: skip
        assert code == 0 and "3 frames" in out, err
    assert not np.array_equal(picture("clay.png"), picture("residual.png"))
    code, out, err = run("film", "pair.safetensors", "--time", "0,0", "--turntable", 360, "--frames", 2, "-o", "t.gif",
                         *common)  # fmt: skip
    assert code == 0 and "2 frames" in out, err
    code, out, err = run("film", "moving.safetensors", "--path", "0:1:0", "--frames", 5, "-o", "t.gif", *common)
    assert code == 0 and "5 frames" in out, err
    assert run("mesh", "pair.safetensors", "--time", "1,0", "-o", "m.ply", "--resolution", 16)[0] == 0


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("render", "sphere", "-o", "x.pnx"), 2, "known formats are .png"),
        (("render", "none.safetensors", "-o", "x.png"), 2, "there is no file"),
        (("render", "moving.safetensors", "-o", "x.png"), 2, "from t = 0 to 1; say when with --time"),
        (("render", "moving.safetensors", "--time", "3", "-o", "x.png"), 2, "solved for times from 0 to 1"),
        (("render", "still.safetensors", "--time", "3", "-o", "x.png"), 2, "leave --time out"),
        (("render", "sphere", "--time", "3", "-o", "x.png"), 2, "a shape has no time"),
        (("render", "empty.safetensors", "-o", "x.png"), 1, "no surface is seen in the box"),
        (("render", "empty.safetensors", "--by", "mesh", "-o", "x.png"), 1, "everywhere in the box"),
        (("render", "cloud.xyz", "-o", "x.png"), 2, "a point cloud has no surface"),
        (("render", "sphere", "--by", "magic", "-o", "x.png"), 2, "give trace or mesh"),
        (("render", "sphere", "--by", "trace", "-o", "x.png"), 2, "this is a mesh"),
        (("render", "sphere", "--colour", "blue", "-o", "x.png"), 2, "known are clay, normal, curvature"),
        (("render", "sphere", "--colour", "residual", "-o", "x.png"), 2, "a mesh solves no equation"),
        (("render", "still.safetensors", "--colour", "residual", "-o", "x.png"), 2, "the field stands still"),
        (("film", "morph.safetensors", "--colour", "residual", "-o", "x.gif"), 2, "at t = 1), cannot be told"),
        (("render", "sphere", "--size", "0", "-o", "x.png"), 2, "give pixels"),
        (("render", "sphere", "--size", "1x2x3", "-o", "x.png"), 2, "give pixels"),
        (("render", "sphere", "--elevation", "90", "-o", "x.png"), 2, "between -90 and 90"),
        (("render", "sphere", "--up", "0,0,0", "-o", "x.png"), 2, "not all zero"),
        (("render", "sphere", "-o", "none/x.png"), 2, "there is no folder"),
        (("render", "pair.safetensors", "-o", "x.png"), 2,
         "the field has 2 parameters, from 0 to 1 and from -1 to 3; give one number for each with --time 0.5,1."),
        (("render", "pair.safetensors", "--time", "0.5", "-o", "x.png"), 2,
         "and 1 number(s) are given; one for each is needed, such as --time 0.5,1."),
        (("mesh", "pair.safetensors", "--time", "0,0,0", "-o", "x.ply"), 2, "and 3 number(s) are given"),
        (("mesh", "moving.safetensors", "--time", "0,1", "-o", "x.ply"), 2, "to 1, and 2 number(s) are given"),
        (("mesh", "still.safetensors", "--time", "0", "-o", "x.ply"), 2, "leave --time out"),
        (("mesh", "moving.safetensors", "--time", "soon", "-o", "x.ply"), 2, "--time soon: give numbers"),
        (("film", "pair.safetensors", "-o", "x.gif"), 2, "corner after corner, such as --path 0,-1:1,-1:1,3, or where"),
        (("film", "pair.safetensors", "--path", "0:1", "-o", "x.gif"), 2, "such as --path 0,-1:1,-1:1,3."),
        (("film", "pair.safetensors", "--path", "0,0", "-o", "x.gif"), 2, "give two corners or more"),
        (("film", "pair.safetensors", "--path", "0,0:0,0", "-o", "x.gif"), 2, "the way has no length"),
        (("film", "pair.safetensors", "--path", "0,0:9,0", "-o", "x.gif"), 2, "solved for times from 0 to 1"),
        (("film", "pair.safetensors", "--path", "0,0:1,0", "--times", "0,1", "-o", "x.gif"), 2, "the walk says when"),
        (("film", "still.safetensors", "--path", "0:1", "-o", "x.gif"), 2, "leave --path out"),
        (("film", "sphere", "--path", "0:1", "-o", "x.gif"), 2, "a shape has no parameters; leave --path out"),
        (("film", "moving.safetensors", "--time", "0", "--times", "0,1", "-o", "x.gif"), 2, "the surface stands still"),
        (("film", "moving.safetensors", "-o", "x.avi"), 2, "known formats are .mp4"),
        (("film", "moving.safetensors", "-o", "x.gif", "--times", "0,2"), 2, "solved for times from 0 to 1"),
        (("film", "still.safetensors", "-o", "x.gif", "--times", "0,1"), 2, "the surface stands still"),
        (("film", "sphere", "-o", "x.gif"), 2, "turn it around with --turntable 360"),
        (("film", "sphere", "-o", "x.gif", "--turntable", "9", "--frames", "0"), 2, "at least one frame"),
        (("film", "empty.safetensors", "-o", "x.gif", "--turntable", "9"), 1, "has vanished"),
        (("film", "sphere", "-o", "x.mp4", "--turntable", "9", "--fps", "0"), 2, "frames a second"),
    ],
    ids=lambda value: " ".join(value[:5]) if isinstance(value, tuple) else "",
)  # fmt: skip
def test_wrong_use_is_answered_in_a_sentence(run, unchecked, folder, arguments, code, message):
    before = sorted(folder.iterdir())
    got, out, err = run(*arguments)
    assert got == code, err
    assert message in err
    assert "Traceback" not in out + err
    assert sorted(folder.iterdir()) == before


def test_a_missing_extra_is_named(run, folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    code, _, err = run("film", "sphere", "-o", "x.mp4", "--turntable", 360)
    assert code == 1 and "pip install 'levelflow[film]'" in err and len(err.splitlines()) == 1
