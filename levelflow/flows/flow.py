"""What a flow does."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from jaxtyping import Float

from levelflow.shapes.mesh import Mesh


class Flow(ABC):
    @abstractmethod
    def displacement(self, mesh: Mesh, dt: float, *, time: float) -> Float[np.ndarray, "n d"]:
        """How far each vertex moves in the time dt from `time`, in the units of the mesh."""
