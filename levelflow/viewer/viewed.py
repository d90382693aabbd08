"""What the viewer shows: fields and meshes, as something with a surface at each time and values around it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from levelflow.boxes import Box
from levelflow.curvature import gradient_norm, total_curvature
from levelflow.equations.described import equation_of
from levelflow.equations.equation import LevelSetEquation
from levelflow.export.snapshots import Snapshot, on_surface
from levelflow.extraction import EmptyLevelSet, extract
from levelflow.fields import Field
from levelflow.jets import Jet
from levelflow.rendering.quantities import mesh_curvature
from levelflow.shapes.mesh import Mesh

Points = Float[np.ndarray, "n d"]
Scalars = Float[np.ndarray, " n"]

# A pause is possible after so many points: 30 ms of values or jets for three layers of 128 on one core.
_POINTS_AT_ONCE = 1 << 14
_JETS_AT_ONCE = 1 << 11
# The cosine between the normals of a face and of its vertex below which there is an edge to be seen.
_CREASE = 0.75


class Quantity(NamedTuple):
    """What a surface can be coloured by.

    Attributes:
        name: What requests call it.
        label: What it is.
        unit: In words, made of the units of length and time of the shape.
    """

    name: str
    label: str
    unit: str


CURVATURE = Quantity("curvature", "curvature k₁ + k₂", "1/length")
SPEED = Quantity("speed", "normal speed", "length/time")
RESIDUAL = Quantity("residual", "error of the speed", "length/time")


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface at one time, with what it can be coloured by.

    Attributes:
        time: The time or parameters; empty for what stands still.
        mesh: In the units of the shape, with its normals; None when the surface has vanished.
        quantities: One value for each vertex, by the name of the quantity.
        note: Why there is no mesh, in a sentence.
    """

    time: tuple[float, ...]
    mesh: Mesh | None
    quantities: Mapping[str, Scalars]
    note: str = ""


class Viewed(ABC):
    """Something with a surface at each time.

    Attributes:
        name: What the page calls it.
        box: Where it is, and the interval of each time or parameter.
        quantities: What its surfaces can be coloured by.
        shares: The shapes of which its surfaces are mixtures, if they are; its parameters are the shares of all but the
            first, and their sum is at most 1.
    """

    name: str
    box: Box
    quantities: tuple[Quantity, ...]
    shares: tuple[str, ...] = ()

    @abstractmethod
    def surface(self, time: Sequence[float], *, resolution: int, pause: Callable[[], None] = lambda: None) -> Surface:
        """The surface at a time, extracted with so many cells along the longest side of the box.

        `pause` is called every few hundredths of a second: it may wait, or raise to end the work.

        Raises:
            ValueError: If there is no such time.
        """

    @abstractmethod
    def values(self, x: Points, time: Sequence[float]) -> Scalars:
        """The values f(x, t), negative inside.

        Raises:
            ValueError: If there is no such time.
        """

    @abstractmethod
    def snapshot(self, time: Sequence[float], *, resolution: int) -> Snapshot:
        """The surface as it is written to files.

        Raises:
            EmptyLevelSet: If there is no surface at that time.
            ValueError: If there is no such time.
        """


