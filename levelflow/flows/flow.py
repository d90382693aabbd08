"""What moves the vertices of a mesh: flows, and their sums."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import reduce
from operator import add

import numpy as np
from jaxtyping import Float

from levelflow.shapes.mesh import Mesh


class Flow(ABC):
    """A motion of the vertices of a mesh.

    A flow of one's own is a subclass with one method. Flows add up: a + b moves each vertex by the sum of what a and b
    do to the same mesh, which is first order in dt.
    """

    @abstractmethod
    def displacement(self, mesh: Mesh, dt: float, *, time: float) -> Float[np.ndarray, "n d"]:
        """How far each vertex moves in the time dt from `time`, in the units of the mesh."""

    def __add__(self, other: Flow) -> Flow:
        return SumOfFlows(self, other)


class SumOfFlows(Flow):
    """Several flows at once: their displacements add up."""

    def __init__(self, *flows: Flow) -> None:
        self.flows = flows

    def __repr__(self) -> str:
        return " + ".join(map(repr, self.flows))

    def displacement(self, mesh: Mesh, dt: float, *, time: float) -> Float[np.ndarray, "n d"]:
        return reduce(add, (flow.displacement(mesh, dt, time=time) for flow in self.flows))
