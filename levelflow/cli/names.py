"""What the strings of the command line stand for: shapes, velocity fields, times, devices."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import torch

    from levelflow.boxes import Box
    from levelflow.conditions import Key
    from levelflow.equations import VelocityField
    from levelflow.fields import Field, Walk
    from levelflow.shapes import Shape, Solid

_BUILTINS: dict[str, Callable[[Any], Solid]] = {
    "sphere": lambda shapes: shapes.Sphere(0.5),
    "cuboid": lambda shapes: shapes.Cuboid((1.0, 1.0, 1.0)),
    "rounded-cuboid": lambda shapes: shapes.Cuboid((1.0, 1.0, 1.0), radius=0.15),
    "torus": lambda shapes: shapes.Torus(0.5, 0.2),
    "cylinder": lambda shapes: shapes.Cylinder(0.3, 1.0),
    "capsule": lambda shapes: shapes.Capsule(0.3, 0.8),
    "dumbbell": lambda shapes: shapes.Rotated(shapes.Dumbbell(0.3, 1.0, 0.12), math.pi / 2, (0.0, 1.0, 0.0)),
}
"""Built-in shapes, made from the module `levelflow.shapes`, which is loaded when one of them is asked for."""

BUILTINS = tuple(_BUILTINS)


def key_named(text: str) -> Key:
    """The shape or static field that an argument names."""
    from levelflow.shapes import Mesh, PointCloud
    from levelflow.shapes.reading import read_contents

    if text in BUILTINS:
        return builtin(text)
    path = Path(text)
    suffix = path.suffix.lower()
    if not path.exists() and not suffix:
        raise FileNotFoundError(f"{text!r} is neither a file nor a built-in shape ({', '.join(BUILTINS)}).")
    if suffix == ".safetensors":
        from levelflow.saving import load

        field = load(path)
        if field.times:
            raise ValueError(
                f"{text}: the field moves; write its surface at one time first: levelflow mesh {text} --time T"
            )
        return field
    if suffix in (".xyz", ".txt", ".csv", ".npy") or (
        suffix == ".ply" and not len(read_contents(path, call="levelflow", formats=(".ply",)).sizes)
    ):
        return PointCloud.read(path)
    return Mesh.read(path)


def solid_named(text: str) -> Solid | Field:
    """A shape with an inside, or a static field."""
    from levelflow.fields import Field
    from levelflow.shapes import Solid

    key = key_named(text)
    if isinstance(key, Solid | Field):
        return key
    raise ValueError(f"{text} is a point cloud, which has no inside; fit a field first: levelflow fit {text} -o ...")


def surface_named(text: str) -> Shape:
    """The surface that an argument names."""
    from levelflow.conditions import surface_of

    return surface_of(key_named(text))


def builtin(name: str) -> Solid:
    """A built-in shape, about a unit in size."""
    from levelflow import shapes

    return _BUILTINS[name](shapes)


def velocity_named(
    name: str,
    *,
    by: str | None,
    rate: float | None,
    axis: tuple[float, ...],
    center: tuple[float, ...],
    reach: float | None,
    length: float,
    unit: float,
    option: str = "--",
) -> VelocityField:
    """A velocity field by its name; `length` is the unit of lengths that were given, `unit` that of defaults.

    The number of coordinates is that of `center`; messages put `option` before the names of what was given.
    """
    from levelflow.equations import Constant, Rotation, Source, Twist

    if name == "translation":
        rest = (0.0,) * (len(center) - 1)
        moved = (0.5 * unit, *rest) if by is None else tuple(length * v for v in numbers_in(by, f"{option}by"))
        if len(moved) != len(center):
            raise ValueError(f"{option}by {by}: the shape has {len(center)} coordinates; give as many numbers.")
        return Constant(moved)
    if name == "rotation":
        return Rotation(math.pi / 2 if rate is None else rate, axis, center)
    if name == "twist":
        return Twist(1 / unit if rate is None else rate / length, axis, center)
    if name in ("source", "sink"):
        strength = (1.0 if rate is None else rate) * (1 if name == "source" else -1)
        return Source(center, strength, 0.18**0.5 * unit if reach is None else reach * length)
    raise ValueError(f"--velocity {name}: known are translation, rotation, twist, source and sink.")


def center_in(text: str | None, box: Box, length: float | None, option: str = "--") -> tuple[float, ...]:
    """A point, by default the middle of a box; with a length, in units of it from there."""
    if text is None:
        return box.center
    point = numbers_in(text, f"{option}center")
    if len(point) != box.space:
        raise ValueError(f"{option}center {text}: the shape has {box.space} coordinates; give as many numbers.")
    return point if length is None else tuple(c + length * v for c, v in zip(box.center, point, strict=True))


def device_named(name: str) -> torch.device:
    """A device of PyTorch that is there."""
    import torch

    try:
        device = torch.device(name)
    except RuntimeError:
        raise ValueError(f"--device {name}: there is no such kind of device; give cpu or cuda.") from None
    if device.type == "cuda" and not torch.cuda.is_available():
        raise ValueError(f"--device {name}: PyTorch sees no CUDA device here; leave the option out, or see the README.")
    return device


def times_in(text: str | None) -> list[float]:
    """`0,0.5,1` or `first:last:number`."""
    try:
        if text and ":" in text:
            first, last, number = text.split(":")
            count = int(number)
            values = [float(first) + (float(last) - float(first)) * i / max(1, count - 1) for i in range(count)]
        else:
            values = [float(part) for part in (text or "").split(",")]
    except ValueError:
        values = []
    if not values or not all(math.isfinite(v) for v in values):
        raise ValueError(f"--times {text}: give numbers, 0,0.5,1, or first:last:number, 0:1:5.")
    return sorted({float(f"{v:.12g}") + 0.0 for v in values})


def place_in(text: str | None, field: Field, call: str) -> tuple[float, ...]:
    """The time or parameters of `--time 0.5,0.2`, a number for each; none for a field that stands still.

    Raises:
        ValueError: If there are more or fewer.
    """
    if not field.times:
        if text is not None:
            raise ValueError(f"{call} --time {text}: the field does not depend on time; leave --time out.")
        return ()
    if text is None:
        what = "say when" if field.times == 1 else "give one number for each"
        raise ValueError(f"{call}: {motion_in_words(field)}; {what} with --time {_example(field)}.")
    values = numbers_in(text, "--time")
    if len(values) != field.times:
        raise ValueError(
            f"{call} --time {text}: {motion_in_words(field)}, and {len(values)} number(s) are given; one for each is "
            f"needed, such as --time {_example(field)}."
        )
    _check_shares(field, values, f"{call} --time {text}")
    return values


def walk_in(text: str, field: Field, call: str) -> Walk:
    """The walk through the parameters of a field of `--path 0,0:1,0:1,1`, corner after corner.

    Raises:
        ValueError: If a corner has not one number for each, lies outside their intervals, or there is only one.
    """
    from levelflow.fields import Walk

    if not field.times:
        raise ValueError(f"{call} --path {text}: the field does not depend on time; leave --path out.")
    corners = [numbers_in(part, "--path") for part in text.split(":")]
    if len(corners) < 2 or any(len(corner) != field.times for corner in corners):
        raise ValueError(
            f"{call} --path {text}: {motion_in_words(field)}; give two corners or more with one number for each, such "
            f"as --path {walk_example(field)}."
        )
    for corner in corners:
        _check_shares(field, corner, f"{call} --path {text}")
    return Walk(field, corners)


def walk_example(field: Field) -> str:
    """A walk through the parameters of a field, one after the other, as it is written."""
    ends = field.box.times if field.box is not None else ((0.0, 1.0),) * field.times
    mixed = bool(_shares(field))
    corners = [
        [last if (i == j - 1 if mixed else i < j) else first for i, (first, last) in enumerate(ends)]
        for j in range(len(ends) + 1)
    ]
    return ":".join(",".join(f"{value:g}" for value in corner) for corner in corners)


def motion_in_words(field: Field) -> str:
    """`the field moves from t = 0 to 1`, or `the field has 2 parameters, from 0 to 1 and from -1 to 1`."""
    ends = [f"{first:g} to {last:g}" for first, last in field.box.times] if field.box is not None else []
    if field.times == 1:
        return f"the field moves from t = {', '.join(ends)}"
    return f"the field has {field.times} parameters, from {' and from '.join(ends)}"


def _shares(field: Field) -> tuple[str, ...]:
    """The shapes of which a field holds the mixtures (`levelflow morph --simplex`); its parameters are their shares."""
    names = tuple(getattr(field, "provenance", {}).get("shares", ()))
    return names if len(names) == field.times + 1 else ()


def _check_shares(field: Field, values: Sequence[float], call: str) -> None:
    """Refuses shares that are more than all."""
    names = _shares(field)
    if names and sum(values) > 1 + 1e-9:
        raise ValueError(
            f"{call}: these are the shares of {', '.join(names[1:])}, and their sum is {sum(values):g}; give at most 1 "
            f"together, the rest is the share of {names[0]}."
        )


def _example(field: Field) -> str:
    """The middle of the interval of each parameter, or the same share of each shape."""
    ends = field.box.times if field.box is not None else ((0.0, 1.0),) * field.times
    part = 1 / (len(_shares(field)) or 2)
    return ",".join(f"{first + part * (last - first):.3g}" for first, last in ends)


def numbers_in(text: str, option: str) -> tuple[float, ...]:
    """`0,1,0`."""
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{option} {text}: give numbers with commas between them, such as 0,1,0.") from None


def edge_radius(text: str, *, unit: float, relative: bool) -> float:
    """The radius of the sharpest bends that are no edges: a length in the units of the file, or `auto`."""
    if text == "auto":
        return 0.1 * unit
    try:
        radius = float(text) * (unit if relative else 1.0)
    except ValueError:
        radius = math.nan
    if not radius > 0 or not math.isfinite(radius):
        raise ValueError(
            f"--keep-edges {text}: give the radius of the sharpest bends that are to be smoothed like all others, a "
            f"length such as {0.1 * unit:.3g}, or auto."
        )
    return radius


def box_of(key: Key) -> Box:
    """The box around the surface of a shape or field."""
    from levelflow.conditions import surface_of

    return surface_of(key).box


def half_box(box: Box) -> float:
    """The length that `--relative` counts in: half the longest side of the box that a field for the shape has."""
    from levelflow.conditions import box_around

    return box_around([box]).frame.scale


def warn_of_distance(names: Sequence[str], boxes: Sequence[Box]) -> None:
    """Shapes of very different size or place are morphed as they are; that is seldom meant."""
    first = boxes[0]
    for name, box in zip(names[1:], boxes[1:], strict=True):
        ratio = max(box.size) / max(first.size)
        gap = max(abs(a - b) for a, b in zip(first.center, box.center, strict=True))
        if not 1 / 3 < ratio < 3 or gap > max(*first.size, *box.size):
            warnings.warn(
                f"{name} is {ratio:.3g} times as large as {names[0]} and {gap:.3g} away from it; "
                "shapes are morphed at the size and place that their files say.",
                stacklevel=2,
            )


def fingerprint(text: str) -> str:
    """The name of an input, with the size of its file and a checksum of its bytes."""
    import zlib

    path = Path(text)
    if text in BUILTINS or not path.is_file():
        return text
    return f"{path.name}:{path.stat().st_size}:{zlib.crc32(path.read_bytes()):08x}"
