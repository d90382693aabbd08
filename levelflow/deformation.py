"""Deforming a field by handles, as if its surface were a thin elastic shell."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.conditions import MARGIN
from levelflow.elasticity import Shell, bending, stretching
from levelflow.elasticity import area_element as area_of
from levelflow.extraction import extract
from levelflow.fields import Continued, Deformed, Map, Placed
from levelflow.flows import Edit
from levelflow.flows.densifying import arap
from levelflow.handles import Handle, HandleWarning
from levelflow.jets import identity
from levelflow.minimising import Batch, Budget, Divergence, Progress, Term, minimise
from levelflow.networks.invertible import InvertibleResNet
from levelflow.shapes.mesh import Mesh

BUDGET = Budget(steps=600)
"""What `deform` takes if nothing is said."""

RATE, STAGES, RIGID, SLACK, MISSED = 1e-2, 8, 30, 1e-4, 5e-3
"""The rate of learning, steps of the first guess and iterations of each, how far off a handle may be for free, and when
it is told that the handles are missed: the last two in half sides of the box."""


def deform(
    field: Placed,
    handles: Sequence[Handle],
    *,
    shell: Shell = Shell(),  # noqa: B008
    network: InvertibleResNet | None = None,
    path: bool = False,
    budget: Budget = BUDGET,
    resolution: int = 96,
    n: int = 1024,
    seed: int = 0,
    on_step: Callable[[Progress], None] | None = None,
    state: Mapping[str, Tensor] | None = None,
) -> Placed:
    r"""Deforms a field so that its surface goes where handles take it, and stretches and bends as little as it can.

    The deformed field is $G = f \circ D$ with an invertible network D, which takes the deformed surface to the one at
    rest. D is trained from the identity towards the least of

    $$w\, \langle (|D(\Phi(y)) - y| - 10^{-4})_+^2 \rangle_{y \in H}
      + \langle (k_S L_S + k_B L_B + k_T L_T)(D^{-1}(y))\, a(y) \rangle_{y \in M},$$

    where w grows from 100 to 1000, $\Phi$ is the motion of the handles, H what they hold of the surface M, and a the
    area of the deformed surface for each of M (`levelflow.elasticity`). The points $D^{-1}(y)$ are followed by a Newton
    step whenever they are used, and move with the weights of D in the gradient too. In the first third of the training
    D is led to a first guess made of the extracted mesh; that part needs no derivatives and is cheap.

    As D is one to one, so is what it does to the surface: nothing is torn, joined or folded through itself. The result
    can be deformed again.

    Args:
        field: A static field in a box, such as one from `fit`, or one that has been deformed already.
        handles: What is asked of its surface, in the units of the field.
        shell: How much the surface resists stretching and bending.
        network: What D begins as; it is not changed. If left out, an `InvertibleResNet` with more blocks the farther
            handles turn.
        path: Whether to return a field in space and time as well, the handles moved by a part t from 0 to 1.
        budget: Steps, or seconds, of training.
        resolution: Cells of the extraction by which the surface is sampled and its handles are found.
        n: How many points of the surface a step draws.
        seed: Of every random choice.
        on_step: Called with the progress after each step.
        state: Where an interrupted deformation goes on from (`Progress.state`).

    Returns:
        The deformed field in the units of the one at rest, in a box with room for the motion.
        `provenance["handles"]` has the mean and the greatest distance between where D takes the targets of the handles
        and where they were, in those units, and `provenance["energy"]` the mean densities of stretching and bending,
        with lengths in half sides of the box.

    Raises:
        TypeError: If the field is not placed in a box.
        ValueError: If it depends on time or is periodic, the network does not fit, or the handles are none, miss the
            surface or contradict each other.
        Divergence: If training fails; its `field` is the last good one.

    Warns:
        HandleWarning: As `Edit` does; and if the handles are not met.

    Reference:
        Yang et al., Geometry Processing with Neural Fields, NeurIPS 2021, Sec. 5.
    """
    if not isinstance(field, Placed):
        raise TypeError(
            f"deform: a field in a box is needed, such as one from fit; this is a {type(field).__name__}. Give "
            "Placed(field, box)."
        )
    if field.times or field.periodic:
        what = "is periodic" if field.periodic else f"depends on {field.times} time(s); give a slice, field.at(t)"
        raise ValueError(f"deform: the field {what}. A deformation is of one surface in one box.")
    motion = Motion.of(field, handles, path=path, resolution=resolution)
    network = _network(network, motion).to(motion.rest)
    deformed = after(field, network, motion.box)
    generator = torch.Generator().manual_seed(seed)
    held = Held(network, motion, n=max(1, n // 2))
    elastic = Elastic(network, motion, field, shell, n=n, generator=generator)
    terms: list[Term] = [Guess(network, motion, n=n), held]
    if shell.order:
        terms.append(elastic)
    try:
        progress = minimise(
            network.parameters(), terms, budget=budget, generator=generator, rate=RATE, on_step=on_step, state=state
        )
    except Divergence as error:
        error.field = deformed
        raise
    missed, scale = held.missed(), motion.box.frame.scale
    deformed.provenance = {"verb": "deform", "seed": seed, "steps": progress.step, "budget": asdict(budget)}
    deformed.provenance |= {"shell": asdict(shell), "energy": elastic.energies()}
    deformed.provenance["handles"] = {"mean": scale * float(missed.mean()), "max": scale * float(missed.max())}
    if missed.mean() > MISSED:
        warnings.warn(
            f"deform: the handles are missed by {scale * float(missed.mean()):.3g} on average. Train for longer, or "
            f"give more than {len(network.blocks)} blocks, network=invertible({field.space}, {network.times}, "
            f"blocks={2 * len(network.blocks)}) or --blocks {2 * len(network.blocks)}: each block can turn and "
            "stretch by so much only.",
            HandleWarning,
            stacklevel=2,
        )
    return deformed


def invertible(space: int, time: int = 0, *, blocks: int = 6, frequencies: int = 3) -> InvertibleResNet:
    """The network that `deform` begins with: many shallow blocks are better than few deep ones."""
    return InvertibleResNet(space, time, blocks=blocks, width=64, depth=1, frequencies=frequencies)


class Guess:
    """What the mesh would do on its own, towards which D is led at first, from stage to stage of the way.

    A map that turns by half a circle is no small step from the identity: led to the end at once it ends up elsewhere.
    Beyond a right angle it is therefore led there in stages; the last has the last quarter, and the handles act from
    then on.
    """

    name, weight, until, spent = "guess", 10.0, 1 / 3, 0.0
    arrived = 0.75 * until

    def __init__(self, network: Map, motion: Motion, *, n: int) -> None:
        self.network, self.motion, self.n = network, motion, n

    def sample(self, generator: torch.Generator) -> Batch:
        m = self.motion
        i, k = (torch.randint(size, (self.n,), generator=generator) for size in (len(m.rest), len(m.times)))
        last = len(m.moved) - 1
        stage = min(last, 1 + int((last - 1) * self.spent / self.arrived)) if m.staged else k
        return m.moved[stage, i], m.rest[i], m.times[k]

    def loss(self, *batch: Tensor) -> Tensor:
        x, y, t = batch
        return ((self.network(x, t) - y) ** 2).sum(1)


class Held:
    """What the handles hold, D(target) = source; each handle is drawn as often as the others.

    Its weight becomes ten times as large towards the end: the surface first finds its form, and then the handles.
    """

    name, weight, spent = "handles", 100.0, 0.0

    def __init__(self, network: Map, motion: Motion, *, n: int) -> None:
        self.network, self.motion, self.n = network, motion, n
        self.since = Guess.arrived if motion.staged else 0.0

    def sample(self, generator: torch.Generator) -> Batch:
        m, self.weight = self.motion, 100 * 10**self.spent
        i = torch.multinomial(m.shares, self.n, replacement=True, generator=generator)
        k = torch.randint(len(m.times), (self.n,), generator=generator)
        return m.targets[k, i], m.rest[m.held[i]], m.times[k]

    def loss(self, *batch: Tensor) -> Tensor:
        return (_length(self._gap(*batch)) - SLACK).relu() ** 2

    @torch.no_grad()
    def missed(self) -> Float[Tensor, " k"]:
        """How far D takes each target from its source, the mean over the parts of the motion."""
        m = self.motion
        y = m.rest[m.held]
        return torch.stack(
            [_length(self._gap(x, y, t.expand(len(y), -1))) for x, t in zip(m.targets, m.times, strict=True)]
        ).mean(0)

    def _gap(self, x: Tensor, y: Tensor, t: Tensor) -> Tensor:
        return self.network(x, t) - y


class Elastic:
    """The energy of the shell at points of the surface at rest, whose places on the deformed one are followed.

    Points that handles hold are drawn a quarter as often as others, and count four times: where the motion is given
    little can be found out. The points are many, as a network learns to stretch between a few.
    """

    name, weight, since = "shell", 1.0, Guess.until
    pool, reach = 50_000, 0.1

    def __init__(
        self,
        network: InvertibleResNet,
        motion: Motion,
        field: Placed,
        shell: Shell,
        *,
        n: int,
        generator: torch.Generator,
    ) -> None:
        self.network, self.shell, self.n = network, shell, n
        x, y, t, self.shares = motion.drawn(self.pool, generator)
        self.y, self.t, self.memory = y, t, {"x": x}
        at_rest = motion.box.frame.from_unit(y.double())
        gradient = field.jet(at_rest, order=1).gradient.detach().to(y)
        self.normal = gradient / _length(gradient)[:, None]

    def sample(self, generator: torch.Generator) -> Batch:
        i = torch.randint(len(self.y), (self.n,), generator=generator).to(self.y.device)
        x, back = self._followed(self.memory["x"][i], self.y[i], self.t[i])
        self.memory["x"][i] = x
        return x, self.t[i], self.normal[i], self.shares[i], back

    def loss(self, *batch: Tensor) -> Tensor:
        x, t, normal, shares, back = batch
        # x = D^-1(y) moves with the weights by -J^-1 dD.
        there = self.network(x, t)
        x = x - ((there - there.detach())[:, None] @ back)[:, 0]
        if self.shell.order < 2:
            return shares * self.shell.density(self.network.push(identity(x, t, order=1)), normal)
        jet, bent = self.network.along(x, t, normal)
        return shares * self.shell.density(jet, normal, bent)

    @torch.no_grad()
    def energies(self) -> dict[str, float]:
        """The mean densities of stretching and bending, for each unit of area at rest."""
        total = dict.fromkeys((stretching, bending), 0.0)
        parts = (self.memory["x"], self.y, self.t, self.normal, self.shares)
        for x, y, t, normal, shares in zip(*(part.split(4096) for part in parts), strict=True):
            for _ in range(8):
                x, _ = self._followed(x, y, t)
            lost = _length(self.network(x, t) - y) > SLACK
            x[lost] = self.network.inverse(y[lost], t[lost])
            jet = self.network.push(identity(x, t, order=2))
            area = area_of(jet, normal)
            for energy in total:
                total[energy] += float((shares * energy(jet, normal) / area).sum())
        return {energy.__name__: value / len(self.y) for energy, value in total.items()}

    @torch.no_grad()
    def _followed(self, x: Tensor, y: Tensor, t: Tensor) -> tuple[Tensor, Tensor]:
        """The points x with D(x, t) = y, by a Newton step of at most the reach; and the transposed J^-1 there."""
        there = self.network.push(identity(x, t, order=1))
        back = torch.linalg.inv(there.gradient)
        step = ((y - there.value)[:, None] @ back)[:, 0]
        return x + step * (self.reach / _length(step).clamp_min(self.reach))[:, None], back


@dataclass(frozen=True)
class Motion:
    """What is asked, in normalised coordinates of a box with room for it, at some parts of the motion; the last is 1.

    Attributes:
        box: The box, and the interval of time if there is one.
        times: The parts as normalised times, (p, k); without columns if only the end counts.
        faces: The faces of the extracted surface, and their areas.
        rest: Its vertices at rest, (n, d).
        moved: Where the first guess has them at each part, (s, n, d); if that is the end alone and something turns by
            more than 90 degrees, at each stage of the way there.
        held: Which of them are held, by handles or for want of any, (h,).
        targets: Where these are to be at each part, (p, h, d).
        shares: How often each of these is drawn, (h,).
        angle: The greatest turn of a handle, in degrees.
    """

    box: Box
    times: Float[Tensor, "p k"]
    faces: tuple[Tensor, Tensor]
    rest: Float[Tensor, "n d"]
    moved: Float[Tensor, "s n d"]
    held: Tensor
    targets: Float[Tensor, "p h d"]
    shares: Float[Tensor, " h"]
    angle: float

    @property
    def staged(self) -> bool:
        """Whether the first guess leads to the end in stages."""
        return len(self.moved) > len(self.times)

    @classmethod
    def of(cls, field: Placed, handles: Sequence[Handle], *, path: bool, resolution: int) -> Motion:
        surface = extract(field, resolution=resolution, refine=2)
        edit = Edit(surface, handles, call="deform")
        stages = 2 * STAGES if path else STAGES
        groups = [*edit.vertices]
        if edit.untouched.any():
            groups.append(np.flatnonzero(edit.untouched))
        held = np.concatenate(groups)
        parts = [stage / stages for stage in range(stages + 1)]
        targets = [
            np.concatenate(
                [
                    *(handle.target(surface.vertices[i], part) for handle, i in zip(handles, groups, strict=False)),
                    surface.vertices[edit.untouched],
                ]
            )
            for part in parts
        ]
        poses = _poses(edit, held, targets)
        angle = max(abs(handle.angle) for handle in handles)
        if not path:
            parts, targets = [1.0], targets[-1:]
            poses = poses if angle > 90 else poses[-1:]
        shares = np.concatenate([np.full(len(group), 1 / max(1, len(group))) for group in groups])
        around = Box.around(np.concatenate(poses[-len(parts) :])).expanded(MARGIN * max(surface.box.size))
        box = field.box.union(around).during(*[(0.0, 1.0)] * path)
        like = next(field.parameters())

        def unit(x: np.ndarray) -> Tensor:
            return box.frame.to_unit(torch.tensor(x)).to(like)

        return cls(
            box,
            2 * torch.tensor([parts if path else []], dtype=torch.float64).mT.reshape(len(parts), -1).to(like) - 1,
            (torch.tensor(surface.faces), torch.tensor(surface.face_areas)),
            unit(surface.vertices),
            torch.stack([unit(pose) for pose in poses]),
            torch.from_numpy(held).to(like.device),
            torch.stack([unit(target) for target in targets]),
            torch.from_numpy(shares),
            angle,
        )

    def drawn(self, n: int, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Points of the surface: where the guess has them, where they are at rest, times, and what they count."""
        faces, areas = self.faces
        d = self.rest.shape[1]
        still = torch.zeros(len(self.rest), dtype=torch.bool)
        still[self.held.cpu()] = True
        often = torch.where(still[faces].all(1), 0.25, 1.0)
        i = torch.multinomial(areas * often, n, replacement=True, generator=generator)
        corner = -torch.rand(n, d, generator=generator).clamp_min(1e-30).log()
        corner = (corner / corner.sum(1, keepdim=True)).to(self.rest)
        k = torch.randint(len(self.times), (n,), generator=generator)
        rest, moved = (
            (corner[:, :, None] * points).sum(1)
            for points in (self.rest[faces[i]], self.moved[k[:, None] - len(self.times), faces[i]])
        )
        counts = 1 / often[i]
        return moved, rest, self.times[k], (counts / counts.mean()).to(rest)


