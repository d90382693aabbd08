"""Films, read back: how many frames of which size, and what is seen in them."""

import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from levelflow.boxes import Box
from levelflow.extraction import EmptyLevelSet, extract
from levelflow.fields import Field
from levelflow.rendering.colours import bar_width
from levelflow.rendering.film import film, orbit, write_film
from levelflow.rendering.quantities import Curvature
from levelflow.rendering.shading import Clay
from levelflow.shapes.analytic import Sphere
from levelflow.shapes.mesh import Mesh
from tests.fields import Explicit

CUBE = Box((-1, -1, -1), (1, 1, 1))
GROUND = np.round(255 * np.array(Clay().ground))
OFF = extract(Sphere(0.3, center=(0.5, 0, 0)).distance, resolution=16, box=CUBE)
FORMATS = (".mp4", ".webm", ".gif")
# imageio-ffmpeg leaves it to the garbage collector to close its pipes.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning", "ignore::ResourceWarning")


def shrinking() -> Field:
    """A sphere of radius 0.8 - t."""
    return Explicit(lambda x, t: torch.linalg.vector_norm(x, dim=1) - 0.8 + t[:, 0], 3, 1, box=CUBE.during((0, 1)))


def frames_of(path: Path) -> np.ndarray:
    """All frames, (n, h, w, 3)."""
    if path.suffix == ".gif":
        from PIL import Image, ImageSequence

        with Image.open(path) as file:
            return np.stack([np.array(frame.convert("RGB")) for frame in ImageSequence.Iterator(file)])
    import imageio_ffmpeg

    reader = imageio_ffmpeg.read_frames(str(path))
    width, height = next(reader)["size"]
    return np.stack([np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader])


def covered(frame: np.ndarray) -> int:
    return int((np.abs(frame.astype(int) - GROUND).max(1 + (frame.ndim - 2)) > 40).sum())


@pytest.mark.parametrize("suffix", FORMATS)
def test_the_frames_are_those_that_were_written(tmp_path: Path, suffix: str) -> None:
    shades = [np.full((48, 64, 3), value, np.uint8) for value in (20, 90, 160, 230)]
    path = tmp_path / f"x{suffix}"
    assert write_film(iter(shades), path, rate=10) == 4
    read = frames_of(path)
    assert read.shape == (4, 48, 64, 3)
    assert np.abs(read.mean((1, 2, 3)) - [20, 90, 160, 230]).max() < 4
    assert write_film(shades, path, rate=10, bounce=True) == 6
    assert np.abs(frames_of(path).mean((1, 2, 3)) - [20, 90, 160, 230, 160, 90]).max() < 4
    assert list(tmp_path.iterdir()) == [path]


def test_colours_survive_and_odd_sizes_become_even(tmp_path: Path) -> None:
    picture = np.zeros((31, 47, 3), np.uint8)
    picture[:, :24], picture[:, 24:] = (200, 60, 40), (30, 90, 180)
    write_film([picture] * 3, tmp_path / "x.mp4", quality=9)
    read = frames_of(tmp_path / "x.mp4")
    assert read.shape == (3, 32, 48, 3)
    assert np.abs(read[1, 16, 10].astype(int) - [200, 60, 40]).max() < 12
    assert np.abs(read[1, 16, 38].astype(int) - [30, 90, 180]).max() < 12


def test_a_surface_in_time_keeps_its_place_and_shrinks_and_vanishes(tmp_path: Path) -> None:
    said: list[tuple[int, int]] = []
    times = [0.0, 0.2, 0.4, 0.9]
    count = film(
        shrinking(), tmp_path / "x.gif", times=times, size=64, resolution=24,
        on_frame=lambda number, of: said.append((number, of)),
    )  # fmt: skip
    read = frames_of(tmp_path / "x.gif")
    assert count == len(read) == 4
    assert said == [(1, 4), (2, 4), (3, 4), (4, 4)]
    areas = [covered(frame) for frame in read]
    for area, radius in zip(areas[:3], (0.8, 0.6, 0.4), strict=True):
        assert area / areas[0] == pytest.approx((radius / 0.8) ** 2, rel=0.1)
    assert areas[3] == 0


