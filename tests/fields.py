"""Fields for tests: one from any formula, one of every kind, and the jet that automatic differentiation gives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from levelflow.boxes import Box
from levelflow.fields import Continued, Deformed, Field, Map, Placed, Slice, Sum, Walk
from levelflow.jets import Jet
from levelflow.networks.invertible import Inverse, InvertibleResNet
from levelflow.networks.lifting import lift
from levelflow.networks.lipschitz import LipschitzMLP
from levelflow.networks.periodic import Periodic
from levelflow.networks.siren import SIREN
from levelflow.retimed import Retimed


class Explicit(Field):
    """The field of a formula f(x, t), (n,) for points (n, d) and times (n, k), with derivatives by autograd."""

    def __init__(
        self, function: Callable[[Tensor, Tensor], Tensor], space: int, times: int = 0, *, box: Box | None = None
    ) -> None:
        super().__init__()
        self.function, self.space, self.times, self.box = function, space, times, box
        # A placed field computes in the dtype of its parameters.
        self.unused = nn.Parameter(torch.zeros((), dtype=torch.float64))

    def push(self, jet: Jet) -> Jet:
        d = self.space
        with torch.enable_grad():
            size = self.space + self.times if jet.order > 1 else 0
            own = differentiated(self.function, jet.value[:, :d], jet.value[:, d:], seconds=size)
        value, slopes, bends = own.value, own.first, own.second
        first, second = None, None
        if jet.order > 0:
            first = torch.einsum("na,nia->ni", slopes, jet.first)
        if jet.order > 1:
            du = jet.gradient
            second = torch.einsum("na,nija->nij", slopes, jet.second)
            second = second + torch.einsum("nab,nia,njb->nij", bends, du, du)
        return Jet(value, first, second, jet.space)


class Product(Field):
    """The field f g."""

    def __init__(self, left: Field, right: Field) -> None:
        super().__init__()
        self.left, self.right = left, right
        self.space, self.times = left.space, left.times

    def push(self, jet: Jet) -> Jet:
        return self.left.push(jet) * self.right.push(jet)


class Wave(Map):
    """The map x -> A x + b + c sin(B (x, t)) of space, which may depend on time."""

    def __init__(self, space: int, times: int = 0) -> None:
        super().__init__()
        generator = torch.Generator().manual_seed(7)
        self.space, self.times = space, times
        draw = lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64) / 3  # noqa: E731
        self.linear = nn.Parameter(torch.cat([torch.eye(space) + draw(space, space), draw(space, times)], dim=1))
        self.shift = nn.Parameter(draw(space))
        self.waves = nn.Parameter(draw(space, space + times))

    def push(self, jet: Jet) -> Jet:
        waves = jet.affine(self.waves).pointwise(_sine).affine(0.2 * torch.eye(self.space, dtype=torch.float64))
        return jet.affine(self.linear, self.shift) + waves


def differentiated(
    field: Callable[[Tensor, Tensor], Tensor], x: Tensor, t: Tensor, *, seconds: int | None = None
) -> Jet:
    """The jet of a function of points and times, by nested automatic differentiation: the oracle.

    The second derivatives are those in the first `seconds` coordinates, by default those of space.
    """
    d = x.shape[1]
    z = torch.cat([x, t], dim=1)
    z = z if z.requires_grad else z.detach().requires_grad_()
    value = field(z[:, :d], z[:, d:])
    first = _derivatives(value, z)
    m = d if seconds is None else seconds
    rows = [_derivatives(first[:, i], z)[:, :m] for i in range(m)]
    return Jet(value, first, torch.stack(rows, dim=1) if rows else None, d)


def points(field: Field, n: int = 30) -> tuple[Tensor, Tensor]:
    """Points and times in the box of a field, or in [-1, 1]."""
    generator = torch.Generator().manual_seed(1)
    box = field.box or Box((-1,) * field.space, (1,) * field.space).during(*[(-1, 1)] * field.times)
    return box.uniform(n, generator=generator), box.uniform_times(n, generator=generator)


def siren(space: int, time: int = 0, *, depth: int = 2, width: int = 16, omega: float = 5.0, seed: int = 0) -> SIREN:
    """A small network in float64."""
    generator = torch.Generator().manual_seed(seed)
    return SIREN(space, time, width=width, depth=depth, omega=omega, generator=generator, dtype=torch.float64)


def lipschitz(space: int, time: int = 0, *, depth: int = 2, seed: int = 0) -> LipschitzMLP:
    """A small Lipschitz network in float64, most rows of which are scaled down."""
    generator = torch.Generator().manual_seed(seed)
    network = LipschitzMLP(space, time, width=16, depth=depth, generator=generator, dtype=torch.float64)
    with torch.no_grad():
        network.c -= 0.3
    return network


def invertible(space: int, time: int = 0, *, seed: int = 0, **more: Any) -> InvertibleResNet:
    """A small invertible network in float64, no longer the identity: every matrix is at its bound."""
    generator = torch.Generator().manual_seed(seed)
    network = InvertibleResNet(space, time, **{"blocks": 3, "width": 16, "frequencies": 2, "omega": 5.0} | more)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += torch.randn(parameter.shape, generator=generator)
    return network.double()


def placed(space: int, time: int = 0) -> Placed:
    """A small network in units that are not those of the network."""
    box = Box((1.0, -2.0, 3.0)[:space], (4.0, 3.0, 7.0)[:space], ((2.0, 5.0), (-1.0, 0.5))[:time])
    return Placed(siren(space, time), box)


def periodic(space: int, time: int = 0, *, axes: tuple[int, ...] = (), loop: bool = False) -> Periodic:
    """A small network in float64 that repeats itself."""
    return Periodic(siren(space + len(axes), time + loop, omega=8.0), axes=axes, time=loop)


def round_field(x: Tensor, t: Tensor) -> Tensor:
    return (x * x).sum(1) * (1 + t.sum(1)) + torch.sin(x[:, 0]) - 0.3


FIELDS: dict[str, Field] = {
    **{f"SIREN of {d} and {k}": siren(d, k) for d in (2, 3) for k in (0, 1, 2)},
    "SIREN of one layer": siren(2, 1, depth=1),
    "deep SIREN": siren(2, 1, depth=4),
    "lifted SIREN": lift(siren(2)),
    "wider lifted SIREN": lift(siren(3), time=2, width=24),
    "deeper lifted SIREN": lift(siren(2), width=20, depth=4),
    "SIREN at a time": siren(2, 1).at(0.3),
    "SIREN at one of two times": siren(2, 2).at(None, 0.3),
    "slice": Slice(siren(2, 2), (0.3, -0.5)),
    "slice at one of two times": Slice(siren(2, 2), (0.3, None)),
    "placed in the plane": placed(2),
    "placed in space-time": placed(2, 1),
    "placed with two parameters": placed(3, 2),
    "placed at a time": placed(2, 1).at(4.0),
    "placed at one of two times": placed(2, 2).at(4.0, None),
    "slice of a placed": Slice(placed(3, 1), (4.0,)),
    "walk": Walk(siren(2, 2), [(0.3, -0.5), (1.0, 2.0), (0.0, 0.5)]),
    "walk of a placed": Walk(placed(3, 2), [(2.0, -1.0), (4.0, 0.5), (2.0, 0.5)]),
    "deformed": Deformed(siren(2), Wave(2)),
    "deformed in time": Deformed(siren(3), Wave(3, 1)),
    "deformed, placed": Deformed(placed(2), Wave(2)),
    "Lipschitz": lipschitz(2),
    "deep Lipschitz of space-time": lipschitz(3, 2, depth=4),
    "Lipschitz at a time": lipschitz(2, 1).at(0.3),
    "deformed by a network": Deformed(siren(2), invertible(2)),
    "deformed by a network in time": Deformed(siren(3), invertible(3, 1)),
    "carried by a network": Deformed(siren(3), Inverse(invertible(3))),
    "carried by a network in time": Deformed(siren(2), Inverse(invertible(2, 2))),
    "carried by a network after a map": Deformed(Deformed(siren(2), Inverse(invertible(2))), Wave(2)),
    "carried by a network, placed": Placed(
        Deformed(siren(2), Inverse(invertible(2, 1))), Box((1, -2), (4, 3), ((2, 5),))
    ),
    "loop": periodic(2, 1, loop=True),
    "loop of a Lipschitz network": Periodic(lipschitz(3, 2), time=True),
    "loop at a time": periodic(2, 1, loop=True).at(0.3),
    "periodic in space": periodic(3, 1, axes=(0, 1, 2)),
    "periodic along one axis, with two parameters": periodic(2, 2, axes=(1,)),
    "periodic in space and time": periodic(3, 1, axes=(2, 0), loop=True),
    "periodic in space and time, at a time": periodic(3, 1, axes=(2, 0), loop=True).at(0.3),
    "periodic in space, placed": Placed(periodic(2, 1, axes=(0,), loop=True), Box((1, -2), (4, 0), ((2, 5),))),
    "eased": Retimed(placed(2, 1), {-1.5: 2, 0.2: 4, 0.5: 4, 2: 3}),
    "half eased, placed": Retimed(placed(3, 1), {0: 5, 2: 2, 3: 4}, ease=0.5),
    "at an even speed": Retimed(Explicit(round_field, 2, 1, box=placed(2, 1).box), {-1: 2.5, 1: 2}, ease=0),
    "retimed twice": Retimed(Retimed(placed(2, 1), {0: 2, 1: 5}), {0: 0, 3: 1}),
    "retimed at a time": Retimed(placed(2, 1), {0: 2, 1: 5}).at(0.3),
    "beyond its box": Continued(Placed(siren(2), Box((-0.4, -0.2), (0.3, 0.5)))),
    "beyond its box, deformed in time": Deformed(
        Continued(Placed(siren(3), Box((-0.6,) * 3, (0.3, 0.5, 0.4)))), invertible(3, 1)
    ),
    "sum": Sum(siren(2, 1), siren(2, 1, seed=1), placed(2, 1)),
    "product": Product(siren(3, 1), placed(3, 1)),
    "formula": Explicit(round_field, 2, 1),
    "slice of a sum of products": Slice(Sum(Product(siren(2, 1), placed(2, 1)), Explicit(round_field, 2, 1)), (0.4,)),
    "placed sum of deformed": Placed(Sum(Deformed(siren(2), Wave(2)), siren(2, seed=2)), Box((3, 4), (5, 5))),
}
"""A field of every kind; a kind that is listed here is tested."""


def _sine(u: Tensor, order: int) -> tuple[Tensor, ...]:
    return (torch.sin(u), torch.cos(u), -torch.sin(u))[: order + 1]


def _derivatives(values: Tensor, z: Tensor) -> Tensor:
    if not values.requires_grad:
        return torch.zeros_like(z)
    return torch.autograd.grad(values.sum(), z, create_graph=True, materialize_grads=True)[0]
