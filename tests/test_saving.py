import json
import math

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from levelflow import (
    SIREN,
    Box,
    Budget,
    Checkpoint,
    Circle,
    Continued,
    Deformed,
    Inverse,
    LipschitzMLP,
    Periodic,
    Sampling,
    Sphere,
    fit,
    load,
    save,
)
from levelflow.equations import (
    BoxMask,
    Constant,
    Family,
    PaintedMask,
    ProductOfMasks,
    Regional,
    Rotation,
    Source,
    SphereMask,
    Transport,
)
from levelflow.fields import Placed, Slice, Sum
from levelflow.retimed import Retimed
from levelflow.saving import describe
from levelflow.transported import Transported
from tests.fields import invertible, lipschitz, periodic, siren
from tests.fields import placed as placed_anywhere

BOX = Box((-3.0, 1.0, 0.0), (5.0, 2.0, 4.0), ((-0.5, 2.0),))


def placed(**more):
    field = Placed(SIREN(3, 1, width=8, depth=2, **more), BOX)
    field.provenance = {"verb": "solve", "seed": 3}
    return field


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_field_comes_back_with_its_values_box_and_provenance(tmp_path, generator, dtype):
    field = placed(omega=7.0, dtype=dtype)
    save(field, tmp_path / "f.safetensors")
    again = load(tmp_path / "f.safetensors")
    x, t = BOX.uniform(50, generator=generator), BOX.uniform_times(50, generator=generator)
    assert torch.equal(field(x, t), again(x, t))
    assert again.box == BOX and again.provenance == field.provenance


def test_a_slice_is_saved_like_any_field(tmp_path, generator):
    field = placed().at(1.0)
    save(field, tmp_path / "f.safetensors")
    x = BOX.uniform(50, generator=generator)
    assert torch.equal(field(x), load(tmp_path / "f.safetensors")(x))


@pytest.mark.parametrize(
    "inner",
    [
        lipschitz(3, 1),
        LipschitzMLP(3, 1, width=8),
        Deformed(Continued(placed_anywhere(3)), invertible(3, 1)),
        Deformed(siren(3), invertible(3, 1, blocks=2, depth=1, lipschitz=0.7)),
        Deformed(siren(3), Inverse(invertible(3, 1).float(), tolerance=1e-3)),
        Deformed(placed_anywhere(3), Inverse(invertible(3, 1))),
        Deformed(Slice(siren(3, 2), (0.3, -0.5)), invertible(3, 1)),
        periodic(3, 1, axes=(2, 0), loop=True),
        Periodic(LipschitzMLP(3, 2, width=8), time=True),
    ],
    ids=[
        "Lipschitz",
        "Lipschitz in float32",
        "deformed beyond its box",
        "deformed",
        "carried",
        "carried in units",
        "carried slice",
        "periodic",
        "loop",
    ],
)
def test_networks_that_are_bounded_or_move_space_come_back(tmp_path, generator, inner):
    field = Placed(inner, BOX)
    x, t = BOX.uniform(20, generator=generator), BOX.uniform_times(20, generator=generator)
    for saved in (field, field.at(0.5)):
        save(saved, tmp_path / "f.safetensors")
        again = load(tmp_path / "f.safetensors")
        jet, same = (f.jet(x, t[:, : f.times], order=2) for f in (saved, again))
        assert all(torch.equal(getattr(jet, part), getattr(same, part)) for part in ("value", "first", "second"))
        assert [p.requires_grad for p in again.parameters()] == [True] * len(list(field.parameters()))
        assert again.box == saved.box


def carried(velocity, **more):
    static = Placed(SIREN(2, width=8, depth=2), Box((-1.0, -1.0), (1.0, 2.0)))
    static.provenance = {"verb": "fit"}
    field = Transported(Transport(velocity), static, box=Box((-2.0, -2.0), (2.0, 2.0), ((0.0, 3.0),)), **more)
    field.provenance = {"verb": "transport"}
    return field


