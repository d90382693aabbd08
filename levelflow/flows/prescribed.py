"""Motions of a mesh that are given: by a velocity field, or along the normal at constant speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.equations.transport import Transport, Velocity
from levelflow.flows.flow import Flow
from levelflow.flows.normals import smooth_normals
from levelflow.shapes.mesh import Mesh


class Prescribed(Flow):
    r"""Motion by a velocity field, $\partial_t x = V(x, t)$.

    Each vertex goes along its characteristic, by the formula of the velocity field if it has one and else by Runge and
    Kutta's fourth-order method.

    Args:
        velocity: d numbers for a constant velocity, or V(x, t) for points (n, d) and times (n, 1) with values (n, d),
            in length per unit time: as for `equations.Transport`.
        steps: How many steps of Runge and Kutta's make one dt.

    Raises:
        TypeError: If `velocity` is neither numbers nor a function.
        ValueError: If `steps` is not positive.
    """

    def __init__(self, velocity: Velocity | Sequence[float] | np.ndarray | Tensor, *, steps: int = 4) -> None:
        try:
            self.motion = Transport(velocity)
        except TypeError:
            raise TypeError(
                f"Prescribed({velocity!r}): give the components of a constant velocity, such as (0, 1, 0), "
                "or a function V(x, t)."
            ) from None
        if steps < 1:
            raise ValueError(f"Prescribed(steps={steps}): at least one step is needed to get anywhere.")
        self.steps = steps

    def __repr__(self) -> str:
        return f"Prescribed({self.motion.velocity!r})"

    def displacement(self, mesh: Mesh, dt: float, *, time: float) -> Float[np.ndarray, "n d"]:
        x = torch.tensor(mesh.vertices)
        start = x.new_full((len(x),), time)
        with torch.no_grad():
            return self.motion.carry(x, start, start + dt, steps=self.steps).numpy() - mesh.vertices


@dataclass(frozen=True)
class NormalOffset(Flow):
    r"""Motion along the normal at constant speed, $\partial_t x = v\, n$: a sphere's radius is $r_0 + v t$.

    Attributes:
        speed: v, in length per unit time; negative to shrink.
    """

    speed: float

    def displacement(self, mesh: Mesh, dt: float, *, time: float) -> Float[np.ndarray, "n d"]:
        return self.speed * dt * smooth_normals(mesh)
