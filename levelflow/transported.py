"""The exact solution of a motion by a velocity field."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.equations.equation import Equation
from levelflow.fields import Field
from levelflow.jets import Jet
from levelflow.shapes.implicit import value_of
from levelflow.shapes.shape import Solid


class Transported(Field):
    r"""A shape or field carried along characteristics, $f(x, t) = f_0(\Phi_{t \to t_0}(x))$, without any training.

    Its surface is exact up to the Runge-Kutta steps, whatever the motion draws out; a network cannot hold what is
    thinner than its details. In return every value costs the steps and a distance, and the field cannot be saved:
    `solve` distils it into a network. Values are those of the shape, so |grad f| is 1 at $t_0$ and then as it comes.

    Args:
        motion: An equation with characteristics: `Transport`, or `Stationary`.
        shape: A solid, or a static field with a box.
        box: Where the field is to be looked at, with the interval of its time.
        time: The time $t_0$ at which the shape is given.
        steps: Runge-Kutta steps of each evaluation, at most.

    Raises:
        ValueError: If the motion depends on the surface, or the box has not one interval of time.

    Reference:
        Novello et al., Neural homotopies (2022), Sec. 4.1.2.
    """

    def __init__(self, motion: Equation, shape: Solid | Field, *, box: Box, time: float = 0.0, steps: int = 64) -> None:
        super().__init__()
        if len(box.times) != 1:
            raise ValueError(f"Transported: the box has {len(box.times)} times; give one interval, box.during((0, 1)).")
        origin, now = torch.zeros(1, box.space, dtype=torch.float64), torch.zeros(1, dtype=torch.float64)
        if motion.carry(origin, now, now) is None:
            raise ValueError(f"Transported: {motion!r} depends on the surface and has no characteristics; solve it.")
        self.motion, self.time, self.steps = motion, time, steps
        self.value = value_of(shape)
        self.box, self.space, self.times = box, box.space, 1

    def forward(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None) -> Float[Tensor, " n"]:
        x, t = self._inputs(x, t)
        origins = self.motion.carry(x, t[:, 0], torch.full_like(t[:, 0], self.time), steps=self.steps)
        assert origins is not None
        return self.value(origins)

    def push(self, jet: Jet) -> Jet:
        """The chain rule, with derivatives of f by automatic differentiation; a Hessian where f0 has one."""
        z = jet.value.detach().requires_grad_()
        with torch.enable_grad():
            value = self(z[:, : self.space], z[:, self.space :])
            if jet.first is None:
                return Jet(value.detach(), None, None, jet.space)
            (slope,) = torch.autograd.grad(value.sum(), z, create_graph=jet.second is not None)
            first = torch.einsum("nim,nm->ni", jet.first, slope.detach())
            if jet.second is None:
                return Jet(value.detach(), first, None, jet.space)
            rows = [torch.autograd.grad(slope[:, i].sum(), z, retain_graph=True)[0] for i in range(z.shape[1])]
        du = jet.gradient
        second = torch.einsum("nijm,nm->nij", jet.second, slope.detach())
        second = second + torch.einsum("nim,nmk,njk->nij", du, torch.stack(rows, dim=1), du)
        return Jet(value.detach(), first, second, jet.space)