@final
class ViewedField(Viewed):
    """A field of space and any number of times or parameters.

    Args:
        field: A field with a box.
        name: What the page calls it.
        equation: The motion that it was solved for; by default that of its provenance, where it is made of numbers.

    Raises:
        ValueError: If the field has no box.
    """

    def __init__(self, field: Field, *, name: str, equation: LevelSetEquation | None = None) -> None:
        if field.box is None:
            raise ValueError(f"ViewedField({name!r}): the field has no box; give one that is Placed.")
        self.field, self.name, self.box = field, name, field.box
        provenance = getattr(field, "provenance", {})
        mixed = tuple(provenance.get("shares", ()))
        self.shares = mixed if len(mixed) == field.times + 1 else ()
        known = equation if equation is not None else equation_of(provenance)
        self.equation = known if isinstance(known, LevelSetEquation) else None
        moving = (SPEED,) if field.times == 1 else ()
        solved = (RESIDUAL,) if field.times == 1 and self.equation is not None else ()
        self.quantities = (CURVATURE, *moving, *solved)

    def surface(self, time: Sequence[float], *, resolution: int, pause: Callable[[], None] = lambda: None) -> Surface:
        time = tuple(time)
        try:
            mesh = extract(_Pausing(self._at(time), self.box.during(), pause), resolution=resolution)
        except EmptyLevelSet:
            when = f"at t = {', '.join(f'{t:g}' for t in time)}" if time else "in the box of the field"
            return Surface(time, None, {}, f"There is no surface {when}: the field does not change sign.")
        normals, columns = [], []
        for start in range(0, len(mesh.vertices), _JETS_AT_ONCE):
            pause()
            normal, *values = self._on_surface(mesh.vertices[start : start + _JETS_AT_ONCE], time)
            normals.append(normal)
            columns.append(values)
        found = [np.concatenate(column) for column in zip(*columns, strict=True)]
        quantities = {quantity.name: column for quantity, column in zip(self.quantities, found, strict=True)}
        return Surface(time, Mesh(mesh.vertices, mesh.faces, normals=np.concatenate(normals)), quantities)

    def values(self, x: Points, time: Sequence[float]) -> Scalars:
        field = _Pausing(self._at(tuple(time)), self.box.during(), lambda: None)
        with torch.no_grad():
            return field(torch.tensor(x, device=field.device)).double().cpu().numpy()

    def snapshot(self, time: Sequence[float], *, resolution: int) -> Snapshot:
        field = self._at(tuple(time))
        mesh = extract(field, resolution=resolution, refine=3)
        if self.field.times != 1:
            return on_surface(field, mesh, 0.0)
        return on_surface(self.field, mesh, time[0])

    def _at(self, time: tuple[float, ...]) -> Field:
        return self.field.at(*time) if self.field.times or time else self.field

    def _on_surface(self, x: Points, time: tuple[float, ...]) -> list[np.ndarray]:
        """The normals, and the values of each quantity."""
        device = self.field.device
        points = torch.tensor(x, dtype=torch.float64, device=device)
        t = points.new_tensor(time).expand(len(points), -1)
        with torch.no_grad():
            jet = self.field.jet(points, t, order=2)
            found = [jet.gradient / gradient_norm(jet)[:, None]]
            found += [self._quantity(quantity, points, t, jet) for quantity in self.quantities]
        return [np.nan_to_num(column.double().cpu().numpy()) for column in found]

    def _quantity(self, quantity: Quantity, x: Tensor, t: Tensor, jet: Jet) -> Tensor:
        if quantity is CURVATURE:
            return total_curvature(jet)
        if quantity is SPEED:
            return -jet.dt[:, 0] / gradient_norm(jet)
        assert self.equation is not None
        return self.equation.error(x, t, jet)


@final
class ViewedMesh(Viewed):
    """A mesh: it stands still, and its values are signed distances."""

    def __init__(self, mesh: Mesh, *, name: str) -> None:
        self.mesh, self.name = mesh, name
        self.box = mesh.box.expanded(0.05 * max(mesh.box.size))
        self.quantities = (CURVATURE,) if mesh.vertices.shape[1] == 3 else ()

    def surface(self, time: Sequence[float], *, resolution: int, pause: Callable[[], None] = lambda: None) -> Surface:
        """The mesh itself, whatever the resolution, but for vertices at its edges: these are there for each side."""
        self._check(time)
        mesh, vertex = _with_creases(self.mesh)
        return Surface((), mesh, {CURVATURE.name: mesh_curvature(self.mesh)[vertex]} if self.quantities else {})

    def values(self, x: Points, time: Sequence[float]) -> Scalars:
        self._check(time)
        return self.mesh.distance(torch.tensor(x, dtype=torch.float64)).numpy()

    def snapshot(self, time: Sequence[float], *, resolution: int) -> Snapshot:
        self._check(time)
        return Snapshot(0.0, self.mesh)

    def _check(self, time: Sequence[float]) -> None:
        if len(time):
            raise ValueError(f"{self.name}: a mesh stands still; ask for it without a time.")


class _Pausing:
    """A static field that calls `pause` between short evaluations."""

    def __init__(self, field: Field, box: Box, pause: Callable[[], None]) -> None:
        self.field, self.box, self.pause = field, box, pause
        self.device = field.device

    def __call__(self, x: Tensor) -> Tensor:
        parts = []
        for part in x.split(_POINTS_AT_ONCE):
            self.pause()
            parts.append(self.field(part))
        return torch.cat(parts)


def _with_creases(mesh: Mesh) -> tuple[Mesh, Int[np.ndarray, " n"]]:
    """The mesh for pictures, and the old number of each vertex: corners at edges to be seen get their face's normal."""
    normals, number = mesh.vertex_normals, len(mesh.vertices)
    crease = (normals[mesh.faces] * mesh.face_normals[:, None]).sum(2) < _CREASE
    vertex = np.concatenate([np.arange(number), mesh.faces[crease]])
    faces = mesh.faces.copy()
    faces[crease] = np.arange(number, len(vertex))
    own = np.broadcast_to(mesh.face_normals[:, None], (*faces.shape, normals.shape[1]))[crease]
    return Mesh(mesh.vertices[vertex], faces, normals=np.concatenate([normals, own])), vertex
