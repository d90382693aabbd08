"""Fitting a field to a shape."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import asdict

import torch
from torch import Tensor

from levelflow.boxes import Box
from levelflow.conditions import Given, OffSurface, OnSurface, Sampling, box_around, surface_of
from levelflow.fields import Field, Placed
from levelflow.measures import accuracy
from levelflow.minimising import DEFAULT_BUDGET, Budget, Divergence, Progress, Term, minimise
from levelflow.networks.lipschitz import LipschitzMLP
from levelflow.networks.periodic import Periodic, check_cell
from levelflow.networks.siren import SIREN
from levelflow.shapes.shape import Shape
from levelflow.steepness import Steepness


def fit(
    network: SIREN | LipschitzMLP | Periodic,
    shape: Shape | Field,
    *,
    box: Box | None = None,
    budget: Budget = DEFAULT_BUDGET,
    sampling: Sampling = Sampling(),  # noqa: B008
    seed: int = 0,
    on_step: Callable[[Progress], None] | None = None,
    state: Mapping[str, Tensor] | None = None,
) -> Placed:
    r"""Fits a field to the signed distance of a shape.

    The loss is $f^2 + w |\nabla f - n|^2$ on the surface and $(f - d)^2$ off it, with exact distances within a quarter
    of the half box and a bound beyond. A point cloud has no exact distance; it is estimated from the cloud. To a
    `LipschitzMLP` its regulariser is added (`Steepness`).

    Args:
        network: A static network of the space of the shape; it is not changed.
        shape: What to fit.
        box: Where the field is to be valid, in the units of the shape; the box of the shape and a margin if left out.
            The cell of a network that is periodic in space must be given.
        budget: Steps, or seconds, of training.
        sampling: How many samples a step draws.
        seed: Of every random choice.
        on_step: Called with the progress after each step.
        state: Where an interrupted fit goes on from (`Progress.state`).

    Returns:
        The field in the units of the shape. `provenance["accuracy"]` says how far its surface is from the shape, in
        those units.

    Raises:
        TypeError: If what is given is no shape.
        ValueError: If the network depends on time, or its space is not that of the shape.
        Divergence: If training fails; its `field` is the last good one.
    """
    kind = type(network).__name__
    if network.times:
        raise ValueError(f"fit: the network depends on {network.times} time(s); give {kind}(time=0), or call solve.")
    shape = surface_of(shape)
    if shape.box.space != network.space:
        raise ValueError(
            f"fit: the network has {network.space} space coordinates, the shape has {shape.box.space}; "
            f"give {kind}({shape.box.space})."
        )
    check_cell(network, box, call="fit")
    box = (box or box_around([shape.box])).during()
    field = Placed(copy.deepcopy(network), box)
    generator = torch.Generator().manual_seed(seed)
    like = next(field.parameters())
    given = Given.of(shape, box, n=sampling.given, generator=generator, like=like, periodic=network.periodic)
    on, off = sampling.shared_out()
    terms: list[Term] = [OnSurface(field.field, given, (), n=on), OffSurface(field.field, given, (), n=off)]
    if isinstance(field.field, LipschitzMLP):
        terms.append(Steepness(field.field))
    try:
        progress = minimise(field.parameters(), terms, budget=budget, generator=generator, on_step=on_step, state=state)
    except Divergence as error:
        error.field = field
        raise
    field.provenance = {"verb": "fit", "seed": seed, "steps": progress.step}
    field.provenance |= {"budget": asdict(budget), "sampling": asdict(sampling)}
    field.provenance["accuracy"] = accuracy(field, shape, seed=seed)
    return field
