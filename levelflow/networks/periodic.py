"""Networks that repeat themselves, in space for what fills it by a cell, and in time for loops."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.fields import Field
from levelflow.jets import Jet
from levelflow.networks.lipschitz import LipschitzMLP
from levelflow.networks.siren import SIREN


class Periodic(Field):
    r"""A network on a circle or torus, $f(x, t) = g(E(x, t))$: of period 2 along some axes, and in time.

    E replaces each periodic coordinate u by the two coordinates $(\cos \pi u, \sin \pi u) / \pi$ of a circle of
    circumference 2, which leaves lengths along it as they are, and the others by themselves. So f and all of its
    derivatives agree at u = -1 and u = 1, whatever the weights. In time that is a loop, whose last instant is the first
    again; a shape given at one of its ends is so at both:

        loop = Periodic(SIREN(3, 2), time=True)
        field = solve(Morph({0.5: b, 1.0: a}), loop, at={0.0: a, 0.5: b}, until=1.0)

    In space it is a cell, such as that of a triply periodic surface, `Periodic(SIREN(6, 1), axes=(0, 1, 2))`: the box
    of the field, whose sides along the periodic axes are its longest. What is given there has to repeat itself as well.

    Args:
        network: The network g. It has a coordinate of space more for every periodic axis, and two times for a loop.
        axes: The periodic axes of space.
        time: Whether the time is periodic.

    Raises:
        ValueError: If nothing is periodic, or the coordinates of the network are not as many as needed.
    """

    def __init__(self, network: SIREN | LipschitzMLP, *, axes: Sequence[int] = (), time: bool = False) -> None:
        super().__init__()
        self.network, self.periodic, self.loops = network, tuple(sorted(axes)), bool(time)
        self.space, self.times = network.space - len(self.periodic), 1 if time else network.times
        if not self.periodic and not time:
            raise ValueError("Periodic: nothing is periodic; give axes=(0, 1, 2), or time=True for a loop.")
        if len(set(self.periodic)) < len(self.periodic) or not set(self.periodic) <= set(range(self.space)):
            raise ValueError(
                f"Periodic(axes={tuple(axes)}): of a network of {network.space} space coordinates each of these takes "
                f"two, which leaves {self.space}, numbered from 0; name each axis once, and give SIREN(6, 1) for three "
                "periodic axes, SIREN(3, 1) for one in the plane."
            )
        if time and network.times != 2:
            raise ValueError(
                f"Periodic(time=True): the network has {network.times} time(s), and a circle of times takes two: "
                f"give SIREN({network.space}, 2)."
            )

    def push(self, jet: Jet) -> Jet:
        parts = [
            part
            for i in range(self.space + self.times)
            for part in (
                [jet.components(i, i + 1).pointwise(wave) for wave in (_cosine, _sine)]
                if i in self._circles
                else [jet.components(i, i + 1)]
            )
        ]
        embedded, *rest = parts
        for part in rest:
            embedded = embedded.beside(part)
        return self.network.push(embedded)

    def jet(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None, *, order: int = 1) -> Jet:
        x, t = self._inputs(x, t)
        d, (embedded, slopes, bends, place) = self.network.space, self._embedded(torch.cat([x, t], dim=1))
        inner = self.network.jet(embedded[:, :d], embedded[:, d:], order=order)
        first, second = None, None
        if inner.first is not None:
            first = (inner.first * slopes.to(inner.first)) @ place.to(inner.first)
        if inner.second is not None:
            steep, own = slopes[:, :d].to(inner.second), place[:d, : self.space].to(inner.second)
            second = own.T @ (steep[:, :, None] * inner.second * steep[:, None, :]) @ own
            second = second + torch.diag_embed((inner.gradient * bends[:, :d].to(inner.second)) @ own)
        return Jet(inner.value, first, second, self.space)

    def forward(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None) -> Float[Tensor, " n"]:
        return self.jet(x, t, order=0).value

    def at(self, *t: float | None) -> Field:
        self._check_times(t)
        if not self.loops:
            return Periodic(self.network.at(*t), axes=self.periodic)
        (time,) = t
        if time is None:
            return self
        network = self.network.at(math.cos(math.pi * time) / math.pi, math.sin(math.pi * time) / math.pi)
        return Periodic(network, axes=self.periodic) if self.periodic else network

    @property
    def _circles(self) -> tuple[int, ...]:
        """The periodic coordinates among those of space and time."""
        return (*self.periodic, self.space) if self.loops else self.periodic

    def _embedded(self, z: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """E(z) and the first and second derivatives of its coordinates, (n, m), each in the one that it is made of.

        The last is the matrix (m, d + k) of zeros and ones that says which that is.
        """
        columns, sources = [], []
        for i, u in enumerate(z.unbind(1)):
            waves = (_cosine, _sine) if i in self._circles else (_itself,)
            columns += [torch.stack(wave(u, 2)) for wave in waves]
            sources += [i] * len(waves)
        value, slopes, bends = torch.stack(columns, dim=-1)
        return value, slopes, bends, torch.eye(z.shape[1], dtype=z.dtype, device=z.device)[sources]


def check_cell(network: Field, box: Box | None, *, call: str) -> None:
    """Refuses a box that is not the cell of a network that repeats itself in space.

    Raises:
        ValueError: If there is no box, or a side along a periodic axis is not the longest.
    """
    if not network.periodic:
        return
    if box is None:
        raise ValueError(
            f"{call}: the network is periodic along {_named(network.periodic)}; say what its cell is: {call}(..., "
            "box=Box(...))."
        )
    if any(not math.isclose(box.size[axis], max(box.size), rel_tol=1e-9) for axis in network.periodic):
        raise ValueError(
            f"{call}: the network is periodic along {_named(network.periodic)} with the longest side of the box, "
            f"and the sides are {', '.join(f'{side:g}' for side in box.size)}; make these equal, and the others no "
            "longer."
        )


def _named(axes: Sequence[int]) -> str:
    return ", ".join("xyz"[axis] if axis < 3 else str(axis) for axis in axes)


def _cosine(u: Tensor, order: int) -> tuple[Tensor, ...]:
    c, s = torch.cos(math.pi * u), torch.sin(math.pi * u)
    return (c / math.pi, -s, -math.pi * c)[: order + 1]


def _sine(u: Tensor, order: int) -> tuple[Tensor, ...]:
    c, s = torch.cos(math.pi * u), torch.sin(math.pi * u)
    return (s / math.pi, c, -math.pi * s)[: order + 1]


def _itself(u: Tensor, order: int) -> tuple[Tensor, ...]:
    return (u, torch.ones_like(u), torch.zeros_like(u))[: order + 1]
