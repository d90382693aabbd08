"""Smoothing and sharpening: a field with the curvature of its surface scaled."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict

import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.conditions import BAND, Given, Sampling, pick
from levelflow.curvature import gradient_norm, total_curvature
from levelflow.fields import Field, Placed
from levelflow.measures import accuracy
from levelflow.minimising import Batch, Budget, Divergence, Progress, Term, minimise
from levelflow.shapes.implicit import Implicit

FINE = 0.1
"""The wavelength up to which curvature is scaled if none is given, in units of half the longest side of the box."""

FILTER_BUDGET = Budget(steps=400)
"""What `scale_curvature` takes if nothing is said: about a minute on two cores."""

_RATE = 1e-3
_AT_ONCE = 1 << 12


def scale_curvature(
    field: Field,
    factor: float,
    *,
    wavelength: float | None = None,
    threshold: float | None = None,
    budget: Budget = FILTER_BUDGET,
    sampling: Sampling = Sampling(given=50_000),  # noqa: B008
    seed: int = 0,
    on_step: Callable[[Progress], None] | None = None,
    state: Mapping[str, Tensor] | None = None,
) -> Placed:
    r"""A field whose surface is near that of another, with its finer curvature multiplied by a factor.

    A factor below 1 smooths, 0 most; one above 1 sharpens. With S the surface of the field f, u the distance from it
    to the new surface and $\beta$ the factor, what is minimised is

    $$\int_S u^2 + \Big(\frac{\ell}{2\pi}\Big)^4 (\kappa - \beta\,\kappa_f)^2\, dA$$

    and, off the surface, $(|\nabla g| - 1)^2$ near it and farther away a value on the right side. The curvature of the
    new surface is taken where Newton steps lead from points of S. The length $\ell$ says what is fine: ripples of a
    small height and the wavelength w are multiplied by

    $$\frac{1 + \beta\,(\ell/w)^4}{1 + (\ell/w)^4},$$

    so those much shorter than $\ell$ by $\beta$, those much longer not at all, and those of just $\ell$ by the mean of
    $\beta$ and 1. A ball of radius r stays a ball, larger by about $4 (1 - \beta)\,(\ell / 2 \pi r)^4$ of its radius:
    a fortieth of a per cent at $\ell = r / 2$ and a factor of 0. Parts thinner than about half of $\ell$ are details
    as well, and swell to blobs at 0.

    Args:
        field: A static field made by `fit`; it is not changed.
        factor: $\beta$, at least 0. At 0 the curvature of the given field is not computed.
        wavelength: $\ell$, in the units of the shape; by default a twentieth of the longest side of the box.
        threshold: Where $|\kappa_f|$ is above this, in 1 / length, it is nothing to go by: at creases, and in what a
            network does between them. Such points are left out, and errors beyond it count like a logarithm only. By
            default $2 \pi / \ell$, the curvature of a ripple of slope 1.
        budget: Steps, or seconds, of training.
        sampling: How many samples a step draws: `space_time` for the curvature.
        seed: Of every random choice.
        on_step: Called with the progress after each step.
        state: Where an interrupted run goes on from (`Progress.state`).

    Returns:
        The new field, in the same box. `provenance["moved"]` says how far its surface is from the given one.

    Raises:
        TypeError: If the field is not one in the units of a shape.
        ValueError: If the field depends on time, the factor is negative, a length or curvature is not positive, or the
            threshold leaves nothing.
        NoSurface: If the field has no surface.
        Divergence: If training fails; its `field` is the last good one.

    Reference:
        Yang et al., Geometry Processing with Neural Fields, NeurIPS 2021, Sec. 4; there with a weight in the place of
        the length, curvature in the whole box, and points
        left out where the new curvature is above the threshold too, so that nothing draws them back.
    """
    if not isinstance(field, Placed):
        raise TypeError(f"scale_curvature: {type(field).__name__} is no field in a box; make one, fit(SIREN(), shape).")
    if field.times:
        raise ValueError(
            f"scale_curvature: the field depends on {field.times} time(s); give a slice, scale_curvature(f.at(t), ...)."
        )
    if not 0 <= factor < math.inf:
        raise ValueError(f"scale_curvature(f, {factor:g}): the factor must be at least 0: 0 smooths most, 2 sharpens.")
    unit = field.box.frame.scale
    length = FINE * unit if wavelength is None else wavelength
    if not 0 < length < math.inf or not (threshold is None or 0 < threshold < math.inf):
        raise ValueError(
            f"scale_curvature(wavelength={length:g}, threshold={threshold}): both must be positive, a length and a "
            f"curvature in the units of the shape; half of its box is {unit:g} long."
        )
    sharpest = 2 * math.pi / length if threshold is None else threshold
    made = Placed(copy.deepcopy(field.field), field.box)
    generator = torch.Generator().manual_seed(seed)
    given = Given.of(
        field,
        field.box,
        n=sampling.given,
        generator=generator,
        like=next(field.parameters()),
        periodic=field.periodic,
    )
    points, targets = scaled_targets(field.field, given.points, factor, threshold=sharpest * unit)
    if not len(points):
        raise ValueError(
            f"scale_curvature(threshold={sharpest:g}): the surface is bent more everywhere; give a larger one."
        )
    n, on, off = sampling.counts()
    fine = length / unit
    terms: list[Term] = [
        Near(made.field, given, n=on),
        Apart(made.field, given, n=off, fine=fine),
        Curvature(made.field, points, targets, n=n, fine=fine, threshold=sharpest * unit),
    ]
    try:
        progress = minimise(
            made.parameters(), terms, budget=budget, generator=generator, rate=_RATE, on_step=on_step, state=state
        )
    except Divergence as error:
        error.field = made
        raise
    made.provenance = {"verb": "filter", "factor": factor, "wavelength": length, "threshold": sharpest}
    made.provenance |= {"seed": seed, "steps": progress.step}
    made.provenance |= {"budget": asdict(budget), "sampling": asdict(sampling)}
    made.provenance["moved"] = accuracy(made, Implicit(field), seed=seed)
    return made


@torch.no_grad()
def scaled_targets(
    field: Field, points: Float[Tensor, "m d"], factor: float, *, threshold: float
) -> tuple[Float[Tensor, "n d"], Float[Tensor, " n"]]:
    """The points where the curvature is to be scaled, and what it is to be there; at a factor of 0 no work at all."""
    if not factor:
        return points, torch.zeros_like(points[:, 0])
    kappa = torch.cat([total_curvature(field.jet(part, order=2)) for part in points.split(_AT_ONCE)])
    kept = kappa.abs() < threshold
    return points[kept], factor * kappa[kept]


class Near:
    """The new surface is near the given one: $g^2$ on that, the square of the distance between them."""

    name = "surface"
    weight = 1.0

    def __init__(self, field: Field, given: Given, *, n: int) -> None:
        self.field, self.given, self.n = field, given, n

    def sample(self, generator: torch.Generator) -> Batch:
        return pick(self.n, self.given.points, generator=generator)

    def loss(self, *batch: Tensor) -> Tensor:
        (x,) = batch
        return self.field(x) ** 2


class Apart:
    r"""Off the surface $(|\nabla g| - 1)^2$ within `BAND`, and g at least half of f where that is not small.

    The errors of a slope become lengths by a tenth of the wavelength. f counts as small below a quarter of it, so that
    the surface is free to move there and no other one appears beyond.
    """

    name = "distance"
    weight = 1.0

    def __init__(self, field: Field, given: Given, *, n: int, fine: float) -> None:
        self.field, self.given, self.n = field, given, n
        self.bond, self.small = (fine / 10) ** 2, fine / 4

    def sample(self, generator: torch.Generator) -> Batch:
        far = self.n // 4
        near = pick(self.n - far, self.given.near, self.given.near_values, generator=generator)
        rest = pick(far, self.given.far, self.given.far_values, generator=generator)
        return tuple(torch.cat(parts) for parts in zip(near, rest, strict=True))

    def loss(self, *batch: Tensor) -> Tensor:
        x, values = batch
        jet, size = self.field.jet(x, order=1), values.abs()
        short = ((size / 2).clamp_max(BAND) - jet.value * values.sign()).clamp_min(0)
        slope = torch.where(size < BAND, (gradient_norm(jet) - 1) ** 2, 0.0)
        return self.bond * slope + torch.where(size > self.small, short**2, 0.0)


class Curvature:
    """The curvature of the new surface where Newton steps lead from points of the given one, and what it is to be."""

    name = "curvature"

    def __init__(
        self,
        field: Field,
        points: Float[Tensor, "m d"],
        targets: Float[Tensor, " m"],
        *,
        n: int,
        fine: float,
        threshold: float,
    ) -> None:
        self.field, self.points, self.targets, self.n = field, points, targets, n
        self.weight, self.threshold = (fine / (2 * math.pi)) ** 4, threshold

    def sample(self, generator: torch.Generator) -> Batch:
        x, targets = pick(self.n, self.points, self.targets, generator=generator)
        return torch.cat([self._followed(part) for part in x.split(_AT_ONCE)]), targets

    def loss(self, *batch: Tensor) -> Tensor:
        x, targets = batch
        jet = self.field.jet(x, order=2)
        kappa = total_curvature(jet)
        error = kappa - targets
        loss = self.threshold**2 * torch.log1p((error / self.threshold) ** 2)
        return torch.where(gradient_norm(jet) > 0.05, loss, 0.0)

    @torch.no_grad()
    def _followed(self, x: Float[Tensor, "n d"], *, steps: int = 2) -> Float[Tensor, "n d"]:
        """Points moved to the new surface."""
        for _ in range(steps):
            jet = self.field.jet(x, order=1)
            step = (jet.value / (gradient_norm(jet) ** 2).clamp_min(0.05))[:, None] * jet.gradient
            x = x - step.clamp(-0.1, 0.1)
        return x
