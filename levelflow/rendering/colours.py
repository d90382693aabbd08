"""Colours: light and sRGB, maps from numbers to colours, and the bar that tells which is which."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

Colour = tuple[float, float, float]
_INK = (64, 60, 56)


def linear(colour: np.ndarray) -> np.ndarray:
    """Light from sRGB values."""
    return np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)


def srgb(light: np.ndarray) -> np.ndarray:
    """sRGB values from light."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light.clip(min=0) ** (1 / 2.4) - 0.055)


# From linear sRGB to the responses of the cones, and from their cube roots to lightness and the two opponent colours.
_CONES = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
_OPPONENTS = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)


@dataclass(frozen=True)
class ColourMap:
    """Colours for the numbers from 0 to 1, between a few given ones at equal distances.

    Between them OKLab coordinates are interpolated, in which equal steps look equally large.

    Attributes:
        stops: The given colours, sRGB in [0, 1], two or more.

    Raises:
        ValueError: If there are fewer than two.

    Reference:
        Ottosson, A perceptual color space for image processing, 2020.
    """

    stops: tuple[Colour, ...]

    def __post_init__(self) -> None:
        if len(self.stops) < 2:
            raise ValueError(
                f"ColourMap(stops={self.stops}): a map leads from one colour to another; give two or more."
            )

    def __call__(self, values: Float[np.ndarray, ...]) -> Float[np.ndarray, "... 3"]:
        """Light, linear RGB, for numbers in [0, 1]; those beyond have the colours of the ends."""
        lab = np.cbrt(linear(np.array(self.stops)) @ _CONES.T) @ _OPPONENTS.T
        at = np.linspace(0, 1, len(lab))
        between = np.stack([np.interp(values, at, channel) for channel in lab.T], axis=-1)
        return ((between @ np.linalg.inv(_OPPONENTS).T) ** 3 @ np.linalg.inv(_CONES).T).clip(0, 1)


DIVERGING = ColourMap(
    ((0.11, 0.24, 0.52), (0.24, 0.53, 0.76), (0.66, 0.82, 0.88), (0.96, 0.94, 0.90), (0.95, 0.74, 0.56),
     (0.84, 0.39, 0.27), (0.55, 0.10, 0.14))
)  # fmt: skip
"""For numbers of both signs: blue below zero, red above, and light at zero."""
SEQUENTIAL = ColourMap(
    ((0.97, 0.95, 0.88), (0.97, 0.80, 0.50), (0.93, 0.53, 0.33), (0.75, 0.28, 0.38), (0.43, 0.14, 0.43),
     (0.13, 0.07, 0.27))
)  # fmt: skip
"""For magnitudes: light at zero, dark at the top."""


@dataclass(frozen=True)
class Scale:
    """Which numbers the colours of a map stand for.

    Attributes:
        low: The number at the lower end; lesser ones have its colour.
        high: The number at the upper end.
        map: The colours.
        label: What the numbers are, in a few characters.

    Raises:
        ValueError: If the ends are not finite and in order.
    """

    low: float
    high: float
    map: ColourMap = DIVERGING
    label: str = ""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ValueError(f"Scale(low={self.low}, high={self.high}): give two numbers, the lower one first.")

    @classmethod
    def of(cls, values: Float[np.ndarray, " n"], *, signed: bool, label: str = "") -> Scale:
        """A scale for given numbers: symmetric about 0 if they are signed, else from 0 up.

        It ends at a round number above the magnitude that 2 % of them exceed, so that a few wild ones do not matter.

        Raises:
            ValueError: If there are none, or one is not finite.
        """
        if not len(values) or not np.isfinite(values).all():
            bad = int((~np.isfinite(values)).sum())
            raise ValueError(
                f"Scale.of: {bad} of {len(values)} values are not finite; give one or more finite numbers."
            )
        limit = _round_up(float(np.quantile(np.abs(values), 0.98)))
        return cls(-limit if signed else 0.0, limit, DIVERGING if signed else SEQUENTIAL, label)

    def __call__(self, values: Float[np.ndarray, ...]) -> Float[np.ndarray, "... 3"]:
        """Light, linear RGB, for numbers."""
        return self.map((values - self.low) / (self.high - self.low))


def bar_width(height: int) -> int:
    """The columns that the colour bar of a picture of so many rows takes."""
    return round(5.2 * _text(height))


def with_bar(picture: UInt8[np.ndarray, "h w 3"], scale: Scale, *, ground: Colour) -> UInt8[np.ndarray, "h v 3"]:
    """The picture with a colour bar and its numbers on the right, wider by `bar_width`."""
    from PIL import Image, ImageDraw, ImageFont

    height, width = picture.shape[:2]
    text, column = _text(height), bar_width(height)
    sheet = Image.new("RGB", (width + column, height), tuple(round(255 * c) for c in ground))
    sheet.paste(Image.fromarray(picture), (0, 0))
    top, bottom = round(0.2 * height), round(0.8 * height)
    left, right = width + round(0.3 * text), width + round(1.2 * text)
    shades = np.linspace(1, 0, bottom - top)
    strip = (255 * srgb(scale.map(shades)) + 0.5).astype(np.uint8)
    sheet.paste(Image.fromarray(np.repeat(strip[:, None], right - left, axis=1)), (left, top))
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(text)
    pen.text((left, top - 0.9 * text), scale.label, _INK, font, "ls")
    for share in (0, 0.25, 0.5, 0.75, 1):
        y = round(bottom - 1 + share * (top - bottom + 1))
        pen.line((right, y, right + text // 4, y), fill=_INK, width=max(text // 12, 1))
        pen.text((right + 0.5 * text, y), f"{scale.low + share * (scale.high - scale.low):.3g}", _INK, font, "lm")
    return np.array(sheet)


def _text(height: int) -> int:
    return max(height // 30, 9)


def _round_up(value: float) -> float:
    """The next number of the form 1, 1.2, 1.6, 2, 2.4, 3.2, 4, 5, 6, 8 times a power of ten; 1 for 0."""
    if value <= 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(
        (m * power for m in (1, 1.2, 1.6, 2, 2.4, 3.2, 4, 5, 6, 8) if m * power >= value * (1 - 1e-9)), 10 * power
    )
