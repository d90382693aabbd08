"""Numbers at the points of a surface, to be shown by colours: curvature, and how well an equation holds."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.curvature import total_curvature
from levelflow.equations import Equation
from levelflow.fields import Field
from levelflow.shapes.mesh import Mesh

_POINTS_AT_ONCE = 1 << 11


class Quantity(ABC):
    """A number at every point of a surface.

    Attributes:
        label: What it is, in a few characters.
        signed: Whether it has both signs; else it is a magnitude.
    """

    label: ClassVar[str]
    signed: ClassVar[bool]

    @abstractmethod
    def at(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """The numbers at points of the surface."""


@dataclass(frozen=True)
class Curvature(Quantity):
    r"""$\kappa = \operatorname{div} n = k_1 + k_2$ of the level sets of a field, from its jets, in 1 / length.

    Attributes:
        field: A field without times.
    """

    field: Field
    label: ClassVar[str] = "k1 + k2"
    signed: ClassVar[bool] = True

    def at(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        with torch.no_grad():
            return _joined([total_curvature(self.field.jet(x, order=2)) for x in _parts(points)])


@dataclass(frozen=True)
class Residual(Quantity):
    """The magnitude of the error of an equation, in the form that training makes small; 0 for a solution.

    For a motion along the normal it is the error of the normal speed, in length per unit time. Where several equations
    are to hold, it is the root of the sum of squares.

    Attributes:
        field: A field with as many times as are given.
        equation: What is to hold.
        times: When, one number for each time of the field.
    """

    field: Field
    equation: Equation
    times: tuple[float, ...] = ()
    label: ClassVar[str] = "residual"
    signed: ClassVar[bool] = False

    def at(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        with torch.no_grad():
            return _joined([self._error(x) for x in _parts(points)])

    def _error(self, x: Tensor) -> Tensor:
        t = x.new_tensor(self.times).expand(len(x), -1)
        error = self.equation.error(x, t, self.field.jet(x, t, order=self.equation.order))
        return torch.linalg.vector_norm(error.reshape(len(x), -1), dim=1)


def mesh_curvature(mesh: Mesh) -> Float[np.ndarray, " n"]:
    r"""$\kappa = k_1 + k_2 = -\langle \Delta x, n \rangle$ at the vertices of triangles, by cotangent weights.

    The areas are those of the Voronoi cells. Values at the border of an open mesh mean nothing and are 0.

    Raises:
        ValueError: If the mesh is not made of triangles.

    Reference:
        Meyer et al., Discrete Differential-Geometry Operators for Triangulated 2-Manifolds, 2003, Sec. 3.
    """
    import igl

    if mesh.faces.shape[1] != 3:
        raise ValueError(f"mesh_curvature(mesh): its faces have {mesh.faces.shape[1]} vertices; triangles are needed.")
    faces = np.ascontiguousarray(mesh.faces)
    # Vertices beyond the last of a face would have no row.
    vertices = np.ascontiguousarray(mesh.vertices[: faces.max() + 1])
    areas = igl.massmatrix(vertices, faces, igl.MASSMATRIX_TYPE_VORONOI).diagonal()
    inward = ((igl.cotmatrix(vertices, faces) @ vertices) * mesh.vertex_normals[: len(vertices)]).sum(1)
    ample = np.isfinite(inward) & (areas > 1e-12 * mesh.area / len(faces))
    kappa = np.zeros(len(mesh.vertices))
    kappa[: len(vertices)] = np.divide(-inward, areas, out=np.zeros_like(areas), where=ample)
    kappa[igl.boundary_facets(faces)[0]] = 0.0
    return kappa


def _parts(points: np.ndarray) -> tuple[Tensor, ...]:
    return torch.tensor(points).split(_POINTS_AT_ONCE)


def _joined(parts: list[Tensor]) -> np.ndarray:
    return torch.cat(parts).double().cpu().numpy()
