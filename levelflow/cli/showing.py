"""The commands that show surfaces: a picture, a film."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from levelflow.cli.names import key_named, motion_in_words, numbers_in, place_in, times_in, walk_example, walk_in

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

    from levelflow.fields import Field
    from levelflow.rendering.camera import Vector
    from levelflow.rendering.quantities import Quantity
    from levelflow.shapes import Mesh

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_COLOURS = ("clay", "normal", "curvature", "residual")
_PLAIN = ("clay", "normal")
_PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")

Surface = Annotated[str, typer.Argument(metavar="FIELD|MESH", help="A field (.safetensors), a mesh, or a built-in.")]
Time = Annotated[
    str | None, typer.Option("--time", help="When, for a field that moves: 0.5, or 0.5,0.2 for two parameters.")
]
Size = Annotated[str, typer.Option(help="Pixels, 512, or width x height, 1280x720.")]
ColourBy = Annotated[
    str, typer.Option("--colour", "--color", help="clay, normal, curvature (k1 + k2), residual (error of the speed).")
]
Azimuth = Annotated[float, typer.Option(help="Degrees around the upright axis; 90 looks at the side that faces +x.")]
Elevation = Annotated[float, typer.Option(help="Degrees above the horizon.")]
Up = Annotated[str, typer.Option(help="What points up: x, y, z, or x,y,z numbers.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but warnings and errors.")]
Cells = Annotated[int, typer.Option("--resolution", help="Marching-cubes cells along the longest side.")]


def render(
    surface: Surface,
    output: Annotated[Path, typer.Option("--output", "-o", help="The picture to write: .png, .jpg, .webp, ...")],
    time: Time = None,
    size: Size = "512",
    colour: ColourBy = "clay",
    azimuth: Azimuth = 30.0,
    elevation: Elevation = 15.0,
    up: Up = "y",
    by: Annotated[
        str | None,
        typer.Option(help="trace: rays meet the field itself; mesh: by marching cubes. Fields are traced by default."),
    ] = None,
    resolution: Cells = 160,
    quiet: Quiet = False,
) -> None:
    """Draw a picture of a surface."""
    from levelflow.fields import Field
    from levelflow.rendering.camera import Camera
    from levelflow.rendering.images import image, write
    from levelflow.rendering.shading import Clay, Normals
    from levelflow.rendering.tracing import framed

    if output.suffix.lower() not in _PICTURES:
        raise ValueError(f"render -o {output}: known formats are {', '.join(_PICTURES)}.")
    if by not in (None, "trace", "mesh"):
        raise ValueError(f"render --by {by}: give trace or mesh.")
    _require_colour("render", colour)
    shape, where = _size_in(size), {"azimuth": azimuth, "elevation": _elevation(elevation), "up": _up_named(up)}
    shown = _surface_named("render", surface)
    place = _place("render", surface, shown, time)
    now = _at(shown, place)
    if by == "trace" and not isinstance(now, Field):
        raise ValueError(f"render {surface} --by trace: this is a mesh; fit a field first, or leave --by out.")
    drawn = _mesh_of(now, resolution) if isinstance(now, Field) and (by == "mesh" or now.space == 2) else now
    values = _values("render", surface, colour, shown, place)
    camera = (
        framed(drawn, **where) if isinstance(drawn, Field) else Camera.around(drawn.vertices, **where)  # type: ignore[arg-type]
    )
    picture = image(drawn, camera, size=shape, material=Normals() if colour == "normal" else Clay(), values=values)
    write(picture, output)
    if not quiet:
        typer.echo(f"{output}: {shape[1]} x {shape[0]} pixels")


def film(
    surface: Surface,
    output: Annotated[Path, typer.Option("--output", "-o", help="The film to write: .mp4, .webm or .gif.")],
    times: Annotated[
        str | None, typer.Option(help="first:last:number, 0:1:60, or 0,0.5,1; all of the field by default.")
    ] = None,
    time: Annotated[
        str | None,
        typer.Option(
            "--time", help="A single time, or one number for each parameter, to turn around what stands still."
        ),
    ] = None,
    path: Annotated[
        str | None, typer.Option("--path", help="0,0:1,0:1,1, corners of a walk through the parameters of a field.")
    ] = None,
    turntable: Annotated[
        float, typer.Option(help="Degrees that the camera goes around in the course of the film.")
    ] = 0.0,
    frames: Annotated[int, typer.Option(help="How many, where --times does not say it.")] = 60,
    fps: Annotated[float, typer.Option(help="Frames a second.")] = 25.0,
    size: Size = "512",
    quality: Annotated[float, typer.Option(help="0 to 10, of .mp4 and .webm.")] = 7.0,
    bounce: Annotated[bool, typer.Option("--bounce", help="Run back to the start as well.")] = False,
    colour: ColourBy = "clay",
    azimuth: Azimuth = 30.0,
    elevation: Elevation = 15.0,
    up: Up = "y",
    resolution: Cells = 128,
    quiet: Quiet = False,
) -> None:
    """Make a film of a surface: in time, turned around, or both."""
    from levelflow.fields import Field
    from levelflow.rendering.film import film as make_film
    from levelflow.rendering.shading import Clay, Normals

    _require_colour("film", colour)
    shape, vertical = _size_in(size), _up_named(up)
    whole = _surface_named("film", surface)
    if path is not None and (times is not None or time is not None):
        raise ValueError(f"film {surface} --path {path}: the walk says when; leave --times and --time out.")
    if path is not None and not isinstance(whole, Field):
        raise ValueError(f"film {surface} --path {path}: a shape has no parameters; leave --path out.")
    still = path is None and (time is not None or not isinstance(whole, Field) or not whole.times)
    asked: list[float] = []
    shown: Field | Mesh
    values: Quantity | np.ndarray | Callable[[float], Quantity] | None
    if still:
        if times is not None:
            raise ValueError(f"film {surface} --times {times}: the surface stands still; leave --times out, or --time.")
        place = _place("film", surface, whole, time)
        if not turntable:
            raise ValueError(f"film {surface}: the surface stands still; turn it around with --turntable 360.")
        shown, values = _at(whole, place), _values("film", surface, colour, whole, place)
    else:
        assert isinstance(whole, Field)
        shown = moving = _moving("film", surface, whole, path)
        first, last = moving.box.times[0]  # type: ignore[union-attr]
        values = None if colour in _PLAIN else partial(_quantity_at, "film", surface, colour, moving)
        # The last frame of a loop is the one before its first.
        end = last - (last - first) / max(frames, 1) if moving.loops else last
        asked = times_in(times or f"{first!r}:{end!r}:{frames}")
    count = make_film(
        shown, output, times=asked, turn=turntable, frames=frames, azimuth=azimuth, elevation=_elevation(elevation),
        up=vertical, size=shape, material=Normals() if colour == "normal" else Clay(), values=values, rate=fps,
        quality=quality, bounce=bounce, resolution=resolution,
    )  # fmt: skip
    if not quiet:
        typer.echo(f"{output}: {count} frames of {shape[1]} x {shape[0]} pixels, {count / fps:.3g} s")


def _surface_named(call: str, text: str) -> Field | Mesh:
    """A field or a mesh."""
    from levelflow.fields import Field
    from levelflow.shapes import Mesh, Solid

    shown: object
    if text.endswith(".safetensors"):
        from levelflow.saving import load

        shown = load(text)
    else:
        shown = key_named(text)
    if isinstance(shown, Field | Mesh):
        return shown
    if isinstance(shown, Solid):
        from levelflow.extraction import extract

        return extract(shown.distance, resolution=128, box=shown.box.expanded(0.05 * max(shown.box.size)), refine=2)
    raise ValueError(
        f"{call} {text}: a point cloud has no surface to be seen; fit a field first: levelflow fit {text} -o ..."
    )


def _place(call: str, text: str, shown: Field | Mesh, time: str | None) -> tuple[float, ...]:
    """The time or parameters at which a surface is shown; none for one that stands still."""
    from levelflow.fields import Field

    if isinstance(shown, Field):
        return place_in(time, shown, f"{call} {text}")
    if time is not None:
        raise ValueError(f"{call} {text} --time {time}: a shape has no time; leave --time out.")
    return ()


def _at(shown: Field | Mesh, place: tuple[float, ...]) -> Field | Mesh:
    """The surface at a time."""
    from levelflow.fields import Field

    return shown.at(*place) if isinstance(shown, Field) and place else shown


def _moving(call: str, text: str, field: Field, path: str | None) -> Field:
    """The field of one time that a film shows: itself, or a walk through its parameters."""
    if path is not None:
        return walk_in(path, field, f"{call} {text}")
    if field.times > 1:
        raise ValueError(
            f"{call} {text}: {motion_in_words(field)}; say how to walk through them, corner after corner, such as "
            f"--path {walk_example(field)}, or where to stop, with --time and --turntable."
        )
    return field


def _values(
    call: str, text: str, colour: str, shown: Field | Mesh, place: tuple[float, ...]
) -> Quantity | np.ndarray | None:
    """The numbers that colours stand for, at a time if the surface moves; none if there are none."""
    from levelflow.fields import Field
    from levelflow.rendering.quantities import mesh_curvature

    if colour in _PLAIN:
        return None
    if isinstance(shown, Field):
        return _quantity(call, text, colour, shown, place)
    if colour == "residual":
        raise ValueError(f"{call} {text} --colour residual: a mesh solves no equation; give a field that moves.")
    return mesh_curvature(shown)


def _quantity(call: str, text: str, colour: str, field: Field, place: tuple[float, ...]) -> Quantity:
    """What of a field is shown by colours."""
    from levelflow.equations.described import equation_of
    from levelflow.rendering.quantities import Curvature, Residual
    from levelflow.retimed import Retimed

    if colour == "curvature":
        return Curvature(field.at(*place) if place else field)
    if isinstance(field, Retimed) and place:
        return _quantity(call, text, colour, field.field, (field.moment(place[0]),))
    provenance = getattr(field, "provenance", {})
    equation = equation_of(provenance)
    if not place:
        raise ValueError(
            f"{call} {text} --colour residual: the field stands still and has no motion to be right about."
        )
    if equation is None:
        known = provenance.get("equation", "none")
        raise ValueError(
            f"{call} {text} --colour residual: the equation of this field, {known}, cannot be told from its file; "
            "it must consist of numbers, as mean curvature does. In Python: Residual(field, equation, (t,))."
        )
    return Residual(field, equation, place)


def _quantity_at(call: str, text: str, colour: str, field: Field, time: float) -> Quantity:
    """The same of a field that moves, or that is walked through, at a time."""
    from levelflow.fields import Walk

    if isinstance(field, Walk):
        return _quantity(call, text, colour, field.field, field.place(time))
    return _quantity(call, text, colour, field, (time,))


def _mesh_of(field: Field, resolution: int) -> Mesh:
    from levelflow.extraction import extract

    return extract(field, resolution=resolution)


def _require_colour(call: str, colour: str) -> None:
    if colour not in _COLOURS:
        raise ValueError(f"{call} --colour {colour}: known are {', '.join(_COLOURS)}.")


def _size_in(text: str) -> tuple[int, int]:
    """(height, width) of `512` or `1280x720`."""
    parts = text.lower().split("x")
    if len(parts) > 2 or not all(part.strip().isdecimal() and 1 <= int(part) <= 8192 for part in parts):
        raise ValueError(f"--size {text}: give pixels, 512, or width x height, 1280x720, up to 8192.")
    return int(parts[-1]), int(parts[0])


def _elevation(degrees: float) -> float:
    if not -90 < degrees < 90:
        raise ValueError(f"--elevation {degrees:g}: give degrees between -90 and 90.")
    return degrees


def _up_named(text: str) -> Vector:
    if text.lstrip("+-") in _AXES:
        x, y, z = (value * (-1 if text.startswith("-") else 1) + 0.0 for value in _AXES[text.lstrip("+-")])
        return x, y, z
    direction = numbers_in(text, "--up")
    if len(direction) != 3 or not any(direction):
        raise ValueError(f"--up {text}: give x, y or z, or three numbers that are not all zero.")
    return direction
