"""Evolving a field by a flow of its mesh."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from levelflow.boxes import Box
from levelflow.conditions import Given, OffSurface, OnSurface, Sampling
from levelflow.curvature import gradient_norm, normal
from levelflow.extraction import EmptyLevelSet, ExtractionWarning, extract
from levelflow.fields import Field, Placed
from levelflow.flows.flow import Flow
from levelflow.keyframed import Keyframed
from levelflow.minimising import Budget, Term, minimise
from levelflow.networks.lifting import replaced
from levelflow.networks.siren import SIREN
from levelflow.shapes.distance import TriangleDistance
from levelflow.shapes.mesh import Mesh, MeshWarning
from levelflow.shapes.sampling import gap

TOLERANCE = 5e-4
"""How far, on average, the surface of a field may be from where the flow takes it: in half sides of the box."""

ROUND, ROUNDS, RATE, HALVINGS = 60, 4, 1e-3, 8
"""Steps of a round of training, rounds before a step of time is halved, the rate of learning, and halvings."""

FOLLOWING = Sampling(n=2048, given=20_000)
"""The samples of a step of `evolve`, which starts from what is almost right."""


@dataclass(frozen=True)
class Step:
    """Where an evolution stands; given to `on_step` after each step of time.

    Attributes:
        number: Steps done.
        steps: Steps in all.
        time: Where the flow has come to.
        mesh: The surface that the step ended with, as the flow moved it.
        field: The field that follows it.
        evolution: The whole evolution until now, to be saved.
        gap: The mean distance of the field's surface from that mesh, in the units of the shape.
        rounds: Rounds of training that it took, of all parts if the step had to be halved.
        parts: Into how many parts the step was divided.
    """

    number: int
    steps: int
    time: float
    mesh: Mesh
    field: Placed
    evolution: Placed
    gap: float
    rounds: int
    parts: int


class NotFollowed(RuntimeError):
    """The field does not come to where the flow takes the surface, however small the step.

    Attributes:
        field: The evolution up to there; None if that is no time at all.
    """

    field: Placed | None = None


class Vanished(NotFollowed):
    """The flow has made the surface vanish."""


def evolve(
    field: Placed,
    flow: Flow,
    *,
    dt: float,
    steps: int,
    box: Box | None = None,
    resolution: int = 96,
    substeps: int = 4,
    tolerance: float = TOLERANCE,
    remesh: bool = True,
    sampling: Sampling = FOLLOWING,
    seed: int = 0,
    on_step: Callable[[Step], None] | None = None,
) -> Placed:
    r"""Evolves a field by a flow of its mesh: extracts, moves the vertices, follows with the field, and repeats.

    Vertices x move by the displacement D(x) of the flow in the time dt, and the network is trained, from where it is,
    towards the distance of the moved mesh. To first order that is the step of the level-set equation,
    $f - \langle \nabla f, D\rangle$ on the surface; beyond it, it is exact for motions along the surface and for
    rotations too, and the field stays a distance, $|\nabla f| = 1$, so that it can be evolved again. What the moved
    mesh winds around counts as inside: bodies that run into each other become one, and necks thinner than a cell of
    the extraction break.

    Training goes on in rounds until the surface follows within the tolerance. Where it does not, the step of time is
    halved, up to eight times.

    Args:
        field: A static field from `fit`; or an evolution, which is continued from its last time.
        flow: What moves the vertices, in the units of the field.
        dt: The length of a step of time.
        steps: How many steps.
        box: Where the field is to be valid, with room for the motion; the box of the field if left out.
        resolution: Cells of the extraction along the longest side of the box.
        substeps: How many steps of the flow a step of time is for the mesh, which costs little.
        tolerance: The mean distance, in half sides of the box, within which the surface is to follow.
        remesh: Whether the surface is extracted anew in each step. Then bodies can merge and break, and no triangle
            becomes bad, but what a step misses stays missed. Else the flow moves one mesh all the way, the surface as
            it is at first, and each step is held to where its points belong: for motions that keep the topology and do
            not stretch triangles too far, such as `flows.Edit`.
        sampling: How many samples a step of training draws.
        seed: Of every random choice. Each step has its own, so that a continued evolution is as one without a break.
        on_step: Called after each step of time.

    Returns:
        The field in space and time, with a key at each step: `Keyframed` networks, placed in the box.

    Raises:
        TypeError: If the field is no network in a box.
        ValueError: If the step, their number, the resolution or the tolerance is not positive.
        NotFollowed: If the surface does not follow; its `field` is the evolution until then.
        Vanished: If there is no surface left.

    Reference:
        Mehta et al., A Level Set Theory for Neural Implicit Evolution under Explicit Flows, ECCV 2022, eqs. 4 and 5.
    """
    if not (dt > 0 and math.isfinite(dt)) or min(steps, substeps) < 1 or not tolerance > 0:
        raise ValueError(
            f"evolve(dt={dt:g}, steps={steps}, substeps={substeps}, tolerance={tolerance:g}): all of them must be "
            "positive."
        )
    networks, times, current = _begun(field, box)
    follower = _Follower(flow, resolution, substeps, tolerance, sampling, seed)
    if not remesh:
        follower.begin(Placed(networks[0], current.box), times)
    last = len(networks) - 1 + steps
    while len(networks) <= last:
        try:
            step = follower.step(networks, times, current, dt, steps=last)
        except NotFollowed as error:
            error.field = _evolution(networks, times, current.box, flow) if len(networks) > 1 else None
            raise
        current = step.field
        networks.append(current.field)
        times.append(step.time)
        if on_step is not None:
            on_step(step)
    return _evolution(networks, times, current.box, flow)


def _begun(field: Placed, box: Box | None) -> tuple[list[Field], list[float], Placed]:
    """The networks and times that there are already, and the last of them in its box."""
    inner = field.field if isinstance(field, Placed) else field
    networks: list[Field] = (
        [f for f in inner.fields if isinstance(f, Field)] if isinstance(inner, Keyframed) else [inner]
    )
    if not isinstance(field, Placed) or not all(isinstance(n, SIREN) and not n.times for n in networks):
        raise TypeError(
            "evolve: a field of static networks in a box is needed, such as one from fit, or an evolution to go on "
            f"with; this is a {type(field).__name__}"
            + (f" of a {type(inner).__name__}." if inner is not field else ".")
        )
    times = [0.0]
    if isinstance(inner, Keyframed):
        times = field.times_in_units(torch.tensor(inner.knots, dtype=torch.float64)[:, None])[:, 0].tolist()
    old = field.box.during()
    if box is not None and (box.lower, box.upper) != (old.lower, old.upper):
        networks = [replaced(n, old, box.during()) for n in networks if isinstance(n, SIREN)]
        old = box.during()
    return networks, times, Placed(networks[-1], old)


def _evolution(networks: Sequence[Field], times: Sequence[float], box: Box, flow: Flow) -> Placed:
    """The networks at their times as one field."""
    first, last = times[0], times[-1]
    knots = [2 * (t - first) / (last - first) - 1 for t in times]
    field = Placed(Keyframed(networks, knots), box.during((first, last)))
    field.provenance = {"verb": "evolve", "flow": repr(flow), "steps": len(networks) - 1}
    return field


@dataclass(frozen=True)
class _Track:
    """Where a surface started, and where its mesh has come to.

    Attributes:
        field: The field at first.
        mesh: Its surface.
        displacement: Of the vertices since.
    """

    field: Placed
    mesh: Mesh
    displacement: np.ndarray

    @property
    def moved(self) -> Mesh:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MeshWarning)
            return Mesh(self.mesh.vertices + self.displacement, self.mesh.faces)


@dataclass
class _Follower:
    """Takes a field along with the flow of its mesh, a step of time after another.

    Attributes:
        track: The mesh that is moved all the way; None if each step has a new one.
    """

    flow: Flow
    resolution: int
    substeps: int
    tolerance: float
    sampling: Sampling
    seed: int
    track: _Track | None = None

    def begin(self, field: Placed, times: Sequence[float]) -> None:
        """Extracts the surface of the first field, and moves it through the times that there are already."""
        self.track = self._extracted(field, times[0])
        for start, end in pairwise(times):
            self.track = self._moved(self.track, start, end - start)

    def step(self, networks: Sequence[Field], times: Sequence[float], field: Placed, dt: float, *, steps: int) -> Step:
        """One step of time, in as many parts as it takes, after those that there are already."""
        number, time = len(networks), times[-1]
        for halvings in range(HALVINGS + 1):
            parts, rounds, current, track = 2**halvings, 0, field, self.track
            generator = torch.Generator().manual_seed(self.seed + 1000 * number + halvings)
            for part in range(parts):
                start = time + part * dt / parts
                moved = self._moved(track or self._extracted(current, start), start, dt / parts)
                track = track and moved
                wanted = _Wanted(moved.moved, self._samples(moved, generator))
                current, gap, taken = self._followed(current, wanted, generator)
                rounds += taken
                if gap > self.tolerance * field.box.frame.scale:
                    break
            else:
                self.track = track
                evolution = _evolution([*networks, current.field], [*times, time + dt], current.box, self.flow)
                return Step(number, steps, time + dt, wanted.mesh, current, evolution, gap, rounds, parts)
        raise NotFollowed(
            f"evolve: from t = {time:g} on the field does not follow the flow: its surface stays {gap:.3g} away on "
            f"average, where {self.tolerance * field.box.frame.scale:.3g} is asked for, even in steps of "
            f"{dt / parts:.3g}. "
            "Give a wider network, a larger `tolerance`, or a smaller `dt`."
        )

    def _extracted(self, field: Placed, time: float) -> _Track:
        """The surface of a field, where it is."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", ExtractionWarning)
                mesh = extract(field, resolution=self.resolution, refine=2)
        except EmptyLevelSet:
            raise Vanished(f"evolve: there is no surface left at t = {time:g}.") from None
        except ExtractionWarning as warning:
            raise NotFollowed(
                f"evolve: at t = {time:g} the surface meets the box of the field; give evolve(box=...) more room."
            ) from warning
        return _Track(field, mesh, np.zeros_like(mesh.vertices))

    def _moved(self, track: _Track, time: float, dt: float) -> _Track:
        """A surface after a part of a step."""
        for i in range(self.substeps):
            part = self._displacement(track.moved, time + i * dt / self.substeps, dt / self.substeps)
            track = replace(track, displacement=track.displacement + part)
        return track

    def _displacement(self, mesh: Mesh, time: float, dt: float) -> np.ndarray:
        """What the flow does to a mesh, if it does what a flow is to do."""
        displacement = self.flow.displacement(mesh, dt, time=time)
        if displacement.shape != mesh.vertices.shape or not np.isfinite(displacement).all():
            raise ValueError(
                f"evolve: {self.flow!r} moves vertices {mesh.vertices.shape} by an array of the shape "
                f"{displacement.shape}" + (" that is not finite." if displacement.shape == mesh.vertices.shape else ".")
            )
        return displacement

    def _samples(self, track: _Track, generator: torch.Generator) -> Given:
        """Points on the moved surface and distances around it.

        The faces of a mesh cut corners, by more after many steps than may be lost, and what is finer than they are they
        do not know. So points of them are brought to the surface of the field itself before they are moved, with the
        normals that it has there. Along these the distance is how far one goes, unless the moved faces say that
        something else is nearer by more than a cell; elsewhere distances from the moved faces are corrected by those of
        the points from which one starts. What has come to lie inside is not on the surface, and distances around it are
        those from what is.
        """
        field, mesh, moved = track.field, track.mesh, track.moved
        n, frame = self.sampling.given, field.box.frame
        cell = max(field.box.size) / self.resolution
        outer, distance = _outside(moved, cell=cell)
        face, shares = _spread(mesh, n, generator)
        x, offset = (
            torch.from_numpy(np.einsum("nk,nkd->nd", shares, of[mesh.faces[face]]))
            for of in (mesh.vertices, track.displacement)
        )
        x, normals = _projected(field, x)
        normals = _turned(mesh, moved, face, normals)
        points, at_surface = x + offset, torch.from_numpy(outer[face])
        within = field.box.contains(points)
        points, normals, at_surface = points[within], normals[within], at_surface[within]
        if at_surface.sum() < 4:
            raise Vanished("evolve: the flow takes the whole surface out of the box of the field.")
        along = torch.randn(len(points), generator=generator, dtype=torch.float64)
        along[2 * len(points) // 3 :] = math.nan
        anyhow = torch.randn(points.shape, generator=generator, dtype=torch.float64)
        along, anyhow = 0.02 * frame.scale * along, 0.1 * frame.scale * anyhow
        near = points + torch.where(along.isnan()[:, None], anyhow, along[:, None] * normals)
        values = distance(near) - torch.where(at_surface, distance(points), 0.0)
        values = torch.where(at_surface & ((values - along).abs() < cell), along, values)
        inside = field.box.contains(near)
        far = field.box.uniform(max(4, n // 4), generator=generator)
        like = next(field.parameters())
        return Given(
            frame.to_unit(points[at_surface]).to(like),
            normals[at_surface].to(like),
            frame.to_unit(near[inside]).to(like),
            (values[inside] / frame.scale).to(like),
            frame.to_unit(far).to(like),
            (distance(far) / frame.scale).to(like),
            distance,
        )

    def _followed(self, field: Placed, wanted: _Wanted, generator: torch.Generator) -> tuple[Placed, float, int]:
        """A field trained from this one towards what is wanted, the gap that is left, and the rounds it took."""
        followed = Placed(copy.deepcopy(field.field), field.box)
        _, on, off = self.sampling.counts()
        terms: list[Term] = [
            OnSurface(followed.field, wanted.given, (), n=self.sampling.n * on // (on + off)),
            OffSurface(followed.field, wanted.given, (), n=self.sampling.n * off // (on + off)),
        ]
        for taken in range(1, ROUNDS + 1):
            minimise(followed.parameters(), terms, budget=Budget(ROUND), generator=generator, rate=RATE / taken)
            gap = _gap(followed, wanted.given)
            if gap <= self.tolerance * field.box.frame.scale:
                break
        return followed, gap, taken


@dataclass(frozen=True)
class _Wanted:
    """A moved mesh, and what it asks of a field."""

    mesh: Mesh
    given: Given


def _outside(mesh: Mesh, *, cell: float) -> tuple[np.ndarray, Callable[[Tensor], Tensor]]:
    """Which faces of a mesh have its inside on one side and the outside on the other, and the distance from them.

    Inside is where the winding number is above 1/2. What is left out are parts of bodies that have run into each other,
    and what has been turned inside out.
    """
    whole = TriangleDistance(mesh.vertices, mesh.faces)
    middles, step = mesh.vertices[mesh.faces].mean(1), 0.01 * cell * np.asarray(mesh.face_normals)
    outer = (whole.winding(middles - step) > 0.5) & (whole.winding(middles + step) < 0.5)
    if not outer.any():
        raise Vanished("evolve: the flow leaves nothing inside of the surface.")
    nearest = TriangleDistance(mesh.vertices, mesh.faces[outer])

    def distance(x: Tensor) -> Tensor:
        points = x.double().numpy()
        return torch.from_numpy(np.where(whole.winding(points) > 0.5, -1.0, 1.0) * nearest.closest(points).distance)

    return outer, distance


@torch.no_grad()
def _gap(field: Placed, given: Given) -> float:
    """The mean distance of the wanted points from the surface of a field, to first order, in units."""
    return float(gap(field.field, given.points).mean()) * field.box.frame.scale


@torch.no_grad()
def _projected(field: Placed, x: Tensor, *, steps: int = 2) -> tuple[Tensor, Tensor]:
    """Points brought to the zero set by Newton steps along the gradient, and its unit normals there."""
    for _ in range(steps):
        jet = field.jet(x, order=1)
        step = (jet.value / gradient_norm(jet) ** 2)[:, None] * jet.gradient
        x = x - step.to(x)
    return x, normal(field.jet(x, order=1)).to(x)


def _turned(mesh: Mesh, moved: Mesh, face: np.ndarray, normals: Tensor) -> Tensor:
    """The unit normals that a motion of the vertices makes of normals at points of some faces.

    On a face the motion takes its sides and its unit normal to those of the moved face: a linear map B, and normals
    change by its inverse transposed. Where the moved face has no area they stay.
    """

    def frame(of: Mesh) -> np.ndarray:
        corners = of.vertices[of.faces[face]]
        return np.concatenate([corners[:, 1:] - corners[:, :1], np.asarray(of.face_normals)[face][:, None]], axis=1)

    before, after = frame(mesh), frame(moved)
    flat = np.abs(np.linalg.det(after)) <= 1e-6 * np.linalg.norm(after, axis=2).prod(1)
    before[flat], after[flat] = np.eye(after.shape[-1]), np.eye(after.shape[-1])
    turned = np.linalg.solve(after, np.einsum("nij,nj->ni", before, normals.numpy())[:, :, None])[:, :, 0]
    return torch.nn.functional.normalize(torch.from_numpy(turned), dim=1)


def _spread(mesh: Mesh, n: int, generator: torch.Generator) -> tuple[np.ndarray, np.ndarray]:
    """n faces drawn by area, and the shares of its corners in a uniform point of each."""
    total = torch.from_numpy(np.cumsum(mesh.face_areas))
    u = torch.rand(n, generator=generator, dtype=torch.float64) * total[-1]
    face = torch.searchsorted(total, u, right=True).clamp_max(len(total) - 1)
    shares = -torch.log1p(-torch.rand(n, mesh.faces.shape[1], generator=generator, dtype=torch.float64))
    return face.numpy(), (shares / shares.sum(1, keepdim=True)).numpy()
