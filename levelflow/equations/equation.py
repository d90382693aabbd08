"""What an evolution asks of a jet: equations, level-set equations, and their sums."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import reduce
from operator import add

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.curvature import gradient_norm
from levelflow.jets import Jet


class Equation(ABC):
    """A condition on the jet of a field at every point of space-time.

    Attributes:
        order: The order of the jets that it needs, 1 or 2.
        is_speed: Whether its error is a speed of the surface, in length per unit time.
        is_rate: Whether its error is a rate of the values of f, in length per unit time. All values take part then, and
            not the zero set alone.
        sharpens: Whether it is ill-posed backwards in time.
        contracts: Whether a closed surface never leaves its convex hull, forwards in time.
        bounded: Whether its speed stays bounded where the curvature does not.
        bends: Whether it needs derivatives of the curvature, `Jet.curvature`.
        averages: Whether it needs means over the whole surface; it is then to be the whole equation.
        parameter: Which of the times or parameters of the field it moves with, from 0.
    """

    order: int = 1
    is_speed: bool = False
    is_rate: bool = False
    sharpens: bool = False
    contracts: bool = False
    bounded: bool = False
    bends: bool = False
    averages: bool = False
    parameter: int = 0

    @abstractmethod
    def residual(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Tensor:
        """What vanishes for a solution, (n,) or, for several equations at once, (n, r)."""

    def error(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Tensor:
        """The residual in the form that training makes small; the residual itself unless there is a better one."""
        return self.residual(x, t, jet)

    def drives(self, k: int) -> set[int]:
        """Which of k times or parameters the surface moves with by this equation alone."""
        return {column.parameter for column in self.columns if column.is_speed or column.is_rate}

    def unit(self, box: Box) -> float:
        """What brings an error to normalised units on a box; it makes a speed a displacement over half the time."""
        if not (self.is_speed or self.is_rate):
            return 1.0
        first, last = box.times[self.parameter]
        return (last - first) / 2 / box.frame.scale

    def held(self, x: Float[Tensor, "n d"]) -> Bool[Tensor, " n"]:
        """Whether points never move, so that what is given there is given for the whole interval."""
        return torch.zeros(len(x), dtype=torch.bool, device=x.device)

    def draw(self, n: int, *, generator: torch.Generator) -> Float[Tensor, "n k"] | None:
        """Times or parameters for samples, if the field is not wanted for all between the ends; else None."""
        return None

    @property
    def columns(self) -> tuple[Equation, ...]:
        """The equations that the columns of the residual stand for."""
        return (self,)

    @property
    def leads_to(self) -> tuple[Box, ...]:
        """The boxes of the shapes that it takes surfaces to, wherever they come from: a field for it reaches there."""
        return ()

    def carry(
        self, x: Float[Tensor, "n d"], start: Float[Tensor, " n"], end: Float[Tensor, " n"], *, steps: int = 32
    ) -> Float[Tensor, "n d"] | None:
        """Where points of a level set at the times `start` are at the times `end`, if the motion alone decides it.

        None when it depends on the surface as well, as under curvature.
        """
        return None

    def has_characteristics(self, space: int) -> bool:
        """Whether the motion alone decides where points go, in so many space coordinates."""
        origin, now = torch.zeros(1, space, dtype=torch.float64), torch.zeros(1, dtype=torch.float64)
        return self.carry(origin, now, now) is not None

    def _rate(self, jet: Jet) -> Tensor:
        if not jet.dt.shape[1]:
            raise ValueError(f"{self!r}: the field does not depend on time, so nothing can move; give SIREN(time=1).")
        return jet.dt[:, 0]

    def __add__(self, other: Equation) -> Equation:
        return _together(self, other)


class LevelSetEquation(Equation):
    r"""Motion along the normal with a speed: $\partial_t f + v\,|\nabla f| = 0$, $v$ = `speed`.

    A motion of one's own is a subclass with one method, `speed`; `order = 2` says that it needs the Hessian. Sums of
    level-set equations add their speeds.

    Reference:
        Osher and Sethian, Fronts propagating with curvature-dependent speed, J. Comput. Phys. 79 (1988).
    """

    is_speed = True

    @abstractmethod
    def speed(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, " n"]:
        """The speed along the outward normal, in length per unit time."""

    def weight(self, t: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
        """By how much the error of the speed counts at each time; less where the speed has no bound."""
        return torch.ones_like(t[:, 0])

    def residual(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, " n"]:
        return self._rate(jet) + self.speed(x, t, jet) * gradient_norm(jet)

    def error(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, " n"]:
        """The error of the normal speed, v - (-f_t / |grad f|): unlike the residual, a flatter f does not lower it."""
        return (self._rate(jet) / gradient_norm(jet) + self.speed(x, t, jet)) * self.weight(t)

    def __add__(self, other: Equation) -> Equation:
        return Motions(self, other) if isinstance(other, LevelSetEquation) else _together(self, other)


class Motions(LevelSetEquation):
    """Several motions at once: their speeds add up."""

    def __init__(self, *motions: LevelSetEquation) -> None:
        self.motions = motions
        self.order = max(motion.order for motion in motions)
        self.sharpens = any(motion.sharpens for motion in motions)
        self.bounded = all(motion.bounded or motion.order == 1 for motion in motions)
        self.bends = any(motion.bends for motion in motions)
        self.averages = any(motion.averages for motion in motions)

    def __repr__(self) -> str:
        return " + ".join(map(repr, self.motions))

    @property
    def leads_to(self) -> tuple[Box, ...]:
        return tuple(box for motion in self.motions for box in motion.leads_to)

    def speed(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, " n"]:
        return torch.stack([motion.speed(x, t, jet) for motion in self.motions]).sum(0)

    def weight(self, t: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
        return torch.stack([motion.weight(t) for motion in self.motions]).amin(0)

    def held(self, x: Float[Tensor, "n d"]) -> Bool[Tensor, " n"]:
        return torch.stack([motion.held(x) for motion in self.motions]).all(0)


class Together(Equation):
    """Several equations that are to hold at once; one column of the residual for each."""

    def __init__(self, *equations: Equation) -> None:
        self.equations = equations
        self.order = max(equation.order for equation in equations)
        self.sharpens = any(equation.sharpens for equation in equations)
        self.bends = any(equation.bends for equation in equations)
        self.averages = any(equation.averages for equation in equations)
        driven = [column.parameter for column in self.columns if column.is_speed or column.is_rate]
        if len(driven) > len(set(driven)):
            raise ValueError(f"{self!r}: two motions for one parameter; a Family has one for each: Family(a + b, c).")

    def drives(self, k: int) -> set[int]:
        return set().union(*(equation.drives(k) for equation in self.equations))

    def draw(self, n: int, *, generator: torch.Generator) -> Float[Tensor, "n k"] | None:
        drawn = (equation.draw(n, generator=generator) for equation in self.equations)
        return next((parameters for parameters in drawn if parameters is not None), None)

    @property
    def columns(self) -> tuple[Equation, ...]:
        return tuple(column for equation in self.equations for column in equation.columns)

    def __repr__(self) -> str:
        return " + ".join(map(repr, self.equations))

    def residual(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, "n r"]:
        return torch.cat([e.residual(x, t, jet).reshape(len(x), -1) for e in self.equations], dim=1)

    def error(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"], jet: Jet) -> Float[Tensor, "n r"]:
        return torch.cat([e.error(x, t, jet).reshape(len(x), -1) for e in self.equations], dim=1)


def _together(*equations: Equation) -> Equation:
    """The equations at once. There is one motion: speeds add up, wherever in the sum the motions stand.

    What asks for nothing is left out.
    """
    parts = [part for e in equations for part in (e.equations if isinstance(e, Together) else (e,)) if part.columns]
    motions = [part for part in parts if isinstance(part, LevelSetEquation)]
    columns: list[Equation] = [part for part in parts if not isinstance(part, LevelSetEquation)]
    if motions:
        columns.insert(parts.index(motions[0]), reduce(add, motions))
    return columns[0] if len(columns) == 1 else Together(*columns)
