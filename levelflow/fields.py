"""Maps and fields: anything through which a jet can be pushed, and the fields made from other fields."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from levelflow.boxes import Box
from levelflow.jets import Jet, identity


class Map(nn.Module, ABC):
    """A smooth map from R^d x R^k to R^m.

    Attributes:
        space: The number d of space coordinates.
        times: The number k of times or parameters; 0 for a map of space alone.
    """

    space: int
    times: int

    @abstractmethod
    def push(self, jet: Jet) -> Jet:
        """The jet of this map after the one whose jet is given: value (n, d + k) in, value (n, m) out."""

    def forward(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None) -> Tensor:
        """The values of the map, (n, m)."""
        return self.push(identity(*self._inputs(x, t), order=0)).value

    def _inputs(self, x: Tensor, t: Tensor | None) -> tuple[Tensor, Tensor]:
        """Points and times with the shapes of the convention, or an error that says which shape is wrong."""
        name = type(self).__name__
        if x.ndim != 2 or x.shape[1] != self.space:
            raise ValueError(f"{name}: points have shape {tuple(x.shape)}; give (n, {self.space}).")
        if t is None:
            if self.times:
                raise ValueError(
                    f"{name}: this field depends on {self.times} time(s) or parameter(s); "
                    f"give t with shape ({len(x)}, {self.times}), or take a slice with .at(t)."
                )
            t = x.new_zeros(len(x), 0)
        if t.shape != (len(x), self.times):
            raise ValueError(f"{name}: times have shape {tuple(t.shape)}; give ({len(x)}, {self.times}).")
        return x, t


class Field(Map):
    """A scalar map f: R^d x R^k -> R, negative inside the surface f = 0. Values are (n,).

    Attributes:
        box: Where the field stands for a surface, in the units of its points; None if it is not known.
        periodic: The axes of space along which it repeats itself with the sides of its box.
        loops: Whether the last of its times is the first again.
    """

    box: Box | None = None
    periodic: tuple[int, ...] = ()
    loops: bool = False

    @property
    def device(self) -> torch.device:
        """The device of the parameters; the CPU if there are none."""
        return next((parameter.device for parameter in self.parameters()), torch.device("cpu"))

    def jet(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None, *, order: int = 1) -> Jet:
        """Value, first derivatives (order 1) and space Hessian (order 2) at n points, differentiable.

        Args:
            x: Points (n, d).
            t: Times or parameters (n, k); may be left out when k = 0.
            order: 0, 1 or 2.

        Raises:
            ValueError: If a shape or the order does not fit.
        """
        return self.push(identity(*self._inputs(x, t), order=order))

    def at(self, *t: float | None) -> Field:
        """The field of space alone at the given time or parameters; one that is None stays free.

        Raises:
            ValueError: If the number of values is not k, or a value lies outside the interval of the field.
        """
        self._check_times(t)
        return Slice(self, t)

    def carry(
        self, x: Float[Tensor, "n d"], start: Float[Tensor, "n k"], end: Float[Tensor, "n k"]
    ) -> Float[Tensor, "n d"] | None:
        """Where points of a level set at the times `start` are at the times `end`, as far as the field knows.

        None where it knows no more of the motion than its level sets, which say nothing of what moves along them.
        """
        return None

    def _check_times(self, t: Sequence[float | None]) -> None:
        if len(t) != self.times:
            raise ValueError(
                f"at{tuple(t)}: this field depends on {self.times} time(s) or parameter(s); give a number for each, or "
                "None for one that stays (levelflow slice writes such fields)."
            )
        if self.box is not None and self.box.times:
            for value, (first, last) in zip(t, self.box.times, strict=True):
                slack = 1e-9 * max(abs(first), abs(last), last - first)
                if value is not None and not first - slack <= value <= last + slack:
                    raise ValueError(
                        f"at({value:g}): the field was solved for times from {first:g} to {last:g}; "
                        "ask for a time in that interval, or solve for a longer one."
                    )


class Slice(Field):
    """The field x -> f(x, t) at fixed t; of several times or parameters, those that are None stay free."""

    def __init__(self, field: Field, t: Sequence[float | None]) -> None:
        super().__init__()
        self.field = field
        self.t = tuple(None if value is None else float(value) for value in t)
        self.space, self.times = field.space, self.t.count(None)
        self.box = None if field.box is None else _sliced(field.box, self.t)
        self.periodic, self.loops = field.periodic, field.loops and None in self.t

    def push(self, jet: Jet) -> Jet:
        free = [*range(self.space), *(self.space + i for i, value in enumerate(self.t) if value is None)]
        columns = torch.tensor(free, device=jet.value.device)
        fixed = jet.value.new_tensor([0.0] * self.space + [value or 0.0 for value in self.t])

        def padded(planes: Tensor) -> Tensor:
            """Derivative planes of the free coordinates as planes of all of them."""
            return planes.new_zeros(*planes.shape[:-1], len(fixed)).index_copy(-1, columns, planes)

        return self.field.push(
            Jet(
                fixed.expand(len(jet.value), -1).index_copy(-1, columns, jet.value),
                None if jet.first is None else padded(jet.first),
                None if jet.second is None else padded(jet.second),
                jet.space,
            )
        )


class Walk(Field):
    r"""The field of space and one time that walks through the parameters of another, $g(x, s) = f(x, p(s))$.

    The way p is a polyline, walked from its first corner at s = 0 to its last at s = 1 at constant speed, where the
    interval of each parameter counts as one unit of length.

    Args:
        field: The field f, of at least one time or parameter.
        corners: Two or more points of its parameters.

    Raises:
        ValueError: If a corner has not one number for each parameter or lies outside their intervals, or the way has no
            length.
    """

    def __init__(self, field: Field, corners: Sequence[Sequence[float]]) -> None:
        super().__init__()
        self.corners = tuple(tuple(map(float, corner)) for corner in corners)
        for corner in self.corners:
            field._check_times(corner)
        units = (
            [last - first or 1.0 for first, last in field.box.times] if field.box is not None else [1.0] * field.times
        )
        turns = [a for a, b in zip(self.corners, self.corners[1:], strict=False) if a != b] + [*self.corners[-1:]]
        if len(turns) < 2:
            raise ValueError(
                f"Walk(corners={self.corners}): the way has no length; give two different corners or more."
            )
        self._turns = torch.tensor(turns, dtype=torch.float64)
        lengths = torch.linalg.vector_norm(self._turns.diff(dim=0) / self._turns.new_tensor(units), dim=1)
        self._since = torch.cat([lengths.new_zeros(1), lengths.cumsum(0) / lengths.sum()])
        self.field, self.space, self.times = field, field.space, 1
        self.box = None if field.box is None else field.box.during((0.0, 1.0))

    def place(self, s: float) -> tuple[float, ...]:
        """The parameters p(s)."""
        return tuple(self._places(torch.tensor([[s]], dtype=torch.float64))[0][0].tolist())

    def at(self, *t: float | None) -> Field:
        self._check_times(t)
        return self if t[0] is None else self.field.at(*self.place(t[0]))

    def forward(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None) -> Float[Tensor, " n"]:
        x, t = self._inputs(x, t)
        return self.field(x, self._places(t)[0])

    def jet(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None, *, order: int = 1) -> Jet:
        x, t = self._inputs(x, t)
        places, slopes = self._places(t)
        jet = self.field.jet(x, places, order=order)
        if jet.first is None:
            return jet
        rate = (jet.dt * slopes.to(jet.dt)).sum(1, keepdim=True)
        return Jet(jet.value, torch.cat([jet.gradient, rate], dim=1), jet.second, self.space)

    def push(self, jet: Jet) -> Jet:
        places, slopes = self._places(jet.value[:, self.space :])

        def walked(planes: Tensor) -> Tensor:
            """Derivatives of space and s as those of space and p(s), which is straight but at its corners."""
            steps = slopes.reshape(len(slopes), *[1] * (planes.ndim - 2), -1)
            return torch.cat([planes[..., : self.space], planes[..., self.space :] * steps], dim=-1)

        return self.field.push(
            Jet(
                torch.cat([jet.value[:, : self.space], places], dim=1),
                None if jet.first is None else walked(jet.first),
                None if jet.second is None else walked(jet.second),
                jet.space,
            )
        )

    def carry(
        self, x: Float[Tensor, "n d"], start: Float[Tensor, "n k"], end: Float[Tensor, "n k"]
    ) -> Float[Tensor, "n d"] | None:
        return self.field.carry(x, self._places(start)[0], self._places(end)[0])

    def _places(self, s: Float[Tensor, "n 1"]) -> tuple[Float[Tensor, "n k"], Float[Tensor, "n k"]]:
        """The parameters p(s), and their derivatives p'(s)."""
        turns, since = self._turns.to(s), self._since.to(s)
        leg = (torch.searchsorted(since, s[:, 0].contiguous(), right=True) - 1).clamp(0, len(since) - 2)
        slopes = (turns.diff(dim=0) / since.diff()[:, None])[leg]
        return turns[leg] + (s - since[leg][:, None]) * slopes, slopes


