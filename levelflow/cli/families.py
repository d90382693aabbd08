"""Fields of several parameters: a motion for each of them, or a share of a shape."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from functools import reduce
from operator import add
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from levelflow.cli.names import box_of, center_in, half_box, key_named, numbers_in, velocity_named
from levelflow.cli.options import (
    Depth,
    Device,
    Folder,
    Quiet,
    Relative,
    Resolution,
    Resume,
    Seconds,
    Seed,
    ShapeArgument,
    Steps,
    Width,
)
from levelflow.cli.running import Run, evolve, folder_for

if TYPE_CHECKING:
    from levelflow.boxes import Box
    from levelflow.equations import Equation, LevelSetEquation
    from levelflow.fields import Field
    from levelflow.shapes import Solid

_MOTIONS = {
    "curvature": ("rate",),
    "translation": ("by",),
    "rotation": ("rate", "axis", "center"),
    "twist": ("rate", "axis", "center"),
    "source": ("rate", "center", "reach"),
    "sink": ("rate", "center", "reach"),
}
"""The motions that a parameter can have, and what can be said of each."""


def family(
    shape: ShapeArgument,
    motion: Annotated[
        list[str],
        typer.Option(
            "--motion",
            help='One for each parameter: "translation by=1,0,0", "curvature rate=0.01", "rotation rate=1 axis=0,1,0 '
            'center=0,0,0", "twist ...", "source rate=1 center=0,0,0 reach=0.5", "sink ..."; or a sum, with " + ".',
        ),
    ],
    output: Folder = None,
    until: Annotated[
        str | None,
        typer.Option(
            help="Where each parameter ends, 1,0.5, or from where to where it goes, 0:1,-1:1; by default to 1."
        ),
    ] = None,
    grid: Annotated[
        str | None,
        typer.Option(help="How many values of each parameter are shown, 4,3; by default 5, or 3,3, or the ends."),
    ] = None,
    distil: Annotated[
        bool, typer.Option("--distil", help="Train one network of space and parameters even where nothing needs it.")
    ] = False,
    relative: Relative = False,
    resolution: Resolution = 128,
    steps: Steps = None,
    seconds: Seconds = None,
    seed: Seed = 0,
    device: Device = "cpu",
    quiet: Quiet = False,
    resume: Resume = False,
    width: Width = 128,
    depth: Depth = 3,
) -> None:
    """Move a shape by several motions, each with a parameter of its own: one field for all that they make together.

    Motions by velocities alone carry the field that is fitted to the shape, without training in the parameters; with
    curvature among them one network of space and all parameters is trained. Where the order of two motions matters a
    warning says so.
    """
    from levelflow.equations import Family

    run = Run(steps, seconds, seed, device, quiet, resume, width, depth)
    key = key_named(shape)
    box = box_of(key)
    motions = [motion_named(text, box, relative=relative) for text in motion]
    k = len(motions)
    equation: Equation = motions[0] if k == 1 else Family(*motions)
    ends = intervals_in(until, k)
    counts = _counts_in(grid, k)
    lines = [[a + (b - a) * i / (n - 1) + 0.0 for i in range(n)] for (a, b), n in zip(ends, counts, strict=True)]
    # The first parameter runs along the rows.
    places = [place[::-1] for place in itertools.product(*lines[::-1])]
    names = [_name(text) for text in motion]
    columns = counts[0] if k < 3 else counts[0] * counts[1]
    title = f"right: {names[0]}, down: {names[1]}" if k == 2 else ", ".join(names)
    carried = all(column.has_characteristics(box.space) for column in equation.columns)
    evolve(
        run, "family", [shape], {0.0 if k == 1 else (0.0,) * k: key}, equation,
        [t for (t,) in places] if k == 1 else places, output or folder_for([shape], "family"),
        resolution=resolution, until=None if k == 1 else ends, title=title, columns=columns,
        distil=distil or not carried,
    )  # fmt: skip


def mix(
    run: Run, shapes: Sequence[str], solids: Sequence[Solid | Field], folder: Path, *, grid: int, resolution: int
) -> None:
    """A surface for every mixture of shapes: three over a triangle, four over a tetrahedron, and so on."""
    from levelflow.equations import SimplicialMorph

    k = len(shapes) - 1
    if k < 2:
        raise ValueError(f"morph {' '.join(shapes)} --simplex: two shapes have a line between them; leave it out.")
    if grid < 1:
        raise ValueError(f"morph --grid {grid}: give the steps along a side of the triangle, at least 1.")
    corners = [(0.0,) * k, *(tuple(float(i == j) for j in range(k)) for i in range(k))]
    places, rows = _triangle(grid) if k == 2 else _middles(corners)
    equation = SimplicialMorph(corners, solids)
    names = [Path(shape).stem for shape in shapes]
    title = f"{names[2]} above {names[0]} and {names[1]}" if k == 2 else f"{', '.join(names)}, halves, and all"
    evolve(
        run, "morph", shapes, equation.keys, equation, places, folder, resolution=resolution, title=title,
        columns=rows, notes={"shares": names},
    )  # fmt: skip


def motion_named(text: str, box: Box, *, relative: bool) -> LevelSetEquation:
    """`translation by=1,0,0`, `curvature rate=0.01`, or several with ` + ` between them."""
    return reduce(add, (_one_motion(part.strip(), box, relative=relative) for part in re.split(r"\s\+\s", text)))


def intervals_in(text: str | None, k: int) -> list[tuple[float, float]]:
    """From where to where each parameter goes: `1,0.5` or `0:1,-1:1`; to 1 by default."""
    if text is None:
        return [(0.0, 1.0)] * k
    parts = [["0", part] if ":" not in part else part.split(":") for part in text.split(",")]
    try:
        ends = [(float(a), float(b)) for a, b in parts]
    except ValueError:
        ends = []
    if len(ends) != k or not all(math.isfinite(a) and math.isfinite(b) and a != b for a, b in ends):
        example = ",".join(["1", "-1:1"] * k).split(",")[:k]
        raise ValueError(
            f"--until {text}: there are {k} motion(s); give where the parameter of each ends, or from where to where "
            f"it goes, such as {','.join(example)}."
        )
    return [(min(pair), max(pair)) for pair in ends]


def _one_motion(text: str, box: Box, *, relative: bool) -> LevelSetEquation:
    from levelflow.equations import MeanCurvature, Transport

    name, *words = text.split()
    if name not in _MOTIONS:
        raise ValueError(f'--motion "{text}": known are {", ".join(_MOTIONS)}.')
    given = {}
    for word in words:
        option, equals, value = word.partition("=")
        if option not in _MOTIONS[name] or not equals or option in given:
            options = " ".join(f"{known}=..." for known in _MOTIONS[name])
            raise ValueError(f'--motion "{text}": {word!r} is not understood; a {name} takes {options}')
        given[option] = value
    unit = half_box(box)
    rate = _number(given.get("rate"), "rate", text)
    if name == "curvature":
        return MeanCurvature(1e-3 * unit**2 if rate is None else rate * unit**2 if relative else rate)
    velocity = velocity_named(
        name, by=given.get("by"), rate=rate, axis=numbers_in(given.get("axis", "0,1,0"), "--motion axis"),
        center=center_in(given.get("center"), box, unit if relative else None, "--motion "),
        reach=_number(given.get("reach"), "reach", text), length=unit if relative else 1.0, unit=unit,
        option="--motion ",
    )  # fmt: skip
    return Transport(velocity)


def _number(text: str | None, option: str, motion: str) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        raise ValueError(f'--motion "{motion}": {option}={text} is no number.') from None


def _counts_in(text: str | None, k: int) -> list[int]:
    """How many values of each parameter are shown."""
    if text is None:
        return [5] if k == 1 else [3, 3] if k == 2 else [2] * k
    parts = text.split(",")
    if len(parts) != k or not all(part.strip().isdecimal() and int(part) > 1 for part in parts):
        raise ValueError(
            f"--grid {text}: there are {k} motion(s); give the number of values for each, at least 2, such as "
            f"{','.join(['3'] * k)}."
        )
    return [int(part) for part in parts]


def _triangle(grid: int) -> tuple[list[tuple[float, ...]], list[int]]:
    """Shares of the second and third shape at the points of a grid on the triangle, and how many are in each row.

    The third shape is above, the first and the second are at the ends of the last row.
    """
    rows = [[(i / grid, j / grid) for i in range(grid - j + 1)] for j in range(grid, -1, -1)]
    return list(itertools.chain.from_iterable(rows)), [len(row) for row in rows]


def _middles(corners: Sequence[tuple[float, ...]]) -> tuple[list[tuple[float, ...]], list[int]]:
    """The corners, the middles of the edges, and the middle of all; how many there are of each."""
    k, number = len(corners[0]), len(corners)
    edges = [tuple((a + b) / 2 for a, b in zip(*pair, strict=True)) for pair in itertools.combinations(corners, 2)]
    return [*corners, *edges, (1 / number,) * k], [number, len(edges), 1]


def _name(motion: str) -> str:
    """What a motion is called in a picture."""
    return " + ".join(part.split()[0] for part in re.split(r"\s\+\s", motion))
