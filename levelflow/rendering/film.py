"""Films: a surface in time, turned around, or both; and how pictures become an MP4, WebM or GIF file."""

from __future__ import annotations

import io
import itertools
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from levelflow.extraction import EmptyLevelSet, ExtractionWarning, extract
from levelflow.fields import Field
from levelflow.rendering.camera import Camera, Vector
from levelflow.rendering.colours import Scale
from levelflow.rendering.images import image
from levelflow.rendering.quantities import Quantity
from levelflow.rendering.shading import Clay, Normals
from levelflow.shapes.mesh import Mesh
from levelflow.shapes.writing import replace_file

FORMATS = (".mp4", ".webm", ".gif")
# The camera is placed, and the colours are scaled, by meshes of this resolution of all frames.
_COARSE = 48
# The circles that points run through are drawn with this many corners, and one for each of this many heights.
_CORNERS, _HEIGHTS = 72, 48
_CODECS = {".mp4": "libx264", ".webm": "libvpx-vp9"}
_COLOUR_SPACE = ["-vf", "scale=out_color_matrix=bt709:out_range=tv", "-colorspace", "bt709", "-color_primaries",
                 "bt709", "-color_trc", "bt709", "-color_range", "tv"]  # fmt: skip


def film(
    surface: Field | Mesh,
    path: str | Path,
    *,
    times: Sequence[float] = (),
    turn: float = 0.0,
    frames: int = 60,
    azimuth: float = 30.0,
    elevation: float = 15.0,
    up: Vector = (0.0, 1.0, 0.0),
    size: int | tuple[int, int] = 512,
    material: Clay | Normals = Clay(),  # noqa: B008
    values: Callable[[float], Quantity] | Quantity | Float[np.ndarray, " n"] | None = None,
    rate: float = 25.0,
    quality: float = 7.0,
    bounce: bool = False,
    resolution: int = 128,
    on_frame: Callable[[int, int], None] | None = None,
) -> int:
    """Writes a film of a surface under a camera that keeps its distance: it frames the surface of all frames.

    Args:
        surface: A mesh, a static field, or a field of space and one time.
        path: An .mp4 or .webm file (with the extra `levelflow[film]`), or a .gif.
        times: When, a frame for each; needed for a field that moves. A frame in which the surface has vanished is bare.
        turn: By how many degrees the camera goes around the surface in the course of the film.
        frames: How many frames a surface that stands still has.
        azimuth: Where the camera starts, as in `Camera.around`.
        elevation: The angle above the horizon.
        up: The direction that points up.
        size: Pixels, or (height, width).
        material: The colours.
        values: Numbers shown by colours: a quantity, or one number for each vertex of a mesh; for a field that moves,
            a function from the time to the quantity. The scale is that of all frames.
        rate: Frames a second.
        quality: From 0 to 10, for .mp4 and .webm.
        bounce: Whether the film then runs backwards to its start.
        resolution: Marching-cubes cells along the longest side of the box.
        on_frame: Called after each frame with its number, from 1, and the number of all.

    Returns:
        The number of frames in the file.

    Raises:
        ValueError: If the format is not known, there are no frames, or times do not fit the field.
        EmptyLevelSet: If there is a surface in no frame.
        ModuleNotFoundError: If the extra that the format needs is not installed.
    """
    if frames < 1:
        raise ValueError(f"film(frames={frames}): a film has at least one frame.")
    moves = isinstance(surface, Field) and surface.times > 0
    if moves and not times:
        raise ValueError("film(f): the field moves; give the times of the frames, or a slice: `film(f.at(t), ...)`.")
    if times and not moves:
        raise ValueError("film(times=...): the surface does not depend on time; give the number of `frames` instead.")
    if moves and isinstance(values, Quantity | np.ndarray):
        raise ValueError(
            "film(values=...): the field moves; give a function of the time, `lambda t: Curvature(f.at(t))`."
        )
    _require(path, rate, quality)
    count = len(times) if moves else frames
    with warnings.catch_warnings():
        # That a surface meets its box is said when the frames themselves are made.
        warnings.simplefilter("ignore", ExtractionWarning)
        drafts = list(zip(times or (0.0,), _meshes(surface, times or (0.0,), _COARSE), strict=True))
    seen = {t: mesh for t, mesh in drafts if mesh is not None}
    if not seen:
        raise EmptyLevelSet("film(f): there is no surface at any of the times: it has vanished, or left its box.")
    points = np.concatenate([mesh.vertices for mesh in seen.values()])
    cameras = orbit(points, count, turn, azimuth=azimuth, elevation=elevation, up=up)
    scale = None if values is None else _scale(seen, values)

    def pictures() -> Iterator[np.ndarray]:
        meshes = _meshes(surface, times, resolution) if moves else itertools.repeat(still)
        for number, (camera, mesh) in enumerate(zip(cameras, meshes, strict=False)):
            if mesh is None:
                height, width = (size, size) if isinstance(size, int) else size
                yield np.full((height, width, 3), np.round(255 * np.array(material.ground)), np.uint8)
            else:
                shown = values(times[number]) if callable(values) else values
                yield image(mesh, camera, size=size, material=material, values=shown, scale=scale)
            if on_frame is not None:
                on_frame(number + 1, count)

    still = None if moves else next(_meshes(surface, (0.0,), resolution))
    return write_film(pictures(), path, rate=rate, quality=quality, bounce=bounce)


