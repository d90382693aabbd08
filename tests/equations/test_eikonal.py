"""The eikonal equation against distances."""

from __future__ import annotations

import torch

from levelflow.equations.eikonal import Eikonal
from levelflow.shapes.analytic import Circle, Rectangle, Torus
from tests.fields import Explicit, points


def test_distances_solve_it_at_every_time() -> None:
    for solid in (Circle(0.5), Rectangle((1, 2), radius=0.1), Torus(1, 0.4)):
        field = Explicit(lambda x, t, solid=solid: solid.distance(x) * 1.0 + t[:, 0], solid.box.space, 1)
        x, t = points(field, 100)
        assert Eikonal().residual(x, t, field.jet(x, t, order=1)).abs().max() < 1e-12


def test_the_residual_is_by_how_much_the_gradient_is_too_long() -> None:
    field = Explicit(lambda x, t: 3 * x[:, 0] + 4 * x[:, 1], 2)
    x, t = points(field)
    residual = Eikonal().residual(x, t, field.jet(x, t, order=1))
    assert torch.allclose(residual, torch.full_like(residual, 4.0))


def test_motion_by_mean_curvature_contradicts_it() -> None:
    field = Explicit(lambda x, t: ((x * x).sum(1) + 0.4 * t[:, 0]).sqrt() - 0.5, 2, 1)
    x, _ = points(field, 100)
    t = torch.full((100, 1), 0.5, dtype=torch.float64)
    assert (Eikonal().residual(x, t, field.jet(x, t, order=1)) < 0).all()
