"""What a motion of a mesh must offer."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from jaxtyping import Float

from levelflow.shapes.mesh import Mesh


class Flow(ABC):
    """A motion of the vertices of a mesh."""

    @abstractmethod
    def displacement(self, mesh: Mesh, dt: float, *, time: float) -> Float[np.ndarray, "n d"]:
        """By how much each vertex moves from a time to the time dt later."""