def orbit(
    points: Float[np.ndarray, "n d"],
    count: int,
    turn: float,
    *,
    azimuth: float = 30.0,
    elevation: float = 15.0,
    up: Vector = (0.0, 1.0, 0.0),
) -> list[Camera]:
    """Cameras around points, all at one distance, that see the points from everywhere; one camera if there is no turn.

    A turn by whole circles does not repeat its first camera at the end, so that the film can be played in a loop.
    """
    if not turn or points.shape[1] == 2:
        return [Camera.around(points, azimuth, elevation, up=up)] * count
    swept = _swept(points, np.array(up, dtype=np.float64))
    last = count if turn % 360 == 0 else max(count - 1, 1)
    # A surface of revolution looks the same from everywhere, but for what rounding and corners of circles do.
    first = Camera.around(swept, azimuth, elevation, up=up)
    distance = float(np.linalg.norm(np.subtract(first.eye, first.target)))
    cameras = []
    for k in range(count):
        direction = Camera.around(swept, azimuth + turn * k / last, elevation, up=up).axes[2]
        x, y, z = (np.array(first.target) + distance * direction).tolist()
        cameras.append(Camera((x, y, z), first.target, up))
    return cameras


def write_film(
    pictures: Iterable[UInt8[np.ndarray, "h w 3"]],
    path: str | Path,
    *,
    rate: float = 25.0,
    quality: float = 7.0,
    bounce: bool = False,
) -> int:
    """Writes pictures of one size as a film; the file appears whole or not at all.

    MP4 and WebM need an even number of rows and columns: the last row or column is repeated where it must be.

    Returns:
        The number of frames in the file.

    Raises:
        ValueError: If the format is not known, the rate or quality makes no sense, there are no pictures, or their
            sizes differ.
        ModuleNotFoundError: If the extra that the format needs is not installed.
    """
    path = Path(path)
    _require(path, rate, quality)
    frames = _checked(pictures)
    if bounce:
        there = list(frames)
        frames = iter(there + there[-2:0:-1])
    first = next(frames, None)
    if first is None:
        raise ValueError(f"write_film({path.name!r}): there are no pictures.")
    counted = itertools.count()
    every = (frame for frame, _ in zip(itertools.chain([first], frames), counted, strict=False))
    suffix = path.suffix.lower()
    data = _gif(every, rate) if suffix == ".gif" else _video(every, first.shape[:2], suffix, rate, quality)
    replace_file(path, data)
    return next(counted)


def _meshes(surface: Field | Mesh, times: Sequence[float], resolution: int) -> Iterator[Mesh | None]:
    for t in times:
        if isinstance(surface, Mesh):
            yield surface
            continue
        try:
            yield extract(surface.at(t) if surface.times else surface, resolution=resolution)
        except EmptyLevelSet:
            yield None


