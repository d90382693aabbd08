"""What is seen in a picture: points of a surface, whether rays or a rasteriser found them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from levelflow.rendering.camera import Camera


@dataclass(frozen=True)
class Hits:
    """Samples of the visible surface, p of them, and the pixels that they belong to.

    Attributes:
        height: Rows of the picture.
        width: Columns.
        pixels: The pixel of each sample, row * width + column; several samples may share one.
        weights: The share of its pixel that a sample stands for.
        points: Where the surface is seen.
        normals: The unit normals there, pointing out of the surface, to the eye or away from it.
        depth: The distance from the eye along the view direction.
        towards: The unit directions to the eye.
        behind: Whether the inside is seen.
    """

    height: int
    width: int
    pixels: Int[np.ndarray, " p"]
    weights: Float[np.ndarray, " p"]
    points: Float[np.ndarray, "p 3"]
    normals: Float[np.ndarray, "p 3"]
    depth: Float[np.ndarray, " p"]
    towards: Float[np.ndarray, "p 3"]
    behind: Bool[np.ndarray, " p"]

    @property
    def coverage(self) -> Float[np.ndarray, "h w"]:
        """The share of each pixel that the surface covers."""
        return self._sums(np.ones(len(self.pixels)))

    @property
    def mask(self) -> Bool[np.ndarray, "h w"]:
        """Whether the surface is seen anywhere in each pixel."""
        return self.coverage > 0

    def place(self, values: Float[np.ndarray, "p ..."], *, background: float | np.ndarray) -> np.ndarray:
        """The picture (h, w, ...) of the mean over each pixel of the values of its samples and of the background."""
        columns = values.reshape(len(values), -1)
        sums = np.stack([self._sums(column) for column in columns.T], axis=-1)
        bare = (1 - self.coverage)[..., None]
        picture = sums + bare * np.broadcast_to(np.asarray(background, dtype=np.float64).reshape(-1), sums.shape[-1:])
        return picture.reshape(self.height, self.width, *values.shape[1:])

    def mean(self, values: Float[np.ndarray, " p"]) -> Float[np.ndarray, "h w"]:
        """The mean over the samples of each pixel, without the background; 0 where nothing is seen."""
        weight = self.coverage
        return np.divide(self._sums(values), weight, out=np.zeros_like(weight), where=weight > 0)

    def _sums(self, values: np.ndarray) -> np.ndarray:
        size = self.height * self.width
        return np.bincount(self.pixels, self.weights * values, size).reshape(self.height, self.width)


def towards_eye(camera: Camera, points: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
    """The unit directions from points to the eye."""
    if camera.orthographic:
        return np.broadcast_to(camera.axes[2], points.shape)
    away = np.array(camera.eye) - points
    return away / np.sqrt(np.einsum("pc,pc->p", away, away)).clip(min=1e-300)[:, None]
