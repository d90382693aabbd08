"""A rival: differentiable iso-surface extraction, with the call of `levelflow.evolve`. Not run by itself.

The published method differentiates through the extraction: where the value of the field at a vertex x changes by df,
the vertex moves by -n df, so that

    dx/dtheta = -n df/dtheta,    n = grad f / |grad f|,

and a step of time is one step of descent in the weights theta of the energy whose negative gradient at the vertices is
the flow (eq. 7 of the reference). Here that energy is half the mean squared distance of the vertices from where the
flow takes them. The paper gives no length for the step; here it is the one after which the values at the vertices are,
to first order, closest to what the flow asks for: no other length does better. The direction is the gradient, or that
of another optimiser; with `search=False` the length is the optimiser's own as well.

References:
    Remelli et al., MeshSDF: Differentiable Iso-Surface Extraction, NeurIPS 2020;
    Mehta et al., A Level Set Theory for Neural Implicit Evolution under Explicit Flows, ECCV 2022, Sec. 5.1.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from levelflow import EmptyLevelSet, Field, Keyframed, Mesh, MeshWarning, Placed, extract
from levelflow.curvature import gradient_norm
from levelflow.evolution import Step, Vanished
from levelflow.extraction import ExtractionWarning
from levelflow.flows import Flow

Optimiser = Callable[[Iterable[nn.Parameter]], torch.optim.Optimizer]

GRADIENT: Optimiser = partial(torch.optim.SGD, lr=1.0)
"""Steps along the gradient itself."""


@dataclass(frozen=True)
class Followers:
    r"""Points of the surface of a field, which are thought to move by $dx = -a\,df$ when its values change.

    Attributes:
        points: x.
        response: a, a vector with $\langle a, \nabla f\rangle = 1$ where the points stay on the surface.
        displacement: By how much a flow is to move the points.
    """

    points: Float[Tensor, "n d"]
    response: Float[Tensor, "n d"]
    displacement: Float[Tensor, "n d"]

    def at(self, field: Field) -> Float[Tensor, "n d"]:
        """The points themselves, with derivatives in the weights of the field."""
        value = field(self.points)
        return self.points - self.response * (value - value.detach())[:, None]


Seen = Callable[[Field, Mesh, Float[np.ndarray, "n d"]], Followers]
"""Which points of a field's surface are followed, given its mesh and the displacements of the vertices."""


def vertices(field: Field, mesh: Mesh, displacement: Float[np.ndarray, "n d"]) -> Followers:
    """The vertices of the mesh, which move along the normal."""
    x = torch.tensor(mesh.vertices)
    with torch.no_grad():
        jet = field.jet(x, order=1)
        normal = jet.gradient / gradient_norm(jet)[:, None]
    return Followers(x, normal.to(x), torch.tensor(displacement))


def descend(field: Field, seen: Followers, optimiser: torch.optim.Optimizer, *, search: bool = True) -> None:
    r"""One step of descent in the weights of a field, in place.

    The gradient of $\tfrac{1}{2n} \sum |x(\theta) - x - D|^2$ is $\frac1n \sum \langle a, D\rangle\, df/d\theta$: the
    values at the points are to fall by $\langle a, D\rangle$.

    Args:
        field: What is changed.
        seen: The points x, the a and the D.
        optimiser: Takes a step from the gradient.
        search: Whether that step is then made as long as brings the values closest to what is asked for, to first
            order and in the mean square.
    """
    weights = list(field.parameters())
    before = [weight.detach().clone() for weight in weights]
    optimiser.zero_grad(set_to_none=True)
    (seen.at(field) - seen.points - seen.displacement).square().sum(1).mean().div(2).backward()
    optimiser.step()
    if not search:
        return
    with torch.no_grad():
        steps = [weight - old for weight, old in zip(weights, before, strict=True)]
        for weight, old in zip(weights, before, strict=True):
            weight.copy_(old)
    change = along(field, seen.points, steps)
    fall, square = (seen.response * seen.displacement).sum(1), change.square().sum()
    length = (-(change * fall).sum() / square).clamp_min(0) if square > 0 else square
    with torch.no_grad():
        for weight, step in zip(weights, steps, strict=True):
            weight += length.to(weight) * step