class Deformed(Field):
    """The field f o D, for a map D of space: its zero set is the preimage of the zero set of f."""

    def __init__(self, field: Field, deformation: Map) -> None:
        super().__init__()
        if field.times or deformation.space != field.space:
            raise ValueError(
                f"Deformed: a field on R^{field.space} with {field.times} times cannot follow a map on "
                f"R^{deformation.space}; give a static field and a map of the same space."
            )
        self.field, self.deformation = field, deformation
        self.space, self.times = deformation.space, deformation.times

    def push(self, jet: Jet) -> Jet:
        return self.field.push(self.deformation.push(jet))


class Continued(Field):
    """A field beyond its box: there the value at the nearest point of the box, plus the distance to it.

    Networks know nothing of what lies outside of the box that they were trained in. Derivatives jump at its sides.

    Args:
        field: A static field with a box.

    Raises:
        ValueError: If the field depends on time, or no box is known.
    """

    def __init__(self, field: Field) -> None:
        super().__init__()
        if field.times or field.box is None:
            what = f"{field.times} time(s)" if field.times else "no box"
            raise ValueError(f"Continued: the field has {what}; give a static field in a box, Placed(field, box).")
        self.field, self.box = field, field.box
        self.space, self.times = field.space, 0

    def push(self, jet: Jet) -> Jet:
        assert self.box is not None
        x = jet.value
        nearest = x.clamp(x.new_tensor(self.box.lower), x.new_tensor(self.box.upper))
        within = (x == nearest).to(x)
        inner = self.field.push(_masked(jet, nearest, within))
        beyond = _masked(jet, x - nearest, 1 - within)
        square = (beyond.value * beyond.value).sum(1)
        out = square > 0
        gap = square.where(out, 1.0).sqrt()
        unit = beyond.value / gap[:, None]
        first, second = None, None
        if beyond.first is not None:
            first = (beyond.first * unit[:, None]).sum(2)
        if beyond.second is not None:
            assert first is not None
            du, along = beyond.gradient, first[:, : jet.space]
            turned = du @ du.transpose(1, 2) - along[:, :, None] * along[:, None]
            second = (beyond.second * unit[:, None, None]).sum(3) + turned / gap[:, None, None]
        return inner + Jet(gap.where(out, 0.0).to(inner.value), first, second, jet.space).to(inner.value)


