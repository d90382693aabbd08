"""Where a motion acts: painted masks, and regions that stand still or that alone move."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from levelflow.cli.names import half_box, numbers_in

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    from levelflow.conditions import Key
    from levelflow.equations import LevelSetEquation, PaintedMask
    from levelflow.equations.masks import Mask

MaskFile = Annotated[
    Path | None,
    typer.Option(
        "--mask", help="A painted mesh in the place of the shape: black vertices stand still, grey ones are slower."
    ),
]
MaskBy = Annotated[
    str | None, typer.Option("--mask-by", help="A property of its vertices (PLY), from 0 to 1, instead of the colour.")
]
Fix = Annotated[
    list[str] | None,
    typer.Option("--fix", help='A region that stands still: "box x0,y0,z0,x1,y1,z1" or "sphere x,y,z,r". Repeatable.'),
]
Only = Annotated[list[str] | None, typer.Option("--only", help="A region outside of which all stands still.")]
Soft = Annotated[
    float | None,
    typer.Option("--soft", help="Width of the edge around still regions, a length; by default by the size."),
]

# Farther than this share of the size of the shape from what is painted, the paint is that of something else.
_FAR = 0.1
_SAMPLES = 2000


def mask_of(
    key: Key,
    painted: Path | None,
    by: str | None,
    fix: Sequence[str] | None,
    only: Sequence[str] | None,
    soft: float | None,
    *,
    relative: bool,
) -> Mask | None:
    """The mask that the options ask for, the product of all that they name; none if they name nothing.

    Raises:
        ValueError: If a region cannot be read, the paint is that of another shape, or nothing of the surface moves.

    Warns:
        UserWarning: If all of the surface moves at full speed.
    """
    import torch

    from levelflow.conditions import surface_of
    from levelflow.equations import ProductOfMasks

    if by is not None and painted is None:
        raise ValueError(f"--mask-by {by}: name the painted mesh as well, with --mask.")
    regions = [("--fix", text) for text in fix or ()] + [("--only", text) for text in only or ()]
    if painted is None and not regions:
        if soft is not None:
            raise ValueError(
                f"--soft {soft:g}: there is no edge to be soft; name a region with --mask, --fix or --only."
            )
        return None
    if len(only or ()) > 1:
        raise ValueError(f"--only is given {len(only or ())} times; give one region, and fix others with --fix.")
    surface = surface_of(key)
    unit = half_box(surface.box)
    width = 0.1 * unit if soft is None else soft * (unit if relative else 1.0)
    if not 0 < width < float("inf"):
        raise ValueError(f"--soft {soft:g}: give the width of the edge, a positive length.")
    origin, length = (surface.box.center, unit) if relative else ((0.0,) * surface.box.space, 1.0)
    masks: list[Mask] = [region_named(*region, soft=width, origin=origin, length=length) for region in regions]
    samples = surface.sample(_SAMPLES, generator=torch.Generator().manual_seed(0)).points
    if painted is not None:
        masks.append(_painted(painted, by, width, samples.cpu().numpy()))
    mask = masks[0] if len(masks) == 1 else ProductOfMasks(tuple(masks))
    values = mask(samples)
    named = " ".join([*(f'{option} "{text}"' for option, text in regions), *([f"--mask {painted}"] if painted else [])])
    if not values.max() > 0:
        raise ValueError(f"{named}: nothing of the surface {_where(samples)} moves; it has no part elsewhere.")
    if values.min() > 0.999:
        warnings.warn(
            f"{named}: all of the surface {_where(samples)} moves at full speed, as far as {_SAMPLES} points tell; "
            "nothing of it stands still.",
            stacklevel=2,
        )
    return mask


def masked(motion: LevelSetEquation, mask: Mask | None) -> LevelSetEquation:
    """The motion where the mask says, or everywhere if there is none."""
    from levelflow.equations import Regional

    return motion if mask is None else Regional(motion, mask)


def region_named(option: str, text: str, *, soft: float, origin: Sequence[float], length: float) -> Mask:
    """The mask of `box x0,y0,z0,x1,y1,z1` or `sphere x,y,z,r`: 0 there for `--fix`, and 1 there for `--only`."""
    from levelflow.equations import BoxMask, SphereMask

    d = len(origin)
    axes = "xyz"[:d]
    kinds = {
        "box": ",".join([f"{axis}0" for axis in axes] + [f"{axis}1" for axis in axes]),
        "sphere": ",".join([*axes, "r"]),
    }
    name, _, rest = text.strip().partition(" ")
    if name not in kinds:
        raise ValueError(f'{option} "{text}": known are "box {kinds["box"]}" and "sphere {kinds["sphere"]}".')
    numbers = numbers_in(rest, f"{option} {name}")
    if len(numbers) != len(kinds[name].split(",")):
        raise ValueError(f'{option} "{text}": the shape has {d} coordinates; give "{name} {kinds[name]}".')

    def point(values: Sequence[float]) -> tuple[float, ...]:
        return tuple(o + length * v for o, v in zip(origin, values, strict=True))

    inside, outside = (0.0, 1.0) if option == "--fix" else (1.0, 0.0)
    if name == "sphere":
        return SphereMask(point(numbers[:d]), length * numbers[d], soft, inside, outside)
    return BoxMask(point(numbers[:d]), point(numbers[d:]), soft, inside, outside)


def _painted(path: Path, by: str | None, soft: float, samples: np.ndarray) -> PaintedMask:
    """The mask in a file, which has to be around the surface that the samples are of."""
    import numpy as np
    from scipy.spatial import cKDTree

    from levelflow.equations import PaintedMask
    from levelflow.equations.masks import painted_vertices

    points, values = painted_vertices(path, by=by)
    if points.shape[1] != samples.shape[1]:
        raise ValueError(
            f"--mask {path}: its vertices have {points.shape[1]} coordinates, the shape has {samples.shape[1]}."
        )
    mask = PaintedMask.of(points, values, soft=soft, name=path.name)
    size = float(np.ptp(samples, axis=0).max())
    away = float(np.median(cKDTree(points).query(samples)[0]))
    if away > _FAR * size:
        paint, shape = (f"from {_point(p.min(0))} to {_point(p.max(0))}" for p in (points, samples))
        raise ValueError(
            f"--mask {path}: it is the paint of something else, {paint}; half of the shape, {shape}, is more than "
            f"{away:.3g} away from it. Paint the shape itself, in its own place and units."
        )
    return mask


def _where(samples: Tensor) -> str:
    return f"from {_point(samples.min(0).values.tolist())} to {_point(samples.max(0).values.tolist())}"


def _point(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{v:.4g}" for v in values) + ")"
