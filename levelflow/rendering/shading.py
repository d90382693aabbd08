"""The look of surfaces: soft light from above, a key light over the left shoulder, darker hollows, a slight rim."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from levelflow.rendering.camera import Camera
from levelflow.rendering.colours import Colour, linear
from levelflow.rendering.hits import Hits


@dataclass(frozen=True)
class Clay:
    """Matt clay on a light ground. Colours are sRGB in [0, 1].

    Attributes:
        front: The colour of the outside.
        back: The colour of the inside, seen through the openings of a mesh.
        ground: The colour where there is no surface.
    """

    front: Colour = (0.88, 0.70, 0.58)
    back: Colour = (0.36, 0.50, 0.62)
    ground: Colour = (0.985, 0.98, 0.97)


@dataclass(frozen=True)
class Normals:
    """The direction of the normal as a colour: x red, y green, z blue, each from -1 to 1. There is no light.

    Attributes:
        ground: The colour where there is no surface.
    """

    ground: Colour = (0.985, 0.98, 0.97)


# Directions in the frame of the camera (right, up, back), so that every picture is lit alike.
_KEY, _FILL = np.array([-0.60, 0.70, 0.50]), np.array([0.85, 0.05, 0.5])
_KEY_LIGHT, _FILL_LIGHT = np.array([0.90, 0.85, 0.78]), np.array([0.13, 0.14, 0.16])
_SKY, _FLOOR = np.array([0.36, 0.39, 0.44]), np.array([0.19, 0.155, 0.135])


def shade(
    hits: Hits, camera: Camera, *, material: Clay | Normals, albedo: Float[np.ndarray, "p 3"] | None = None
) -> Float[np.ndarray, "p 3"]:
    """Linear colours of what is seen, lit if it is clay; `albedo` takes the place of the clay's own colour."""
    if isinstance(material, Normals):
        return linear(0.5 + 0.5 * hits.normals.clip(-1, 1))
    if albedo is None:
        albedo = np.where(hits.behind[:, None], linear(np.array(material.back)), linear(np.array(material.front)))
    normals = np.where(hits.behind[:, None], -hits.normals, hits.normals) @ camera.axes.T
    towards = hits.towards @ camera.axes.T

    key = (normals @ _unit(_KEY)).clip(min=0)
    fill = (normals @ _unit(_FILL)).clip(min=0)
    sky = (0.5 + 0.5 * normals @ camera.axes @ _unit(np.array(camera.up)))[:, None]
    facing = _dot(normals, towards).clip(0, 1)
    openness = _openness(hits)[:, None]
    light = (key[:, None] * _KEY_LIGHT + fill[:, None] * _FILL_LIGHT) * (0.4 + 0.6 * openness)
    light += (sky * _SKY + (1 - sky) * _FLOOR) * openness
    half = _unit(_unit(_KEY) + towards)
    gloss = 0.06 * (_dot(normals, half).clip(min=0) ** 30)[:, None]
    rim = 0.10 * ((1 - facing) ** 4)[:, None] * _SKY * (0.3 + sky)
    return (albedo * light + gloss * openness + rim).clip(0, 1)


def _openness(hits: Hits) -> Float[np.ndarray, " p"]:
    """1 on ridges, less in hollows: how the depth of what is seen compares with the mean depth around its pixel.

    Reference:
        Luft, Colditz, Deussen, Image Enhancement by Unsharp Masking the Depth Buffer, SIGGRAPH 2006.
    """
    from scipy.ndimage import gaussian_filter

    if not len(hits.depth):
        return np.ones(0)
    depth = hits.depth - hits.depth.min()
    depth /= depth.max() or 1.0
    covered = hits.coverage.astype(np.float32)
    seen = hits.mean(depth).astype(np.float32) * covered
    total = np.zeros(len(depth))
    for radius, strength in ((0.006, 1.0), (0.02, 0.6)):
        sigma = radius * min(hits.height, hits.width)
        around, weight = (gaussian_filter(values, sigma, truncate=2.5) for values in (seen, covered))
        mean = (around / np.maximum(weight, 1e-6)).reshape(-1)[hits.pixels]
        total += strength * np.tanh(6 * (depth - mean).clip(min=0))
    return np.exp(-total)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("...c,...c->...", a, b))


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.sqrt(_dot(vectors, vectors))[..., None]
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