def _masked(jet: Jet, value: Tensor, mask: Float[Tensor, "n d"]) -> Jet:
    """The jet with another value and only some components of its derivatives."""
    return Jet(
        value,
        None if jet.first is None else jet.first * mask[:, None],
        None if jet.second is None else jet.second * mask[:, None, None],
        jet.space,
    )


class Sum(Field):
    """The field f + g."""

    def __init__(self, *fields: Field) -> None:
        super().__init__()
        kinds = {(f.space, f.times) for f in fields}
        if len(kinds) != 1:
            raise ValueError(
                f"Sum: the fields have different (space, times): {sorted(kinds)}; give fields of one kind."
            )
        self.fields = nn.ModuleList(fields)
        self.space, self.times = fields[0].space, fields[0].times
        self.box = fields[0].box

    def push(self, jet: Jet) -> Jet:
        first, *rest = (field.push(jet) for field in self.fields)  # type: ignore[operator]
        for other in rest:
            first = first + other
        return first


class Placed(Field):
    r"""A field on the normalised box, in the units of a file: $f(x, t) = s\, g((x - c)/s, \tau(t))$.

    The box gives the centre c, the scale s (half its longest side) and the map $\tau$ that takes each time interval to
    [-1, 1]. A distance stays a distance. Points are normalised in float64, so that large coordinates lose nothing;
    values have the dtype of g.

    Attributes:
        provenance: Where the field comes from, for reports and files: plain values under string keys.
    """

    def __init__(self, field: Field, box: Box) -> None:
        super().__init__()
        if (field.space, field.times) != (box.space, len(box.times)):
            raise ValueError(
                f"Placed: the field has {field.space} space and {field.times} time coordinates, "
                f"the box {box.space} and {len(box.times)}; they must agree."
            )
        self.field = field
        self.box: Box = box
        self.space, self.times = field.space, field.times
        self.periodic, self.loops = field.periodic, field.loops
        self.provenance: dict[str, Any] = {}

    @property
    def dtype(self) -> torch.dtype:
        """The dtype of the parameters of the field inside, in which values are computed."""
        return next(self.field.parameters()).dtype

    def push(self, jet: Jet) -> Jet:
        d, slopes, like = self.space, jet.value.new_tensor(self._slopes), next(self.field.parameters())
        u, tau = self.box.frame.to_unit(jet.value[:, :d]), self.unit_times(jet.value[:, d:])
        inner = Jet(
            torch.cat([u, tau], dim=1),
            None if jet.first is None else jet.first * slopes,
            None if jet.second is None else jet.second * slopes,
            jet.space,
        ).to(like)
        outer, scale = self.field.push(inner), self.box.frame.scale
        return Jet(
            outer.value * scale,
            None if outer.first is None else outer.first * scale,
            None if outer.second is None else outer.second * scale,
            jet.space,
        )

    def forward(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None) -> Tensor:
        return self.box.frame.scale * self.field(*self._unit_inputs(*self._inputs(x, t)))

    def jet(self, x: Float[Tensor, "n d"], t: Float[Tensor, "n k"] | None = None, *, order: int = 1) -> Jet:
        return self.in_units(self.field.jet(*self._unit_inputs(*self._inputs(x, t)), order=order))

    def in_units(self, jet: Jet) -> Jet:
        """The jet of this field, given that of the field inside at the normalised points and times."""
        scale = self.box.frame.scale
        slopes = jet.value.new_tensor(self._slopes)
        return Jet(
            jet.value * scale,
            None if jet.first is None else jet.first * (scale * slopes),
            None if jet.second is None else jet.second / scale,
            jet.space,
        )

    def at(self, *t: float | None) -> Placed:
        self._check_times(t)
        given = torch.tensor([[value or 0.0 for value in t]], dtype=torch.float64)
        unit = [None if value is None else u for value, u in zip(t, self.unit_times(given)[0].tolist(), strict=True)]
        return Placed(self.field.at(*unit), _sliced(self.box, t))

    def unit_times(self, t: Float[Tensor, "n k"]) -> Float[Tensor, "n k"]:
        """Times in [-1, 1], as the field inside takes them."""
        middle = t.new_tensor([(a + b) / 2 for a, b in self.box.times])
        return (t - middle) * t.new_tensor(self._slopes[self.space :])

    def times_in_units(self, t: Float[Tensor, "n k"]) -> Float[Tensor, "n k"]:
        """The inverse of `unit_times`."""
        middle = t.new_tensor([(a + b) / 2 for a, b in self.box.times])
        return middle + t / t.new_tensor(self._slopes[self.space :])

    @property
    def _slopes(self) -> list[float]:
        """The derivatives of the normalised coordinates, space then times, in the coordinates of the file."""
        return [1 / self.box.frame.scale] * self.space + [_time_slope(a, b) for a, b in self.box.times]

    def _unit_inputs(self, x: Tensor, t: Tensor) -> tuple[Tensor, Tensor]:
        return (
            self.box.frame.to_unit(x.double()).to(self.device, self.dtype),
            self.unit_times(t.double()).to(self.device, self.dtype),
        )


def _time_slope(first: float, last: float) -> float:
    """The derivative of the map that takes [first, last] to [-1, 1]; an interval of one instant is left as it is."""
    return 2 / (last - first) if last > first else 1.0


def _sliced(box: Box, t: Sequence[float | None]) -> Box:
    """The same box in space with the intervals of the times that stay free."""
    return box.during(*(interval for value, interval in zip(t, box.times, strict=False) if value is None))