@pytest.mark.parametrize(
    "velocity",
    [Constant((1.0, 2.0)), Rotation(1.0, center=(0.5, 0.0)), Source((0.1, 0.2), -1.0, 0.5) + Constant((0.0, 1.0))],
)
def test_a_carried_field_comes_back_with_what_carries_it(tmp_path, generator, velocity):
    field = carried(velocity, time=1.0)
    save(field, tmp_path / "f.safetensors")
    again = load(tmp_path / "f.safetensors")
    x, t = field.box.uniform(50, generator=generator), field.box.uniform_times(50, generator=generator)
    assert torch.equal(field(x, t), again(x, t))
    assert again.motion.velocity == velocity and again.box == field.box
    assert again.provenance == {"verb": "transport"} and again.shape.provenance == {"verb": "fit"}


def test_a_retimed_field_comes_back_with_its_keys_and_all_that_is_inside(tmp_path, generator):
    inner = placed()
    once = Retimed(inner, {0: -0.5, 1: 2, 2.5: 0})
    for field in (once, Retimed(once, {0: 1, 7: 2.5}, ease=0.25), Retimed(carried((1.0, 0.0)), {0: 3, 1: 0})):
        field.provenance = {"verb": "retime"}
        save(field, tmp_path / "f.safetensors")
        again = load(tmp_path / "f.safetensors")
        x, t = field.box.uniform(20, generator=generator), field.box.uniform_times(20, generator=generator)
        assert torch.equal(field(x, t), again(x, t)) and again.box == field.box
        assert (again.keys, again.ease, again.provenance) == (field.keys, field.ease, {"verb": "retime"})
        assert again.field.provenance == field.field.provenance
        save(again, tmp_path / "again.safetensors")
        assert (tmp_path / "again.safetensors").read_bytes() == (tmp_path / "f.safetensors").read_bytes()
    assert describe(tmp_path / "f.safetensors")["retimed"][0]["keys"] == [[0.0, 3.0], [1.0, 0.0]]


def test_only_our_own_fields_are_saved_retimed(tmp_path):
    class Mine(Retimed):
        pass

    with pytest.raises(TypeError, match="cannot write a Mine; "):
        save(Mine(placed(), {0: 0, 1: 1}), tmp_path / "f.safetensors")
    disk = Transported(Transport((1.0, 0.0)), Circle(0.5), until=1.0)
    with pytest.raises(TypeError, match="cannot write a Retimed of a Transported of a Circle"):
        save(Retimed(disk, {0: 0, 1: 1}), tmp_path / "f.safetensors")


