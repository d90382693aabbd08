"""`levelflow lift` and `levelflow slice` as a user meets them: files that are read back, and what is answered."""

import os
import re

import pytest
import torch

from levelflow import SIREN, Box, Circle, Placed, Transported, equations, load, save
from levelflow.equations.described import equation_of
from levelflow.networks.lifting import lifting_error
from levelflow.saving import describe
from tests.fields import lipschitz, placed, points, siren

pytestmark = pytest.mark.filterwarnings("default")


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a field of space, one of space-time, one with two parameters, and one that is transported."""
    monkeypatch.chdir(tmp_path)
    three = Placed(siren(2, 3), Box((0.0, 0.0), (1.0, 1.0), ((0.0, 1.0),) * 3))
    fields = {"still": placed(3), "moving": placed(3, 1), "family": placed(2, 2), "pair": placed(2, 2), "three": three}
    for name, field in fields.items():
        field.provenance = {"verb": "fit", "seed": 7, "inputs": ["spot.obj"]}
        save(field, f"{name}.safetensors")
    disc = Placed(SIREN(2, width=4, depth=1), Circle(0.5).box.expanded(1.0))
    carried = Transported(equations.Transport(equations.Constant((1.0, 0.0))), disc, box=disc.box.during((0.0, 1.0)))
    save(carried, "carried.safetensors")
    save(Placed(lipschitz(2), Circle(0.5).box), "smooth.safetensors")
    (tmp_path / "FILE").write_text("a letter")
    return tmp_path


def network(name):
    return describe(name)["network"]


def test_help_names_the_commands(run):
    assert "--slope" in run("lift", "--help")[1] and "colon" in run("slice", "--help")[1]
    out = run("--help")[1]
    assert "lift" in out and "slice" in out


def test_a_field_of_space_becomes_one_of_space_and_time_that_stands_still(run, here):
    code, out, _ = run("lift", "still.safetensors", "-o", "new/folder/out.safetensors", "--times=-1:3", "--width", 24)
    assert code == 0 and out == "new/folder/out.safetensors: 2 layers of 16 -> 2 layers of 24, t from -1 to 3\n"
    still, lifted = load("still.safetensors"), load("new/folder/out.safetensors")
    assert lifted.box == still.box.during((-1.0, 3.0))
    x, _ = points(still)
    for t in (-1.0, 0.4, 3.0):
        jet, exact = lifted.jet(x, torch.full((len(x), 1), t, dtype=torch.float64), order=2), still.jet(x, order=2)
        assert torch.allclose(jet.value, exact.value, rtol=0, atol=1e-12)
        assert torch.allclose(jet.gradient, exact.gradient, rtol=0, atol=1e-12)
        assert torch.allclose(jet.hessian, exact.hessian, rtol=0, atol=1e-11)
        assert (jet.dt == 0).all()
    assert lifted.provenance == {
        **still.provenance,
        "equation": "Stationary()",
        "changes": [
            {"verb": "lift", "input": "still.safetensors", "width": 24, "depth": 2, "times": [[-1.0, 3.0]]},
        ],
    }  # fmt: skip


def test_a_deeper_field_is_the_same_within_the_error_that_is_said(run, here):
    for slope, atol in (("0.1", 1e-2), ("0.001", 1e-6)):
        code, out, _ = run("lift", "moving.safetensors", "-o", "deep.safetensors", "--depth", 4, "--slope", slope)
        assert code == 0 and "2 layers of 16 -> 4 layers of 16, t from 2 to 5" in out
        moving, deep = load("moving.safetensors"), load("deep.safetensors")
        bound = lifting_error(moving.field, depth=4, slope=float(slope)) * moving.box.frame.scale
        (said,) = re.findall(r"added layers change values by at most (\S+), \S+ of the box", out)
        x, t = points(moving, 200)
        error = float((deep(x, t) - moving(x, t)).detach().abs().max())
        assert 0 < error <= bound < atol and float(said) == pytest.approx(bound, rel=0.06)
        assert deep.box == moving.box and deep.provenance["changes"][0]["slope"] == float(slope)
    assert network("deep.safetensors") == {**network("moving.safetensors"), "depth": 4}


def test_a_slice_is_a_field_of_space_with_the_values_of_the_whole(run, here):
    assert run("slice", "moving.safetensors", "--time", "3.5", "-o", "at.safetensors")[:2] == (
        0, "at.safetensors: moving.safetensors at 3.5\n",
    )  # fmt: skip
    moving, still = load("moving.safetensors"), load("at.safetensors")
    assert network("at.safetensors") == {**network("moving.safetensors"), "time": 0}
    assert still.box == moving.box.during() and still.provenance["verb"] == "fit"
    assert still.provenance["changes"] == [{"verb": "slice", "input": "moving.safetensors", "time": [3.5]}]
    x, _ = points(moving)
    jet, whole = still.jet(x, order=2), moving.jet(x, torch.full((len(x), 1), 3.5, dtype=torch.float64), order=2)
    assert torch.allclose(jet.value, whole.value, rtol=0, atol=1e-12)
    assert torch.allclose(jet.gradient, whole.gradient, rtol=0, atol=1e-12)
    assert torch.allclose(jet.hessian, whole.hessian, rtol=0, atol=1e-11)


def test_some_of_several_parameters_are_sliced(run, here):
    code, out, _ = run("slice", "family.safetensors", "--time", ":,-0.5", "-o", "some.safetensors")
    assert code == 0 and out == "some.safetensors: family.safetensors at :,-0.5, t from 2 to 5\n"
    family, some = load("family.safetensors"), load("some.safetensors")
    assert some.box == family.box.during((2.0, 5.0))
    x, t = points(family)
    t[:, 1] = -0.5
    assert torch.allclose(some(x, t[:, :1]), family(x, t), rtol=0, atol=1e-12)
    assert run("slice", "family.safetensors", "--time", "3,-0.5", "-o", "all.safetensors")[0] == 0
    assert torch.allclose(load("all.safetensors")(x), load("family.safetensors").at(3.0, -0.5)(x), atol=1e-12)
    assert run("slice", "some.safetensors", "--time", "3", "-o", "both.safetensors")[0] == 0
    changes = load("both.safetensors").provenance["changes"]
    assert [change["time"] for change in changes] == [[None, -0.5], [3.0]]
    assert torch.equal(load("both.safetensors")(x), load("some.safetensors").at(3.0)(x))


def test_lifting_and_slicing_give_back_the_field(run, here):
    run("lift", "still.safetensors", "-o", "lifted.safetensors", "--times", "0:1")
    run("slice", "lifted.safetensors", "--time", "1", "-o", "back.safetensors")
    x, _ = points(load("still.safetensors"))
    assert torch.allclose(load("back.safetensors")(x), load("still.safetensors")(x), rtol=0, atol=1e-14)
    assert [change["verb"] for change in load("back.safetensors").provenance["changes"]] == ["lift", "slice"]


def with_equation(equation, name):
    field = load(name)
    field.provenance["equation"] = repr(equation)
    save(field, name)


def test_an_equation_stays_with_a_field_only_while_it_holds(run, here):
    """What is lifted to a time stands still in it, whatever moved the slice that it was."""
    smooth, push = equations.MeanCurvature(0.5), equations.Transport((1.0, 0.0))
    with_equation(smooth, "moving.safetensors")
    run("lift", "moving.safetensors", "-o", "wide.safetensors", "--width", "20")
    assert load("wide.safetensors").provenance["equation"] == repr(smooth)
    run("slice", "moving.safetensors", "--time", "3", "-o", "at.safetensors")
    run("lift", "at.safetensors", "-o", "again.safetensors", "--times", "0:1")
    at, again = load("at.safetensors"), load("again.safetensors")
    assert "equation" not in at.provenance and at.provenance["changes"][0]["equation"] == repr(smooth)
    assert again.provenance["equation"] == "Stationary()" and "equation" not in again.provenance["changes"][1]
    x, t = points(again)
    found = equation_of(again.provenance)
    assert found.error(x, t, again.jet(x, t, order=1)).detach().abs().max() == 0

    with_equation(equations.Family(push, smooth, push), "three.safetensors")
    for family, time, left in (
        ("three", "0.5,:,:", repr(equations.Family(smooth, push))),
        ("three", ":,0.5,0.5", repr(push)),
        ("three", "0.5,0.5,0.5", None),
        ("family", "3,:", None),
        ("family", ":,0", repr(push)),
        ("pair", ":,0", None),
    ):
        with_equation(push, "family.safetensors")
        with_equation(equations.Family(push, smooth) + equations.Eikonal(), "pair.safetensors")
        run("slice", f"{family}.safetensors", f"--time={time}", "-o", "some.safetensors")
        assert load("some.safetensors").provenance.get("equation") == left


def test_a_field_may_take_the_place_of_its_source(run, here):
    before = load("still.safetensors")
    assert run("lift", "still.safetensors", "-o", "still.safetensors", "--width", 20)[0] == 0
    x, _ = points(before)
    assert torch.allclose(load("still.safetensors")(x), before(x), rtol=0, atol=1e-12)


def test_a_full_disk_leaves_what_was_there(run, here, monkeypatch):
    def full(source, target):
        raise OSError(28, "No space left on device", str(target))

    (here / "old.safetensors").write_bytes((here / "still.safetensors").read_bytes())
    before = sorted((path.name, path.read_bytes()) for path in here.iterdir())
    monkeypatch.setattr(os, "replace", full)
    for command in (
        ("lift", "still.safetensors", "--width", 20, "-o", "old.safetensors"),
        ("slice", "moving.safetensors", "--time", "3", "-o", "none.safetensors"),
    ):
        code, _, err = run(*command)
        assert code == 1 and "No space left" in err and "Traceback" not in err
    assert sorted((path.name, path.read_bytes()) for path in here.iterdir()) == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("lift", "still"), r"say to what: --width, --depth, or --times first:last"),
        (("lift", "still", "--width", "8"), r"has width 16; lifting cannot make it narrower"),
        (("lift", "still", "--depth", "1"), r"has depth 2; lifting cannot make it shallower"),
        (("lift", "still", "--depth", "3", "--slope", "0"), r"slope=0\): give a number above 0 and at most 1"),
        (("lift", "still", "--times", "soon"), r"--times soon: give the first and the last time, in order: 0:1"),
        (("lift", "still", "--times", "0:1:5"), r"--times 0:1:5: give the first and the last"),
        (("lift", "still", "--times", "1:1"), r"--times 1:1: give the first and the last"),
        (("lift", "still", "--times", "0:inf"), r"--times 0:inf: give the first and the last"),
        (("lift", "moving", "--times", "0:1"), r"moves already, from t = 2 to 5; leave --times out"),
        (("lift", "carried", "--width", "9"), r"lift carried.*is carried along by a velocity, without a network"),
        (("lift", "smooth", "--width", "20"), "its network is a LipschitzMLP; only a SIREN can be changed"),
        (("lift", "none", "--width", "20"), "there is no file"),
        (("lift", "FILE", "--width", "20"), "is not a field"),
        (("slice", "still", "--time", "3"), r"does not depend on time; it is a slice already"),
        (("slice", "moving", "--time", "9"), r"at\(9\): the field was solved for times from 2 to 5"),
        (("slice", "moving", "--time", "nan"), r"at\(nan\): the field was solved for times from 2 to 5"),
        (("slice", "moving", "--time", "soon"), r"--time soon: give a number, 0.5, or for several parameters"),
        (("slice", "family", "--time", ":,:"), r"--time :,:: give a number"),
        (("slice", "family", "--time", "3"), r"has 2 time\(s\) or parameter\(s\); .* stays: --time 0.5,:\."),
        (("slice", "moving", "--time", "3,4"), r"has 1 time\(s\) or parameter\(s\)"),
        (("slice", "carried", "--time", "0.5"), r"slice carried.*is carried along by a velocity"),
        (("slice", "moving"), "--time"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_wrong_use_is_answered_in_a_sentence(run, unchecked, here, arguments, message):
    call, field, *rest = arguments
    before = sorted(here.iterdir())
    code, out, err = run(call, field if field == "FILE" else f"{field}.safetensors", "-o", "new/out.safetensors", *rest)
    assert code == 2 and re.search(message, err.replace("\n", " ")), err
    assert "Traceback" not in out + err and sorted(here.iterdir()) == before


@pytest.mark.parametrize("command", [("lift", "--width", "20"), ("slice", "--time", "3")])
def test_a_field_is_written_to_a_file_of_its_kind(run, here, command):
    call, *rest = command
    code, _, err = run(call, "moving.safetensors", "-o", "out.ply", *rest)
    assert code == 2 and f"{call} -o out.ply: a field is a .safetensors file; name it out.safetensors" in err
