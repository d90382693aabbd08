"""Where points and times are drawn from, and the similarity that normalises them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

Until = float | Sequence[float] | Sequence[float | Sequence[float] | None] | None
"""The other end of an interval, or both ends; for several parameters one of these, or None, for each."""


@dataclass(frozen=True)
class Frame:
    """A similarity between the units of a file and the box [-1, 1]^d of a network, x = center + scale u.

    Attributes:
        center: The point that becomes the origin, in the units of the file.
        scale: The length that becomes 1, in the units of the file.
    """

    center: tuple[float, ...]
    scale: float

    def to_unit(self, x: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Points of the file in normalised coordinates; the difference is taken in float64."""
        center = torch.tensor(self.center, dtype=torch.float64, device=x.device)
        return ((x.double() - center) / self.scale).to(x.dtype)

    def from_unit(self, u: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Normalised points in the units of the file."""
        center = torch.tensor(self.center, dtype=torch.float64, device=u.device)
        return (center + self.scale * u.double()).to(u.dtype)


@dataclass(frozen=True)
class Box:
    """An axis-aligned box in space, with an interval for each time or parameter.

    Attributes:
        lower: The least corner, d numbers, in the units of the shape.
        upper: The greatest corner.
        times: One (first, last) pair per time or parameter; empty for a static field.

    Raises:
        ValueError: If the corners do not match, are not finite, or are not in order.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    times: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        # Numbers arrive as arrays, tensors and ints; a frozen record of floats compares, prints and saves.
        object.__setattr__(self, "lower", tuple(float(v) for v in self.lower))
        object.__setattr__(self, "upper", tuple(float(v) for v in self.upper))
        object.__setattr__(self, "times", tuple((float(a), float(b)) for a, b in self.times))
        if len(self.lower) != len(self.upper) or not self.lower:
            raise ValueError(
                f"Box: the corners have {len(self.lower)} and {len(self.upper)} coordinates; give the same number."
            )
        if not np.isfinite([*self.lower, *self.upper]).all():
            raise ValueError(f"Box: the corners {self.lower} and {self.upper} must be finite numbers.")
        if any(a > b for a, b in zip(self.lower, self.upper, strict=True)):
            raise ValueError(f"Box: the lower corner {self.lower} is not below the upper corner {self.upper}.")
        if any(not a <= b for a, b in self.times):
            raise ValueError(f"Box: the times {self.times} must be pairs (first, last) in order.")

    @classmethod
    def around(cls, points: np.ndarray | Tensor) -> Box:
        """The smallest box that contains (n, d) points."""
        return (
            cls(tuple(points.min(0)), tuple(points.max(0)))
            if isinstance(points, np.ndarray)
            else cls(tuple(points.amin(0).tolist()), tuple(points.amax(0).tolist()))
        )

    @property
    def space(self) -> int:
        """The number d of space coordinates."""
        return len(self.lower)

    @property
    def center(self) -> tuple[float, ...]:
        return tuple((a + b) / 2 for a, b in zip(self.lower, self.upper, strict=True))

    @property
    def size(self) -> tuple[float, ...]:
        """The side lengths."""
        return tuple(b - a for a, b in zip(self.lower, self.upper, strict=True))

    @property
    def frame(self) -> Frame:
        """The similarity that takes the longest side of the box to [-1, 1]."""
        return Frame(self.center, max(self.size) / 2 or 1.0)

    def expanded(self, margin: float) -> Box:
        """The box with every side moved out by `margin`, a length in the units of the box."""
        return Box(tuple(a - margin for a in self.lower), tuple(b + margin for b in self.upper), self.times)

    def cube(self) -> Box:
        """The cube about the same centre whose sides are as long as the longest side of the box."""
        half = max(self.size) / 2
        return Box(tuple(c - half for c in self.center), tuple(c + half for c in self.center), self.times)

    def during(self, *times: tuple[float, float]) -> Box:
        """The same box in space with the given time intervals."""
        return Box(self.lower, self.upper, times)

    def union(self, *others: Box) -> Box:
        """The smallest box that contains this box and the others; times are this box's."""
        boxes: Sequence[Box] = (self, *others)
        if len({box.space for box in boxes}) > 1:
            raise ValueError("Box.union: some shapes lie in the plane and some in space; give shapes of one kind.")
        return Box(
            tuple(min(values) for values in zip(*(b.lower for b in boxes), strict=True)),
            tuple(max(values) for values in zip(*(b.upper for b in boxes), strict=True)),
            self.times,
        )

    def contains(self, x: Float[Tensor, "n d"]) -> Tensor:
        """Whether each point lies in the box, (n,) booleans."""
        return ((x >= x.new_tensor(self.lower)) & (x <= x.new_tensor(self.upper))).all(1)

    def wrapped(self, x: Float[Tensor, "n d"], axes: Sequence[int]) -> Float[Tensor, "n d"]:
        """Points brought into the box along some axes, where what it holds repeats itself with its sides."""
        lower, size = x.new_tensor(self.lower), x.new_tensor(self.size)
        repeats = torch.tensor([i in axes for i in range(self.space)], device=x.device)
        return torch.where(repeats, lower + torch.remainder(x - lower, size), x)

    def uniform(
        self, n: int, *, generator: torch.Generator, dtype: torch.dtype = torch.float64
    ) -> Float[Tensor, "n d"]:
        """n points drawn uniformly from the box."""
        u = torch.rand(n, self.space, generator=generator, dtype=dtype, device=generator.device)
        return u.new_tensor(self.lower) + u * u.new_tensor(self.size)

    def uniform_times(
        self, n: int, *, generator: torch.Generator, dtype: torch.dtype = torch.float64
    ) -> Float[Tensor, "n k"]:
        """n times (or parameters) drawn uniformly from the intervals."""
        u = torch.rand(n, len(self.times), generator=generator, dtype=dtype, device=generator.device)
        first = u.new_tensor([a for a, _ in self.times])
        return first + u * u.new_tensor([b - a for a, b in self.times])


def interval(given: Iterable[float], until: float | Sequence[float] | None, *, call: str) -> tuple[float, float]:
    """The times from the first to the last of those given and asked for.

    Args:
        given: Times at which something is known.
        until: The other end of the interval, or both ends.
        call: Who asks, for the errors.

    Raises:
        ValueError: If a time is not finite, or there is only one.
    """
    ends = () if until is None else until if isinstance(until, Sequence) else (until,)
    times = [float(t) for t in (*given, *ends)]
    if not all(math.isfinite(t) for t in times):
        raise ValueError(f"{call}: the times {times} must be finite numbers.")
    if min(times) == max(times):
        raise ValueError(f"{call}: all is given at t = {times[0]:g}; say how far to go with until=...")
    return min(times), max(times)


def intervals(given: Sequence[Iterable[float]], until: Until, *, call: str) -> list[tuple[float, float]]:
    """The interval of each time or parameter.

    Args:
        given: The values of each at which something is known; none for one that is free.
        until: The other end of its interval, or both ends; one of these for each of several parameters.
        call: Who asks, for the errors.

    Raises:
        ValueError: If an interval is missing, or there are not as many as parameters.
    """
    k = len(given)
    ends = [until] if k == 1 else list(until) if isinstance(until, Sequence) else [until] * k
    if len(ends) != k:
        raise ValueError(f"{call}(until={until}): there are {k} parameters; give an end, or both ends, for each.")
    found = []
    for i, (values, end) in enumerate(zip(given, ends, strict=True)):
        known = list(values)
        if not known and not (isinstance(end, Sequence) and len(end) == 2 and end[0] != end[1]):
            raise ValueError(
                f"{call}(until={until}): nothing is given at a value of parameter {i}; say from where to where it "
                "goes, until=(..., (0, 1))."
            )
        found.append(interval(known, end, call=call if k == 1 else f"{call}, parameter {i}"))  # type: ignore[arg-type]
    return found
