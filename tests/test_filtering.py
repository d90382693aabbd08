"""Scaled curvature against the gain that a ripple must have, and against circles that must stay."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from levelflow import SIREN, Box, Budget, Circle, Divergence, Implicit, Placed, Polygon, Sampling, fit, scale_curvature
from levelflow.curvature import total_curvature
from levelflow.filtering import Curvature, Near, scaled_targets
from levelflow.minimising import Progress
from tests.fields import Explicit, siren

RADIUS, RIPPLES = 0.5, 12
LENGTH = 2 * math.pi * RADIUS / RIPPLES
QUICK = {"budget": Budget(150), "sampling": Sampling(n=512, given=5000)}


def rippled(height: float, *, ripples: int = RIPPLES, half: bool = False) -> Placed:
    """A circle with ripples, all around or, fading in, where y > 0 only."""
    corners = []
    for i in range(600):
        angle = i * math.pi / 300
        share = min(1.0, max(0.0, 4 * math.sin(angle))) if half else 1.0
        radius = RADIUS + share * height * math.cos(ripples * angle)
        corners.append((radius * math.cos(angle), radius * math.sin(angle)))
    generator = torch.Generator().manual_seed(0)
    network = SIREN(2, width=32, depth=2, omega=20.0, generator=generator, dtype=torch.float64)
    return fit(network, Polygon(tuple(corners)), budget=Budget(300), sampling=Sampling(n=512, given=10_000))


@pytest.fixture(scope="module")
def wave() -> Placed:
    return rippled(0.006)


def height(field: Placed) -> float:
    """That of the ripples: the Fourier coefficient of the radius."""
    x = Implicit(field).sample(10_000, generator=torch.Generator().manual_seed(0)).points
    angle = torch.atan2(x[:, 1], x[:, 0])
    parts = torch.stack([torch.ones_like(angle), (RIPPLES * angle).cos(), (RIPPLES * angle).sin()], dim=1)
    return float(torch.linalg.lstsq(parts, x.norm(dim=1, keepdim=True)).solution[1])


@pytest.mark.parametrize(("factor", "ratio"), [(0.0, 1.0), (0.5, 1.5), (2.0, 0.7)])
def test_ripples_are_multiplied_by_the_gain_of_the_filter(wave: Placed, factor: float, ratio: float) -> None:
    field = scale_curvature(wave, factor, wavelength=ratio * LENGTH, threshold=1000.0, **QUICK)
    gain = (1 + factor * ratio**4) / (1 + ratio**4)
    assert height(field) / height(wave) == pytest.approx(gain, abs=0.07)


@pytest.mark.slow
def test_noise_goes_and_the_clean_half_stays() -> None:
    """Ripples of a quarter of the wavelength on one half of a circle."""
    noisy = rippled(0.006, ripples=32, half=True)
    clean = scale_curvature(noisy, 0.0, wavelength=0.25, **QUICK)

    def deviations(field: Placed) -> tuple[float, float]:
        x = Implicit(field).sample(10_000, generator=torch.Generator().manual_seed(0)).points
        off = (x.norm(dim=1) - RADIUS).abs()
        return float(off[x[:, 1] > 0.15].mean()), float(off[x[:, 1] < -0.15].mean())

    before, after = deviations(noisy), deviations(clean)
    assert before[0] > 0.003 and before[1] < 0.0005
    assert after[0] < before[0] / 5
    assert after[1] < 0.0007


def test_a_circle_stays_where_it_is() -> None:
    network = SIREN(2, width=16, depth=2, omega=10.0, generator=torch.Generator().manual_seed(0))
    given = fit(network, Circle(RADIUS), budget=Budget(300), sampling=Sampling(n=512, given=5000))
    field = scale_curvature(given, 0.0, **QUICK)
    radii = Implicit(field).sample(2000, generator=torch.Generator().manual_seed(0)).points.norm(dim=1)
    assert (radii / RADIUS - 1).abs().max() < 0.004
    assert field.provenance["wavelength"] == pytest.approx(0.1 * given.box.frame.scale)
    assert field.provenance["moved"]["mean"] < 0.001


def test_a_field_is_not_changed_and_at_zero_its_curvature_not_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    field = fit(SIREN(2, width=16, depth=1), Circle(0.5), budget=Budget(30), sampling=Sampling(n=256, given=1000))
    before = [p.detach().clone() for p in field.parameters()]
    orders: list[int] = []
    plain = type(field.field).jet

    def jet(self, x: Tensor, t: Tensor | None = None, *, order: int = 1):
        if self is field.field:
            orders.append(order)
        return plain(self, x, t, order=order)

    monkeypatch.setattr(type(field.field), "jet", jet)
    small = {"budget": Budget(2), "sampling": Sampling(n=64, given=200)}
    scale_curvature(field, 0.0, **small)
    assert 2 not in orders
    scale_curvature(field, 2.0, **small)
    assert 2 in orders
    assert all(torch.equal(a, b) for a, b in zip(before, field.parameters(), strict=True))


def test_curvature_above_the_threshold_is_nothing_to_go_by() -> None:
    """Of two circles only the larger one is asked for its curvature; at a factor of 0 neither is, and both stay."""
    two = Explicit(
        lambda x, t: torch.minimum(
            (x - x.new_tensor([0.5, 0.0])).norm(dim=1) - 0.3, (x + x.new_tensor([0.5, 0.0])).norm(dim=1) - 0.1
        ),
        2,
    )
    angle = torch.arange(20).double()
    ring = torch.stack([angle.cos(), angle.sin()], dim=1)
    x = torch.cat([0.3 * ring + torch.tensor([0.5, 0.0]), 0.1 * ring - torch.tensor([0.5, 0.0])])
    points, targets = scaled_targets(two, x, 2.0, threshold=9.0)
    assert torch.equal(points, x[:20]) and torch.allclose(targets, targets.new_tensor(20 / 3))
    points, targets = scaled_targets(two, x, 0.0, threshold=9.0)
    assert torch.equal(points, x) and not targets.any()


def test_errors_beyond_the_threshold_count_like_a_logarithm() -> None:
    bent = Explicit(lambda x, t: (x * x).sum(1).sqrt() - 0.1, 2)
    x = 0.1 * torch.nn.functional.normalize(torch.randn(20, 2, dtype=torch.float64), dim=1)
    for threshold in (1e-3, 1e4):
        term = Curvature(bent, x, torch.zeros(20).double(), n=20, fine=0.1, threshold=threshold)
        loss = threshold**2 * math.log1p((10 / threshold) ** 2)
        assert torch.allclose(term.loss(*term.sample(torch.Generator().manual_seed(0))), x.new_tensor(loss))


def test_curvature_is_that_of_the_new_surface() -> None:
    """Points of a circle of radius 0.5 are followed to one of 0.4, about which nothing else is known."""
    new = Explicit(lambda x, t: (x * x).sum(1).sqrt() - 0.4, 2)
    x = 0.5 * torch.nn.functional.normalize(torch.randn(50, 2, dtype=torch.float64), dim=1)
    term = Curvature(new, x, torch.full((50,), 2.0).double(), n=50, fine=0.2 * math.pi, threshold=1e6)
    followed, targets = term.sample(torch.Generator().manual_seed(0))
    assert torch.allclose(followed.norm(dim=1), followed.new_tensor(0.4))
    assert torch.allclose(term.loss(followed, targets), followed.new_tensor(0.25))
    assert term.weight == pytest.approx(1e-4)


def test_an_interrupted_run_goes_on_with_the_same_bits() -> None:
    field = fit(SIREN(2, width=16, depth=1), Circle(0.5), budget=Budget(50), sampling=Sampling(n=256, given=1000))
    states: list[dict[str, Tensor]] = []

    def keep(progress: Progress) -> None:
        if progress.step == 5:
            states.append(progress.state())

    more = {"budget": Budget(10), "sampling": Sampling(n=64, given=500)}
    whole = scale_curvature(field, 2.0, **more, on_step=keep)
    rest = scale_curvature(field, 2.0, **more, state=states[0])
    assert all(torch.equal(a, b) for a, b in zip(whole.parameters(), rest.parameters(), strict=True))
    x = field.box.uniform(20, generator=torch.Generator().manual_seed(0))
    kappa = total_curvature(whole.jet(x, order=2))
    assert torch.isfinite(kappa).all() and (whole(x) != field(x)).any()


def test_wrong_use_is_explained(monkeypatch: pytest.MonkeyPatch) -> None:
    field = fit(SIREN(2, width=16, depth=1), Circle(0.5), budget=Budget(50), sampling=Sampling(n=256, given=1000))
    small = {"budget": Budget(2), "sampling": Sampling(n=64, given=200)}
    with pytest.raises(TypeError, match=r"SIREN is no field in a box; make one, fit\(SIREN\(\), shape\)"):
        scale_curvature(siren(2), 0.0)
    moving = Placed(siren(2, 1), Box((-1.0, -1.0), (1.0, 1.0), ((0.0, 1.0),)))
    with pytest.raises(ValueError, match=r"depends on 1 time\(s\); give a slice, scale_curvature\(f.at\(t\)"):
        scale_curvature(moving, 0.0)
    with pytest.raises(ValueError, match=r"scale_curvature\(f, -1\): the factor must be at least 0"):
        scale_curvature(field, -1.0)
    with pytest.raises(ValueError, match=r"wavelength=0, threshold=None\): both must be positive, a length and a"):
        scale_curvature(field, 0.0, wavelength=0.0)
    with pytest.raises(ValueError, match=r"threshold=0.0\): both must be positive"):
        scale_curvature(field, 0.0, threshold=0.0)
    with pytest.raises(ValueError, match=r"threshold=0.001\): the surface is bent more everywhere; give a larger one"):
        scale_curvature(field, 2.0, threshold=0.001, **small)
    monkeypatch.setattr(Near, "loss", lambda self, *batch: self.field(batch[0]) * float("nan"))
    with pytest.raises(Divergence, match="diverged") as caught:
        scale_curvature(field, 0.0, **small)
    assert all(torch.isfinite(p).all() for p in caught.value.field.parameters())
