"""The look of surfaces: soft light from above, a key light over the left shoulder, darker hollows, a slight rim."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from levelflow.rendering.camera import Camera
from levelflow.rendering.rasterising import Raster
from levelflow.shapes.mesh import Mesh

Colour = tuple[float, float, float]


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


# Directions in the frame of the camera (right, up, back), so that every picture is lit alike.
_KEY, _FILL = np.array([-0.60, 0.70, 0.50]), np.array([0.85, 0.05, 0.5])
_KEY_LIGHT, _FILL_LIGHT = np.array([0.90, 0.85, 0.78]), np.array([0.13, 0.14, 0.16])
_SKY, _FLOOR = np.array([0.36, 0.39, 0.44]), np.array([0.19, 0.155, 0.135])
# The cosine between a face's normal and a vertex's below which there is an edge to be seen.
_CREASE = 0.75


def shade(raster: Raster, mesh: Mesh, camera: Camera, *, material: Clay) -> Float[np.ndarray, "p 3"]:
    """Linear colours of the covered pixels of a picture."""
    faces = mesh.face_normals
    corners = mesh.vertex_normals[mesh.faces]
    crease = (corners * faces[:, None]).sum(2) < _CREASE
    corners = np.where(crease[..., None], faces[:, None], corners)
    normals = _unit(raster.interpolate(corners)) @ camera.axes.T
    corner_points = (mesh.vertices[mesh.faces] - np.array(camera.eye)) @ camera.axes.T
    towards = np.array([[0.0, 0.0, 1.0]]) if camera.orthographic else _unit(-raster.interpolate(corner_points))
    behind = ((faces[raster.faces] @ camera.axes.T) * towards).sum(1) < 0
    normals = np.where(behind[:, None], -normals, normals)

    key = (normals @ _unit(_KEY)).clip(min=0)
    fill = (normals @ _unit(_FILL)).clip(min=0)
    sky = (0.5 + 0.5 * normals @ camera.axes @ _unit(np.array(camera.up)))[:, None]
    facing = (normals * towards).sum(1).clip(0, 1)
    openness = _openness(raster)[:, None]
    light = (key[:, None] * _KEY_LIGHT + fill[:, None] * _FILL_LIGHT) * (0.4 + 0.6 * openness)
    light += (sky * _SKY + (1 - sky) * _FLOOR) * openness
    albedo = np.where(behind[:, None], linear(np.array(material.back)), linear(np.array(material.front)))
    half = _unit(_unit(_KEY) + towards)
    gloss = 0.06 * ((normals * half).sum(1).clip(min=0) ** 30)[:, None]
    rim = 0.10 * ((1 - facing) ** 4)[:, None] * _SKY * (0.3 + sky)
    return (albedo * light + gloss * openness + rim).clip(0, 1)


def linear(colour: np.ndarray) -> np.ndarray:
    """Light from sRGB values."""
    return np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)


def srgb(light: np.ndarray) -> np.ndarray:
    """sRGB values from light."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light.clip(min=0) ** (1 / 2.4) - 0.055)


def _openness(raster: Raster) -> Float[np.ndarray, " p"]:
    """1 on ridges, less in hollows: how a pixel's depth compares with the mean depth around it.

    Reference:
        Luft, Colditz, Deussen, Image Enhancement by Unsharp Masking the Depth Buffer, SIGGRAPH 2006.
    """
    from scipy.ndimage import gaussian_filter

    if not len(raster.depth):
        return np.ones(0)
    depth = raster.depth - raster.depth.min()
    depth /= depth.max() or 1.0
    # Blurs are smooth: every other sample is enough for them.
    row, column = raster.pixels // raster.width // 2, raster.pixels % raster.width // 2
    sparse, mask = (
        raster.place(values.astype(np.float32), background=0.0)[::2, ::2] for values in (depth, np.ones(len(depth)))
    )
    total = np.zeros(len(depth))
    for radius, strength in ((0.006, 1.0), (0.02, 0.6)):
        sigma = radius * min(raster.height, raster.width)
        around, weight = (gaussian_filter(values, sigma, truncate=2.5) for values in (sparse, mask))
        mean = (around / np.maximum(weight, 1e-6))[row, column]
        total += strength * np.tanh(6 * (depth - mean).clip(min=0))
    return np.exp(-total)


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
