"""Flows that keep the volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from levelflow.flows.flow import Flow
from levelflow.flows.laplacian import boundary
from levelflow.flows.normals import smooth_normals
from levelflow.shapes import simplices
from levelflow.shapes.mesh import Mesh


@dataclass(frozen=True)
class VolumePreserving(Flow):
    r"""A flow without its mean along the normal: the displacement $\delta_0 - c\,n$ instead of $\delta_0$.

    To first order c is the mean of $\delta_0 \cdot n$ over the surface; it is the one at which the volume of the moved
    mesh is that of the mesh (in the plane, the area inside), found by Newton's method to rounding. A mesh of several
    bodies keeps the sum of their volumes. Mean curvature then lowers the area at a given volume.

    The boundary of an open mesh moves by $\delta_0$ alone, and the volume is that between the mesh and the cone from
    its boundary to the middle of its boundary: a soap film on a wire that moves nothing becomes a cap.

    Attributes:
        flow: The flow that moves by $\delta_0$; a sum goes inside: VolumePreserving(a + b).

    Raises:
        TypeError: If `flow` is no flow.
        ValueError: If no offset along the normals brings the volume back.

    Reference:
        Huisken, The volume preserving mean curvature flow, J. reine angew. Math. 382 (1987).
    """

    flow: Flow

    def __post_init__(self) -> None:
        if not isinstance(self.flow, Flow):
            raise TypeError(
                f"flows.VolumePreserving({self.flow!r}): this is no flow of a mesh, such as flows.MeanCurvature(0.1)."
            )

    def displacement(self, mesh: Mesh, dt: float, *, time: float) -> Float[np.ndarray, "n d"]:
        faces, free = mesh.faces, self.flow.displacement(mesh, dt, time=time)
        ends = boundary(faces, len(mesh.vertices))
        normals = np.where(ends[:, None], 0.0, smooth_normals(mesh))
        volume, moved, offset = _volume(mesh.vertices, faces, ends), mesh.vertices + free, 0.0
        tolerance = 1e-13 * mesh.area * max(mesh.box.size)
        for _ in range(30):
            now = moved - offset * normals
            excess = _volume(now, faces, ends) - volume
            if abs(excess) <= tolerance:
                return free - offset * normals
            swept = float((simplices.area_vectors(now, faces) * normals[faces].mean(1)).sum())
            if swept == 0:
                break
            offset += excess / swept
        raise ValueError(
            f"{self!r}.displacement(mesh, {dt:g}): the volume changes by {_volume(moved, faces, ends) - volume:.3g} of "
            f"{volume:.3g}, and no offset along the normals brings it back. Take a shorter dt; a mesh whose vertices "
            f"all lie on its boundary (here {int(ends.sum())} of {len(ends)}) has no such offset."
        )


def _volume(vertices: Float[np.ndarray, "n d"], faces: np.ndarray, ends: np.ndarray) -> float:
    """The enclosed volume, of an open mesh that up to the cone from its boundary to the middle of its boundary."""
    middle = vertices[ends if ends.any() else slice(None)].mean(0)
    centroids = vertices[faces].mean(1) - middle
    return float((simplices.area_vectors(vertices, faces) * centroids).sum() / vertices.shape[1])
