"""Points of zero sets against the areas of their parts, which are known."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from levelflow.boxes import Box
from levelflow.fields import Field, Placed
from levelflow.shapes.implicit import Implicit, NoSurface
from levelflow.shapes.sampling import sample_surface
from levelflow.shapes.shape import Samples
from tests.fields import Explicit, siren

N = 20_000
CUBE = Box((-1.0,) * 3, (1.0,) * 3)
AXES = (1.0, 0.5, 0.25)


def _share(found: Tensor, exact: float, *, slack: float = 0.0) -> None:
    """The share of samples of which something holds is that of the area, but for chance (four deviations)."""
    assert abs(float(found.double().mean()) - exact) < slack + 4 * math.sqrt(exact * (1 - exact) / len(found))


def _ball(x: Tensor, t: Tensor) -> Tensor:
    return (x * x).sum(1).sqrt() - 0.5


def _ring(x: Tensor, t: Tensor) -> Tensor:
    return (((x[:, :2] ** 2).sum(1).sqrt() - 0.7) ** 2 + x[:, 2] ** 2).sqrt() - 0.1


def _needle(x: Tensor, t: Tensor) -> Tensor:
    """A capsule of radius 0.02 between z = -0.2 and 0.9, beside a ball."""
    along = x[:, 2].clamp(-0.2, 0.9)[:, None] * x.new_tensor([0.0, 0.0, 1.0])
    return torch.minimum((x - along).norm(dim=1) - 0.02, (x - x.new_tensor([0.0, 0.0, -0.7])).norm(dim=1) - 0.2)


def _ellipsoid(x: Tensor, t: Tensor) -> Tensor:
    """A quadratic form, whose slope on the surface is between 2 and 8."""
    return ((x / x.new_tensor(AXES)) ** 2).sum(1) - 1


def test_moments_of_a_sphere(generator: torch.Generator) -> None:
    """Archimedes: each coordinate is uniform."""
    x, n = sample_surface(Explicit(_ball, 3, box=CUBE), N, generator=generator)
    assert x.shape == n.shape == (N, 3) and x.dtype == n.dtype == torch.float64
    assert torch.allclose(n, 2 * x, rtol=0, atol=2e-4)
    z = 2 * x
    deviation = 1 / math.sqrt(N)
    assert z.mean(0).abs().max() < 4 * deviation / math.sqrt(3)
    assert (z.T @ z / N - torch.eye(3) / 3).abs().max() < 4 * deviation * math.sqrt(4 / 45)
    for share in torch.histc(z[:, 2], bins=10, min=-1, max=1) / N:
        assert abs(share - 0.1) < 4 * math.sqrt(0.09 / N)


def test_a_ring_has_more_points_outside_than_inside(generator: torch.Generator) -> None:
    x, _ = sample_surface(Explicit(_ring, 3, box=CUBE), N, generator=generator)
    _share((x[:, :2].norm(dim=1) > 0.7), 0.5 + 0.1 / (math.pi * 0.7))
    _share(x[:, 0] > 0, 0.5)


def test_a_thin_part_has_its_share_and_no_more(generator: torch.Generator) -> None:
    """A shell as wide as that of the start holds almost three times as many points around the needle."""
    x, _ = sample_surface(Explicit(_needle, 3, box=CUBE), N, generator=generator)
    needle, ball = 2 * math.pi * 0.02 * 1.1 + 4 * math.pi * 0.02**2, 4 * math.pi * 0.2**2
    _share(x[:, 2] > -0.4, needle / (needle + ball), slack=0.01)


def test_a_field_that_is_no_distance_is_sampled_by_area(generator: torch.Generator) -> None:
    x, _ = sample_surface(Explicit(_ellipsoid, 3, box=Box((-1.2,) * 3, (1.2,) * 3)), N, generator=generator)
    assert _ellipsoid(x, x).abs().max() < 1e-6
    polar, around = torch.meshgrid(
        (torch.arange(400).double() + 0.5) / 400 * math.pi,
        (torch.arange(800).double() + 0.5) / 400 * math.pi,
        indexing="ij",
    )
    a, b, c = AXES
    u = torch.stack([polar.sin() * around.cos(), polar.sin() * around.sin(), polar.cos()])
    area = polar.sin() * torch.linalg.vector_norm(u * u.new_tensor([b * c, a * c, a * b])[:, None, None], dim=0)
    for axis, bound in ((0, 0.9), (1, 0.4), (2, 0.2)):
        beyond = u[axis].abs() * AXES[axis] > bound
        _share(x[:, axis].abs() > bound, float(area[beyond].sum() / area.sum()), slack=1e-3)


def test_a_curve_is_sampled_by_length(generator: torch.Generator) -> None:
    """A circle as the zero set of a field a hundred times as steep on one side as on the other."""
    steep = Explicit(lambda x, t: torch.exp(4.6 * x[:, 0]) * ((x * x).sum(1) - 0.25), 2, box=Box((-1, -1), (1, 1)))
    x, n = sample_surface(steep, N, generator=generator)
    assert torch.allclose(n, 2 * x, rtol=0, atol=2e-4)
    angle = torch.atan2(x[:, 1], x[:, 0])
    for share in torch.histc(angle, bins=8, min=-math.pi, max=math.pi) / N:
        assert abs(share - 1 / 8) < 4 * math.sqrt(7 / 64 / N)


def test_a_surface_that_leaves_the_box_is_even_up_to_its_sides(generator: torch.Generator) -> None:
    """A line across a square, uniform in x, and as far as the sides."""
    line = Explicit(lambda x, t: x[:, 1] - 0.5 * x[:, 0], 2, box=Box((-1, -1), (1, 1)))
    x, _ = sample_surface(line, N, generator=generator)
    assert x.abs().max() <= 1
    for low, high in ((-1.0, -0.99), (-0.01, 0.0), (0.99, 1.0)):
        _share((x[:, 0] >= low) & (x[:, 0] < high), (high - low) / 2)


def test_a_box_of_ones_own_and_a_slice_are_sampled(generator: torch.Generator) -> None:
    growing = Explicit(lambda x, t: (x * x).sum(1).sqrt() - t[:, 0], 2, 1)
    x, _ = sample_surface(growing.at(0.3), 500, box=Box((0, 0), (1, 1)), generator=generator)
    assert torch.allclose(x.norm(dim=1), x.new_tensor(0.3)) and (x >= 0).all()


@pytest.mark.parametrize("n", [1, 3000])
def test_as_many_come_as_were_asked_for_and_always_the_same(n: int) -> None:
    def drawn() -> Samples:
        ball = Placed(Explicit(_ball, 3), Box((1e4, 0, 0), (1e4 + 4, 4, 4)))
        return sample_surface(ball, n, generator=torch.Generator().manual_seed(3))

    one, two = drawn(), drawn()
    assert len(one.points) == n and torch.equal(one.points, two.points) and torch.equal(one.normals, two.normals)


def test_wrong_use_is_explained(generator: torch.Generator) -> None:
    field: Field = Explicit(_ball, 3, box=CUBE)
    with pytest.raises(ValueError, match=r"depends on 1 time\(s\); give a slice, sample_surface\(f.at\(t\), n\)"):
        sample_surface(siren(2, 1), 5, generator=generator)
    with pytest.raises(ValueError, match=r"no box; say where its surface is with sample_surface\(f, n, box"):
        sample_surface(siren(2), 5, generator=generator)
    with pytest.raises(ValueError, match=r"sample_surface\(f, 0\): give the number of points, at least 1"):
        sample_surface(field, 0, generator=generator)
    with pytest.raises(NoSurface, match=r"no zero in the box .* surface has vanished or lies outside"):
        sample_surface(field, 5, box=Box((3, 3, 3), (4, 4, 4)), generator=generator)


def test_the_shape_of_a_field_draws_the_same_points() -> None:
    field = Explicit(_ball, 3, box=CUBE)
    one = Implicit(field).sample(100, generator=torch.Generator().manual_seed(1))
    two = sample_surface(field, 100, generator=torch.Generator().manual_seed(1))
    assert torch.equal(one.points, two.points)
