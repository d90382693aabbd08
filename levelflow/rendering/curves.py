"""Pictures of curves in the plane: the inside filled, the curve drawn."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from levelflow.rendering.camera import Camera
from levelflow.rendering.colours import linear
from levelflow.rendering.shading import Clay
from levelflow.shapes.mesh import Mesh


def draw(
    curve: Mesh, camera: Camera, *, height: int, width: int, material: Clay, line: float
) -> Float[np.ndarray, "h w 3"]:
    """Linear colours of a picture of segments; `line` is the width of the curve in pixels.

    Pixels around which the curve winds are filled if the curve is closed.
    """
    from PIL import Image, ImageDraw

    points = camera.project(curve.vertices, height=height, width=width)[curve.faces][..., :2]
    picture = np.broadcast_to(linear(np.array(material.ground)), (height, width, 3)).copy()
    if curve.is_watertight:
        light = linear(np.array(material.front))
        picture[_winding(points, height, width) != 0] = 0.45 * light + 0.55 * linear(np.array(material.ground))
    stencil = Image.new("1", (width, height))
    pen, dot = ImageDraw.Draw(stencil), line / 2
    for (x0, y0), (x1, y1) in points.tolist():
        pen.line((x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5), fill=1, width=max(round(line), 1))
        # Round ends close the notch between a segment and the next.
        pen.ellipse((x0 - 0.5 - dot, y0 - 0.5 - dot, x0 - 0.5 + dot, y0 - 0.5 + dot), fill=1)
    picture[np.array(stencil)] = linear(np.array(material.front) * 0.55)
    return picture


def _winding(points: Float[np.ndarray, "m 2 2"], height: int, width: int) -> np.ndarray:
    """How often closed segments wind around each pixel's centre, (h, w): crossings to its left, with their signs."""
    (x0, y0), (x1, y1) = np.moveaxis(points, 0, -1)
    low, high = np.minimum(y0, y1), np.maximum(y0, y1)
    first = np.ceil(low - 0.5).clip(0, height).astype(np.int64)
    counts = (np.ceil(high - 0.5).clip(0, height).astype(np.int64) - first).clip(min=0)
    segment = np.repeat(np.arange(len(points)), counts)
    row = np.arange(len(segment)) - np.repeat(np.cumsum(counts) - counts - first, counts)
    share = (row + 0.5 - y0[segment]) / (y1 - y0)[segment]
    x = x0[segment] + share * (x1 - x0)[segment]
    steps = np.zeros((height, width + 1), np.int64)
    column = np.ceil(x - 0.5).clip(0, width).astype(np.int64)
    np.add.at(steps, (row, column), np.where(y1 > y0, 1, -1)[segment])
    return steps.cumsum(1)[:, :width]
