import math

import pytest
import torch

from levelflow import Box, Mesh
from levelflow.export.frames import file_name, write_frames
from tests.fields import Explicit


@pytest.mark.parametrize(
    ("time", "name"),
    [(0.1, "t=+0.100.ply"), (-0.25, "t=-0.250.ply"), (-0.0, "t=+0.000.ply"), (12, "t=+12.000.ply"),
     (1 / 3, "t=+0.333333333.ply"), (1e-6, "t=+1e-06.ply"), ((0.5, -0.0, -1.0), "t=+0.500,+0.000,-1.000.ply")],
)  # fmt: skip
def test_files_are_named_by_their_time(time, name):
    assert file_name(time) == name


def test_frames_are_the_surfaces_at_their_times_until_they_vanish(tmp_path):
    """A sphere r = 1 - t, in units of its own."""
    field = Explicit(
        lambda x, t: torch.linalg.vector_norm(x, dim=1) - 10 * (1 - t[:, 0]), 3, 1,
        box=Box((-12.0,) * 3, (12.0,) * 3, ((0.0, 2.0),)),
    )  # fmt: skip
    seen = []
    frames = write_frames(field, [0.0, 0.5, 1.5], tmp_path, resolution=48, title="a sphere", on_frame=seen.append)
    assert frames == seen
    assert sorted(p.name for p in tmp_path.iterdir()) == ["frames.png", "t=+0.000.ply", "t=+0.500.ply"]
    for frame, radius in zip(frames[:2], (10.0, 5.0), strict=True):
        mesh = Mesh.read(tmp_path / frame.file)
        assert mesh.is_watertight and abs(mesh.area / (4 * math.pi * radius**2) - 1) < 0.02
        assert frame.report()["components"] == 1 and abs(frame.report()["volume"] - mesh.volume) < 1e-2
    assert frames[2].report() == {"time": 1.5, "file": None, "vanished": True}


def test_frames_at_several_parameters_stand_in_rows(tmp_path):
    """A circle of radius 2 s that has moved by t, in the plane."""
    field = Explicit(
        lambda x, t: torch.linalg.vector_norm(x - t[:, 1:] * x.new_tensor([1.0, 0.0]), dim=1) - 2 * t[:, 0], 2, 2,
        box=Box((-3.0, -3.0), (4.0, 3.0), ((0.0, 1.0), (0.0, 1.0))),
    )  # fmt: skip
    frames = write_frames(field, [(0.5, 0.0), (0.5, 1.0), (1.0, 0.0)], tmp_path, resolution=24, columns=[1, 2])
    assert [frame.file for frame in frames] == ["t=+0.500,+0.000.ply", "t=+0.500,+1.000.ply", "t=+1.000,+0.000.ply"]
    assert frames[1].mesh.box.center == pytest.approx((1.0, 0.0), abs=0.01)
    assert frames[2].report()["time"] == (1.0, 0.0)