BALL = SphereMask((0.5, 0.0), 0.3, 0.2, inside=0.0, outside=1.0)
HALF = BoxMask((-math.inf, -1.0), (math.inf, 1.0), 0.1)
PAINTED = PaintedMask.of(np.array([[0.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), np.array([0.0, 1.0, 0.5]), name="a.ply")


@pytest.mark.parametrize(
    "motion",
    [
        Regional(Transport(Constant((1.0, 0.0)) + Rotation(1.0)), BALL),
        Family(Transport((1.0, 0.0)), Transport((0.0, 2.0))),
        Family(Regional(Transport((1.0, 0.0)), PAINTED), Regional(Transport((2.0, 0.0)), PAINTED)),
        Regional(Transport((0.0, 1.0)), ProductOfMasks((HALF, PAINTED, PAINTED))),
    ],
    ids=["a mask", "a family", "painted masks", "a product of masks"],
)
def test_families_and_masks_come_back(tmp_path, generator, motion):
    static = Placed(SIREN(2, width=8, depth=2), Box((-1.0, -1.0), (1.0, 2.0)))
    k = len(motion.columns)
    field = Transported(motion, static, box=static.box.during(*[(0.0, 1.0)] * k), time=(0.5, 0.25)[:k])
    save(field, tmp_path / "f.safetensors")
    again = load(tmp_path / "f.safetensors")
    x, t = field.box.uniform(50, generator=generator), field.box.uniform_times(50, generator=generator)
    assert torch.equal(field(x, t), again(x, t)) and again.box == field.box and again.steps == field.steps
    assert repr(again.motion) == repr(motion) and tuple(np.ravel(again.time)) == tuple(np.ravel(field.time))


def test_a_mask_of_code_is_not_saved_and_an_unknown_one_not_read(tmp_path, monkeypatch):
    static = Placed(SIREN(2, width=8, depth=2), Box((-1.0, -1.0), (1.0, 2.0)))

    def masked(mask):
        return Transported(Regional(Transport((1.0, 0.0)), mask), static, box=static.box.during((0.0, 1.0)))

    with pytest.raises(TypeError, match="whose motion has the mask <function .* files hold no code; BoxMask"):
        save(masked(lambda x: x[:, 0]), tmp_path / "f.safetensors")
    save(masked(BALL), tmp_path / "f.safetensors")
    monkeypatch.setattr("levelflow.saving._MASKS", {})
    with pytest.raises(ValueError, match="has a mask that is a 'SphereMask', which this version does not know"):
        load(tmp_path / "f.safetensors")


def test_a_field_carried_by_code_is_not_saved(tmp_path):
    with pytest.raises(TypeError, match="files hold no code"):
        save(carried(lambda x, t: x), tmp_path / "f.safetensors")
    disk = Transported(Transport((1.0, 0.0)), Circle(0.5), until=1.0)
    with pytest.raises(TypeError, match="cannot write a Transported of a Circle"):
        save(disk, tmp_path / "f.safetensors")


def test_an_unknown_velocity_in_a_file_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("levelflow.saving._VELOCITIES", {"Constant": Constant})
    save(carried((1.0, 0.0)), tmp_path / "f.safetensors")
    monkeypatch.setattr("levelflow.saving._VELOCITIES", {})
    with pytest.raises(ValueError, match="its velocity is a 'Constant', which this version does not know"):
        load(tmp_path / "f.safetensors")


def test_the_same_field_gives_the_same_bytes(tmp_path):
    for name in ("a.safetensors", "b.safetensors"):
        save(placed(), tmp_path / name)
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()


def test_a_truncated_file_is_named(tmp_path):
    path = tmp_path / "f.safetensors"
    save(placed(), path)
    for part in (0, 4, 100, len(path.read_bytes()) - 1):
        (tmp_path / "cut.safetensors").write_bytes(path.read_bytes()[:part])
        with pytest.raises(ValueError, match=r"cut.safetensors.*is not a field"):
            load(tmp_path / "cut.safetensors")


def test_a_foreign_file_is_named(tmp_path):
    save_file({"w": torch.zeros(3)}, tmp_path / "other.safetensors")
    with pytest.raises(ValueError, match="of another program"):
        load(tmp_path / "other.safetensors")


def test_a_missing_file_and_a_folder_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no file"):
        load(tmp_path / "none.safetensors")
    with pytest.raises(ValueError, match="is a folder"):
        load(tmp_path)


def header(**changes):
    made = {
        "format": 1, "version": "0.1.0", "kind": "field", "provenance": {},
        "network": {"type": "SIREN", "space": 3, "time": 1, "width": 8, "depth": 2, "omega": 10.0},
        "box": {"lower": BOX.lower, "upper": BOX.upper, "times": BOX.times},
    }  # fmt: skip
    return {"levelflow": json.dumps(made | changes)}


def test_a_header_that_does_not_describe_its_content_is_refused(tmp_path):
    tensors = SIREN(3, 1, width=8, depth=2).state_dict()
    path = tmp_path / "f.safetensors"
    for changes, message in (
        ({"network": {"type": "Other"}}, "does not know"),
        ({"box": {}}, "does not describe its content"),
        ({"network": json.loads(header()["levelflow"])["network"] | {"width": 9}}, "does not describe its content"),
        ({"format": 99, "version": "9.0"}, "newer than"),
        ({"kind": "checkpoint"}, "holds a checkpoint, not a field"),
    ):
        save_file(tensors, path, metadata=header(**changes))
        with pytest.raises(ValueError, match=message):
            load(path)
    save_file(tensors, path, metadata=header())
    assert load(path).box == BOX
    network = json.loads(header()["levelflow"])["network"]
    moving = {"type": "InvertibleResNet", "space": 3, "time": 1}
    for described, message in (
        (moving, "where a field belongs it has a InvertibleResNet"),
        ({"type": "Deformed", "field": moving, "deformation": moving}, "where a field belongs it has"),
        (
            {"type": "Deformed", "field": network, "deformation": {"type": "Inverse", "network": network}},
            "it has the inverse of a SIREN",
        ),
        (
            {"type": "Periodic", "network": moving, "axes": [], "time": True},
            "it has a InvertibleResNet that is periodic",
        ),
    ):
        save_file(tensors, path, metadata=header(network=described))
        with pytest.raises(ValueError, match=message):
            load(path)
    for keys in ([], [[0, 0], [1, 9]], [["soon", 0], [1, 1]], "01"):
        save_file(tensors, path, metadata=header(retimed=[{"keys": keys, "ease": 1.0, "field": {}}]))
        with pytest.raises(ValueError, match="does not describe its content"):
            load(path)


def test_a_network_of_ones_own_is_refused_and_a_shared_one_is_written_twice(tmp_path, generator):
    class Mine(SIREN):
        pass

    with pytest.raises(TypeError, match="cannot write a Mine, since files hold no code"):
        save(Placed(Mine(3, 1, width=4), BOX), tmp_path / "f.safetensors")
    turn = invertible(3)
    field = Placed(Deformed(Deformed(siren(3), turn), Inverse(turn)), BOX.during())
    save(field, tmp_path / "f.safetensors")
    x = BOX.uniform(20, generator=generator)
    assert torch.equal(load(tmp_path / "f.safetensors")(x), field(x))


def test_only_fields_of_networks_are_saved(unchecked, tmp_path):
    with pytest.raises(TypeError, match="cannot write a Sum"):
        save(Sum(SIREN(width=4), SIREN(width=4)), tmp_path / "f.safetensors")
    with pytest.raises(TypeError, match=r"cannot write a LipschitzMLP; .* given a box, Placed\(network, box\)"):
        save(LipschitzMLP(width=4), tmp_path / "f.safetensors")
    inner = Sum(SIREN(3, 1, width=4), SIREN(3, 1, width=4))
    with pytest.raises(TypeError, match="cannot write a Sum, since files hold no code; SIREN, LipschitzMLP"):
        save(Placed(inner, BOX), tmp_path / "f.safetensors")


@pytest.mark.filterwarnings("ignore:sample_surface")
def test_an_interrupted_run_goes_on_and_ends_the_same(tmp_path):
    class Interrupted(Exception):
        pass

    def interrupted(progress):
        kept(progress)
        if progress.step == 25:
            raise Interrupted

    problem = {"shape": Circle(0.5), "budget": Budget(steps=40), "sampling": Sampling(n=128, given=500)}
    whole = fit(SIREN(2, width=8, depth=2), **problem)
    kept = Checkpoint(tmp_path / "run.safetensors", settings={"seed": 0, "times": (0.0, 1.0)}, seconds=0)
    assert kept.state is None
    with pytest.raises(Interrupted):
        fit(SIREN(2, width=8, depth=2), **problem, on_step=interrupted)
    assert describe(kept.path)["settings"] == {"seed": 0, "times": [0.0, 1.0]}
    resumed = fit(SIREN(2, width=8, depth=2), **problem, on_step=kept, state=kept.state)
    assert all(torch.equal(a, b) for a, b in zip(whole.parameters(), resumed.parameters(), strict=True))
    with pytest.raises(ValueError, match="seed was 0 and is 1"):
        Checkpoint(kept.path, settings={"seed": 1, "times": (0.0, 1.0)}).state  # noqa: B018
    with pytest.raises(ValueError, match="holds a checkpoint, not a field"):
        load(kept.path)
    kept.remove()
    assert not kept.path.exists()


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "f.safetensors"
    save(placed(), path)
    old = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(OSError, match="No space left"):
        save(placed(omega=3.0), path)
    assert path.read_bytes() == old
    assert list(tmp_path.iterdir()) == [path]


def test_a_shape_is_not_a_field(unchecked, tmp_path):
    with pytest.raises(TypeError, match="cannot write a Sphere"):
        save(Sphere(1.0), tmp_path / "f.safetensors")
