"""Motion by a velocity field, and the velocity fields."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.curvature import gradient_norm
from levelflow.equations.equation import Equation, LevelSetEquation, Motions
from levelflow.jets import Jet

Velocity = Callable[[Tensor, Tensor], Tensor]
"""A velocity field: V(x, t) for points (n, d) and times (n, k), with shape (n, d), in length per unit time."""


class VelocityField:
    """A velocity field that can be added to others."""

    def __call__(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"]) -> Float[Tensor, "n d"]:
        raise NotImplementedError

    def flow(
        self, x: Float[Tensor, "n d"], start: Float[Tensor, " n"], end: Float[Tensor, " n"]
    ) -> Float[Tensor, "n d"] | None:
        """Where points at the times `start` are at the times `end`, if there is a formula for it; else None."""
        return None

    def __add__(self, other: Velocity) -> SumOfVelocities:
        return SumOfVelocities((self, other))


@dataclass(frozen=True)
class SumOfVelocities(VelocityField):
    """V1 + V2 + ..."""

    velocities: tuple[Velocity, ...]

    def __call__(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"]) -> Float[Tensor, "n d"]:
        return reduce(add, (velocity(x, t) for velocity in self.velocities))


@dataclass(frozen=True)
class Constant(VelocityField):
    """The same velocity everywhere, V = b.

    Attributes:
        velocity: b, d numbers in length per unit time.
    """

    velocity: tuple[float, ...]

    def __call__(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"]) -> Float[Tensor, "n d"]:
        if len(self.velocity) != x.shape[1]:
            raise ValueError(
                f"Constant(velocity={self.velocity}): the velocity has {len(self.velocity)} components, "
                f"the points have {x.shape[1]} coordinates."
            )
        return x.new_tensor(self.velocity).expand_as(x)

    def flow(self, x: Float[Tensor, "n d"], start: Float[Tensor, " n"], end: Float[Tensor, " n"]) -> Tensor:
        return x + (end - start)[:, None] * self(x, start[:, None])


@dataclass(frozen=True)
class Rotation(VelocityField):
    r"""Rigid rotation about an axis, $V(x) = \omega\, a \times (x - c)$; in the plane, about a point.

    Attributes:
        rate: The angular velocity $\omega$ in radians per unit time, counter-clockwise seen against the axis.
        axis: The direction a; it is normalised. Not used in the plane.
        center: A point c of the axis; the origin if left out.
    """

    rate: float
    axis: tuple[float, ...] = (0.0, 1.0, 0.0)
    center: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        _check_axis(self, self.axis)

    def __call__(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"]) -> Float[Tensor, "n d"]:
        return self.rate * _turn(_relative(x, self.center), self.axis)

    def flow(self, x: Float[Tensor, "n d"], start: Float[Tensor, " n"], end: Float[Tensor, " n"]) -> Tensor:
        y = _relative(x, self.center)
        return x - y + _turned(y, self.axis, self.rate * (end - start))


@dataclass(frozen=True)
class Twist(VelocityField):
    r"""Twist about an axis, $V(x) = \tau\, \langle a, x - c\rangle\, a \times (x - c)$.

    The field of nise-2023, y (-z, 0, x), is `Twist(-1.0, axis=(0, 1, 0))`.

    Attributes:
        rate: $\tau$, in radians per unit time and unit length along the axis.
        axis: The direction a; it is normalised.
        center: The point of the axis that stands still; the origin if left out.

    Reference:
        Novello et al., Neural Implicit Surface Evolution, ICCV 2023, Sec. 6.1.
    """

    rate: float
    axis: tuple[float, ...] = (0.0, 1.0, 0.0)
    center: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        _check_axis(self, self.axis)

    def __call__(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"]) -> Float[Tensor, "n d"]:
        y = _relative(x, self.center)
        return self._rate(y)[:, None] * _turn(y, self.axis)

    def flow(self, x: Float[Tensor, "n d"], start: Float[Tensor, " n"], end: Float[Tensor, " n"]) -> Tensor:
        y = _relative(x, self.center)
        return x - y + _turned(y, self.axis, self._rate(y) * (end - start))

    def _rate(self, y: Tensor) -> Tensor:
        """The angular velocity at points relative to the center, (n,)."""
        if y.shape[1] != 3:
            raise ValueError(f"{self!r}: a twist needs three space coordinates, and the points have {y.shape[1]}.")
        return self.rate * (y @ _unit(self.axis, y))


@dataclass(frozen=True)
class Source(VelocityField):
    r"""A source, or with negative strength a sink, $V(x) = s\, e^{-|x - c|^2 / w^2}\,(x - c)$.

    The width of nise-2023, $e^{-|x - c|^2 / 0.18}$, is `width=0.18 ** 0.5`.

    Attributes:
        center: c.
        strength: s, per unit time.
        width: w, a length.

    Raises:
        ValueError: If `width` is not positive.

    Reference:
        Novello et al., Neural Implicit Surface Evolution, ICCV 2023, Sec. 6.1.
    """

    center: tuple[float, ...]
    strength: float = 1.0
    width: float = 0.18**0.5

    def __post_init__(self) -> None:
        if not self.width > 0:
            raise ValueError(
                f"Source(width={self.width:g}): the width must be positive; it is the reach of the source."
            )

    def __call__(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"]) -> Float[Tensor, "n d"]:
        y = _relative(x, self.center)
        return self.strength * torch.exp(-(y * y).sum(1, keepdim=True) / self.width**2) * y


class Transport(LevelSetEquation):
    r"""Motion by a velocity field, $\partial_t f + \langle \nabla f, V \rangle = 0$.

    Its solution is known along the characteristics, $f(\Phi_t(x), t) = f_0(x)$ for the flow $\Phi$ of V.

    Args:
        velocity: d numbers for a constant velocity, or V(x, t) for points (n, d) and times (n, k) with values (n, d):
            `Constant`, `Rotation`, `Twist`, `Source`, a sum of these, or a function of your own.

    Raises:
        TypeError: If `velocity` is neither numbers nor a function.

    Reference:
        Novello et al., Neural homotopies (2022), eqs. 2 and 4; Neural Implicit Surface Evolution, ICCV 2023, Sec. 5.1.
    """

    def __init__(self, velocity: Velocity | Sequence[float] | np.ndarray | Tensor) -> None:
        try:
            self.velocity: Velocity = velocity if callable(velocity) else Constant(tuple(float(v) for v in velocity))
        except (TypeError, ValueError):
            raise TypeError(
                f"Transport({velocity!r}): give the components of a constant velocity, such as (0, 1, 0), "
                "or a function V(x, t)."
            ) from None

    def __repr__(self) -> str:
        return f"Transport({self.velocity!r})"

    def speed(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, " n"]:
        return (jet.gradient * self._velocity(x, t)).sum(1) / gradient_norm(jet)

    def carry(
        self, x: Float[Tensor, "n d"], start: Float[Tensor, " n"], end: Float[Tensor, " n"], *, steps: int = 32
    ) -> Float[Tensor, "n d"]:
        """The characteristics from the times `start` to the times `end`.

        By the formula of the velocity field if it has one, else by Runge and Kutta's fourth-order method.
        """
        if isinstance(self.velocity, VelocityField):
            carried = self.velocity.flow(x, start, end)
            if carried is not None:
                return carried
        h = (end - start) / steps
        for i in range(steps):
            t = start + i * h
            k1 = self._velocity(x, t[:, None])
            k2 = self._velocity(x + h[:, None] / 2 * k1, (t + h / 2)[:, None])
            k3 = self._velocity(x + h[:, None] / 2 * k2, (t + h / 2)[:, None])
            k4 = self._velocity(x + h[:, None] * k3, (t + h)[:, None])
            x = x + h[:, None] / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return x

    def _velocity(self, x: Tensor, t: Tensor) -> Tensor:
        v = self.velocity(x, t)
        if v.shape != x.shape:
            raise ValueError(
                f"{self!r}: the velocity has the shape {tuple(v.shape)} at points of the shape {tuple(x.shape)}; "
                "it must return one vector for each point."
            )
        return v

    def __add__(self, other: Equation) -> Equation:
        if isinstance(other, Transport):
            return Transport(SumOfVelocities((self.velocity, other.velocity)))
        return Motions(self, other) if isinstance(other, LevelSetEquation) else super().__add__(other)


def _relative(x: Tensor, center: tuple[float, ...] | None) -> Tensor:
    if center is None:
        return x
    if len(center) != x.shape[1]:
        raise ValueError(f"the center {center} has {len(center)} coordinates, the points have {x.shape[1]}.")
    return x - x.new_tensor(center)


def _check_axis(velocity: VelocityField, axis: tuple[float, ...]) -> None:
    if len(axis) != 3 or not all(math.isfinite(a) for a in axis) or not any(axis):
        raise ValueError(f"{velocity!r}: the axis must be three finite numbers, not all zero, such as (0, 1, 0).")


def _unit(axis: tuple[float, ...], like: Tensor) -> Tensor:
    a = like.new_tensor(axis)
    return a / torch.linalg.vector_norm(a)


def _turned(y: Tensor, axis: tuple[float, ...], angle: Float[Tensor, " n"]) -> Float[Tensor, "n d"]:
    """y turned about the axis, in the plane about the origin, by an angle for each point: Rodrigues' formula."""
    side = _turn(y, axis)
    if y.shape[1] == 2:
        return angle.cos()[:, None] * y + angle.sin()[:, None] * side
    a = _unit(axis, y)
    along = (y @ a)[:, None] * a
    return along + angle.cos()[:, None] * (y - along) + angle.sin()[:, None] * side


def _turn(y: Tensor, axis: tuple[float, ...]) -> Tensor:
    """a x y in space; a quarter turn of y in the plane."""
    if y.shape[1] == 2:
        return torch.stack([-y[:, 1], y[:, 0]], dim=1)
    a1, a2, a3 = _unit(axis, y).tolist()
    return y @ y.new_tensor([[0.0, a3, -a2], [-a3, 0.0, a1], [a2, -a1, 0.0]])