def along(field: Field, x: Float[Tensor, "n d"], steps: Sequence[Tensor]) -> Float[Tensor, " n"]:
    r"""The derivatives of the values at points along steps s of the weights, $\langle df/d\theta, s\rangle$."""
    shares = x.new_zeros(len(x), requires_grad=True)
    slopes = torch.autograd.grad((shares * field(x)).sum(), list(field.parameters()), create_graph=True)
    total = torch.stack([(slope * step).sum() for slope, step in zip(slopes, steps, strict=True)]).sum()
    return torch.autograd.grad(total, shares)[0]


def evolve(
    field: Placed,
    flow: Flow,
    *,
    dt: float,
    steps: int,
    parts: int = 1,
    resolution: int = 96,
    substeps: int = 4,
    optimiser: Optimiser = GRADIENT,
    search: bool = True,
    seen: Seen = vertices,
    on_step: Callable[[Step], None] | None = None,
) -> Placed:
    """Evolves a field by a flow of its mesh: extracts, lets the flow move it, and descends once in the weights.

    Args:
        field: A static field in a box.
        flow: What moves the vertices, in the units of the field.
        dt: The length of a step of time.
        steps: How many steps.
        parts: Into how many parts each step is divided, each with an extraction, a flow and a descent of its own.
        resolution: Cells of the extraction along the longest side of the box.
        substeps: How many steps of the flow a part is for the mesh.
        optimiser: Makes what takes the descents from the weights, once.
        search: Whether each descent is as long as serves best; if not, as long as the optimiser makes it.
        seen: The points that are followed, and how.
        on_step: Called after each step of time; its `gap` is that of the vertices moved in the last part.

    Returns:
        The field in space and time, with a key at each step.

    Raises:
        Vanished: If there is no surface left; its `field` is the evolution until then.
    """
    current = copy.deepcopy(field)
    descent = optimiser(current.parameters())
    networks = [field.field]
    for number in range(1, steps + 1):
        for part in range(parts):
            time = (number - 1 + part / parts) * dt
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", ExtractionWarning)
                    mesh = extract(current, resolution=resolution, refine=2)
            except EmptyLevelSet:
                error = Vanished(f"There is no surface left at t = {time:g}.")
                error.field = _evolution(networks, dt, field) if number > 1 else None
                raise error from None
            displacement = moved(mesh, flow, time, dt / parts, substeps=substeps)
            descend(current, seen(current, mesh, displacement), descent, search=search)
        networks.append(copy.deepcopy(current.field))
        if on_step is not None:
            wanted = mesh.vertices + displacement
            left = float(gap(current, wanted).mean())
            now = Placed(networks[-1], field.box)
            so_far = _evolution(networks, dt, field)
            on_step(Step(number, steps, number * dt, Mesh(wanted, mesh.faces), now, so_far, left, parts, parts))
    return _evolution(networks, dt, field)


def moved(mesh: Mesh, flow: Flow, time: float, dt: float, *, substeps: int) -> Float[np.ndarray, "n d"]:
    """By how much a flow moves the vertices of a mesh in several steps."""
    now = mesh
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshWarning)
        for i in range(substeps):
            part = flow.displacement(now, dt / substeps, time=time + i * dt / substeps)
            now = Mesh(now.vertices + part, mesh.faces)
    return now.vertices - mesh.vertices


@torch.no_grad()
def gap(field: Field, x: Float[np.ndarray, "n d"]) -> Float[Tensor, " n"]:
    """How far points are from the surface of a field, to first order."""
    jet = field.jet(torch.from_numpy(x.copy()), order=1)
    return (jet.value / gradient_norm(jet)).abs()


def _evolution(networks: list[Field], dt: float, field: Placed) -> Placed:
    """Networks at equal steps of time as one field."""
    last = len(networks) - 1
    knots = [2 * i / last - 1 for i in range(last + 1)]
    return Placed(Keyframed(networks, knots), field.box.during((0.0, last * dt)))
