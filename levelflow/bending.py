"""What an equation of fourth order asks of a field: the terms of `motion`, with a second network for the curvature."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from levelflow.curvature import gradient_norm, total_curvature
from levelflow.equations.equation import Equation
from levelflow.fields import Field, Placed
from levelflow.jets import Jet
from levelflow.motion import Smoothing, Start


class Agreement(Smoothing):
    """A second network for the curvature of the moving surface, with which equations of fourth order stay of second.

    It is to agree with the curvature of the field near the moving surface; what it is elsewhere does not matter. Alone
    this term prepares it before the equation acts: speeds from a network that knows nothing yet would tear the surface.

    Args:
        kappa: The network of the total curvature, in normalised units and a tenth of its size.
    """

    name = "curvature"
    weight, noise, bend, size = 2.0, 0.01, 0.03, 10.0
    knee = Smoothing.gentle

    def __init__(
        self,
        placed: Placed,
        equation: Equation,
        kappa: Field,
        *,
        n: int,
        since: float = 0.0,
        until: float = 1.0,
        start: Start | None = None,
    ) -> None:
        super().__init__(placed, equation, n=n, since=since, start=start)
        self.kappa, self.until = kappa, until

    def loss(self, *batch: Tensor) -> Tensor:
        (z,) = batch
        d = self.placed.space
        return self.disagreement(super().jet(z), self.kappa(z[:, :d], z[:, d:]))

    def jet(self, z: Tensor) -> Jet:
        d, unit = self.placed.space, self.size / self.placed.box.frame.scale**2
        kappa = self.placed.in_units(self.kappa.jet(z[:, :d], z[:, d:], order=2))
        assert kappa.first is not None
        kappa = Jet(unit * kappa.value, unit * kappa.first, unit * kappa.hessian, d)
        return replace(super().jet(z), curvature=kappa)

    def disagreement(self, jet: Jet, kappa: Tensor) -> Tensor:
        """The loss for the difference between the curvature of f and the value of the network, (n,)."""
        truth, scale = total_curvature(jet), self.placed.box.frame.scale
        error = (kappa - truth * scale / self.size) / (1 + self.bend * scale * truth.detach().abs())
        loss = self.knee**2 * torch.log1p((error / self.knee) ** 2)
        return torch.where(gradient_norm(jet) > 0.05, loss, 0.0)


class Bending(Agreement):
    """An equation of fourth order, and the agreement of its second network with the field."""

    name = "motion"
    bond, ramp = 3.0, 0.4

    def loss(self, *batch: Tensor) -> Tensor:
        (z,) = batch
        jet = self.jet(z)
        assert jet.curvature is not None
        kappa = jet.curvature.value * self.placed.box.frame.scale / self.size
        return self.charge(z, jet) + self.bond * self.disagreement(jet, kappa)