def _poses(edit: Edit, held: np.ndarray, targets: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Where a first guess has all vertices, at rest and at each of the parts after it.

    A surface is as rigid as possible at each part, starting from the one before. The two sides of a closed curve would
    pass through each other that way, and so would those of a surface that is turned by more than a third of a circle;
    there the motions of the handles are blended.
    """
    surface, poses = edit.surface, [edit.surface.vertices]
    rigid = surface.vertices.shape[1] == 3 and max(abs(handle.angle) for handle in edit.handles) <= 120
    stages = len(targets) - 1
    for stage, target in enumerate(targets[1:]):
        if rigid:
            poses.append(arap(surface, held, target, iterations=RIGID, start=poses[-1]))
        else:
            mesh = Mesh(poses[-1], surface.faces)
            poses.append(poses[-1] + edit.displacement(mesh, 1 / stages, time=stage / stages))
    return poses


def _network(given: InvertibleResNet | None, motion: Motion) -> InvertibleResNet:
    """The given network, or one whose blocks can turn as far as the handles do."""
    space, times = motion.rest.shape[1], motion.times.shape[1]
    if given is None:
        return invertible(space, times, blocks=max(6, math.ceil(motion.angle / 15)))
    if (given.space, given.times) != (space, times):
        raise ValueError(
            f"deform: the network has {given.space} space and {given.times} time coordinates; wanted is "
            f"invertible({space}, {times})."
        )
    return copy.deepcopy(given)


def after(field: Placed, deformation: Map, box: Box) -> Placed:
    """The field after a map of normalised coordinates of a box, in that box."""
    scale = box.frame.scale
    lower, upper = (
        tuple((a - c) / scale for a, c in zip(corner, box.center, strict=True))
        for corner in (field.box.lower, field.box.upper)
    )
    return Placed(Deformed(Continued(Placed(field.field, Box(lower, upper))), deformation), box)


def _length(vectors: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    square = (vectors * vectors).sum(1)
    return square.clamp_min(torch.finfo(square.dtype).tiny).sqrt()