def _scale(meshes: Mapping[float, Mesh], values: Callable[[float], Quantity] | Quantity | np.ndarray) -> Scale:
    """The scale of the colours of all frames."""
    if isinstance(values, np.ndarray):
        return Scale.of(values, signed=True)
    quantities = {t: values if isinstance(values, Quantity) else values(t) for t in meshes}
    one = next(iter(quantities.values()))
    numbers = np.concatenate([quantities[t].at(mesh.vertices) for t, mesh in meshes.items()])
    return Scale.of(numbers, signed=one.signed, label=one.label)


def _swept(points: np.ndarray, up: np.ndarray) -> np.ndarray:
    """The circles that the outermost points at each height run through around the axis in the middle of the box."""
    axis = up / np.linalg.norm(up)
    center = (points.min(0) + points.max(0)) / 2
    height = (points - center) @ axis
    radius = np.linalg.norm(points - center - height[:, None] * axis, axis=1)
    low, high = height.min(), height.max()
    bins = ((height - low) / max(high - low, 1e-300) * _HEIGHTS).astype(np.int64).clip(max=_HEIGHTS - 1)
    widest = np.zeros(_HEIGHTS)
    np.maximum.at(widest, bins, radius)
    across = np.linalg.svd(axis[None])[2][1:]
    angle = np.linspace(0, 2 * np.pi, _CORNERS, endpoint=False)
    circle = np.cos(angle)[:, None] * across[0] + np.sin(angle)[:, None] * across[1]
    filled = np.unique(bins)
    edges = low + (high - low) * np.stack([filled, filled + 1]).reshape(-1) / _HEIGHTS
    rings = np.tile(widest[filled], 2)[:, None, None] * circle + edges[:, None, None] * axis
    return center + rings.reshape(-1, 3)


def _require(path: str | Path, rate: float, quality: float) -> None:
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise ValueError(f"film {path.name!r}: known formats are {', '.join(FORMATS)}.")
    if not 0 < rate <= 240:
        raise ValueError(f"film(rate={rate:g}): give frames a second, above 0 and up to 240.")
    if not 0 <= quality <= 10:
        raise ValueError(f"film(quality={quality:g}): give a number from 0, small files, to 10, fine ones.")
    if path.suffix.lower() != ".gif":
        _ffmpeg(path.suffix.lower())


def _checked(pictures: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    size = None
    for picture in pictures:
        size = size or picture.shape
        if picture.shape != size:
            raise ValueError(f"write_film: a picture has the size {picture.shape[:2]}, the first {size[:2]}; keep one.")
        yield picture


def _gif(frames: Iterable[np.ndarray], rate: float) -> bytes:
    from PIL import Image

    first, *rest = (Image.fromarray(frame).quantize(256, Image.Quantize.MEDIANCUT) for frame in frames)
    data = io.BytesIO()
    first.save(data, "GIF", save_all=True, append_images=rest, duration=max(round(1000 / rate), 20), loop=0)
    return data.getvalue()


def _video(frames: Iterable[np.ndarray], shape: tuple[int, ...], suffix: str, rate: float, quality: float) -> bytes:
    height, width = shape
    more = ["-crf", str(round(60 - 5 * quality)), "-b:v", "0", "-row-mt", "1"] if suffix == ".webm" else []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"film{suffix}"
        writer = _ffmpeg(suffix).write_frames(
            str(file),
            (width + width % 2, height + height % 2),
            fps=rate,
            codec=_CODECS[suffix],
            quality=None if more else quality,
            macro_block_size=2,
            ffmpeg_log_level="error",
            output_params=[*more, *_COLOUR_SPACE],
        )
        writer.send(None)
        try:
            for frame in frames:
                even = np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
                writer.send(np.ascontiguousarray(even))
        finally:
            writer.close()
        return file.read_bytes()


def _ffmpeg(suffix: str):  # type: ignore[no-untyped-def]
    """The module that holds ffmpeg."""
    try:
        import imageio_ffmpeg
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            f"film: {suffix} files need ffmpeg, which comes with `pip install 'levelflow[film]'`; a .gif needs nothing."
        ) from None
    return imageio_ffmpeg