def test_a_turn_goes_around_and_closes(tmp_path: Path) -> None:
    film(OFF, tmp_path / "x.gif", turn=360, frames=4, azimuth=0, size=48)
    pair = Mesh(
        np.concatenate([OFF.vertices, OFF.vertices * [-0.5, 0.5, 0.5]]),
        np.concatenate([OFF.faces, OFF.faces[:, ::-1] + len(OFF.vertices)]),
    )
    film(pair, tmp_path / "x.gif", turn=360, frames=4, azimuth=0, elevation=0, size=64)
    read = frames_of(tmp_path / "x.gif")
    assert len(read) == 4
    columns = [np.flatnonzero(np.abs(frame.astype(int) - GROUND).max(2).max(0) > 40).mean() for frame in read]
    # The greater ball is on the right, then near, on the left, and far.
    large = [covered(frame[:, 32:]) - covered(frame[:, :32]) for frame in read]
    assert large[0] > 100
    assert large[2] < -100
    assert abs(large[1]) < 40
    assert columns[1] == pytest.approx(31.5, abs=2)


def test_cameras_of_an_orbit_keep_their_distance_and_see_everything() -> None:
    points = np.random.default_rng(0).normal(size=(500, 3)) * [3, 1, 1] + [10, 0, 0]
    for up in ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 1.0, 0.0)):
        cameras = orbit(points, 12, 360.0, up=up)
        target = np.array(cameras[0].target)
        distances = [np.linalg.norm(np.array(camera.eye) - target) for camera in cameras]
        assert np.ptp(distances) < 1e-9 * distances[0]
        for camera in cameras:
            seen = camera.project(points, height=100, width=100)
            assert seen[:, :2].min() >= 0
            assert seen[:, :2].max() <= 100
        angles = [cameras[0].axes[2] @ camera.axes[2] for camera in cameras]
        assert angles[6] == pytest.approx(min(angles))
        assert angles[11] == pytest.approx(angles[1])
    half = orbit(points, 3, 180.0, elevation=0.0)
    assert np.allclose(half[0].axes[2], -half[2].axes[2])
    assert len({camera.eye for camera in orbit(points, 5, 0.0)}) == 1


def test_colours_have_one_scale_in_all_frames(tmp_path: Path) -> None:
    field = shrinking()
    film(
        field, tmp_path / "x.gif", times=[0.0, 0.5], size=(96, 160), resolution=24,
        values=lambda t: Curvature(field.at(t)),
    )  # fmt: skip
    middle = (160 - bar_width(96)) // 2
    first, last = (frame[48, middle].astype(int) for frame in frames_of(tmp_path / "x.gif"))
    # Curvature grows from 2.5 to 6.7: the red deepens.
    assert last[1] < first[1] - 25
    still = extract(field.at(0.0), resolution=24)
    assert film(still, tmp_path / "y.gif", frames=2, turn=90, size=96, values=still.vertices[:, 0].copy()) == 2
    quantity = Curvature(field.at(0.0))
    assert film(field.at(0.0), tmp_path / "z.gif", frames=2, turn=90, size=96, resolution=16, values=quantity) == 2


def test_a_film_is_whole_or_not_there(tmp_path: Path) -> None:
    def failing():
        yield np.zeros((32, 32, 3), np.uint8)
        raise KeyboardInterrupt

    for suffix in FORMATS:
        with pytest.raises(KeyboardInterrupt):
            write_film(failing(), tmp_path / f"x{suffix}")
    assert list(tmp_path.iterdir()) == []


def test_films_that_cannot_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, field = tmp_path / "x.gif", shrinking()
    with pytest.raises(ValueError, match="known formats are .mp4, .webm, .gif"):
        write_film([], tmp_path / "x.avi")
    with pytest.raises(ValueError, match="no pictures"):
        write_film([], path)
    with pytest.raises(ValueError, match="frames a second"):
        write_film([], path, rate=0)
    with pytest.raises(ValueError, match="from 0, small files"):
        write_film([], path, quality=11)
    with pytest.raises(ValueError, match=r"the size \(4, 4\), the first \(8, 8\)"):
        write_film([np.zeros((8, 8, 3), np.uint8), np.zeros((4, 4, 3), np.uint8)], path)
    with pytest.raises(ValueError, match="at least one frame"):
        film(OFF, path, frames=0)
    with pytest.raises(ValueError, match="give the times of the frames"):
        film(field, path)
    with pytest.raises(ValueError, match="does not depend on time"):
        film(OFF, path, times=[0.0, 1.0])
    with pytest.raises(ValueError, match="give a function of the time"):
        film(field, path, times=[0.0], values=Curvature(field.at(0.0)))
    with pytest.raises(EmptyLevelSet, match="at any of the times"):
        film(field, path, times=[0.9, 1.0])
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(ModuleNotFoundError, match=r"levelflow\[film\]"):
        film(OFF, tmp_path / "x.mp4")
