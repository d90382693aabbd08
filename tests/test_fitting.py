import math

import pytest
import torch

from levelflow import SIREN, Box, Budget, Circle, Divergence, LipschitzMLP, Periodic, Polygon, Rectangle, Sampling, fit
from levelflow.conditions import OnSurface
from levelflow.shapes.cloud import PointCloud
from levelflow.shapes.implicit import Implicit
from tests.fields import Explicit

QUICK = {"budget": Budget(steps=300), "sampling": Sampling(n=1024, given=20_000)}


def network():
    return SIREN(2, width=32, depth=2)


@pytest.mark.parametrize(
    "shape",
    [
        Circle(0.5),
        Circle(40.0, center=(1e5, -3e4)),
        Rectangle((3.0, 2.0), radius=0.4),
        Polygon(((0, 0), (4, 0), (0, 3))),
    ],
    ids=["circle", "far and large", "rounded rectangle", "triangle"],
)
def test_a_fit_reproduces_the_shape_and_says_so(shape, generator):
    field = fit(network(), shape, **QUICK)
    scale = field.box.frame.scale
    points, _ = shape.sample(2000, generator=generator)
    x = field.box.uniform(2000, generator=generator)
    near = shape.distance(x).abs() < 0.1 * scale
    with torch.no_grad():
        assert field(points).abs().mean() < 0.004 * scale
        assert (field(x)[near] - shape.distance(x)[near]).abs().mean() < 0.006 * scale
        far = shape.distance(x).abs() > 0.1 * scale
        assert (field(x)[far].sign() == shape.distance(x)[far].sign()).all()
    accuracy = field.provenance["accuracy"]
    assert accuracy["mean"] < 0.004 * scale
    assert abs(accuracy["mean"] - field(points).abs().mean().item()) < 0.002 * scale


def test_a_point_cloud_is_fitted_from_its_points(generator):
    shape = Circle(2.0)
    points, _ = shape.sample(300, generator=generator)
    field = fit(network(), PointCloud(points.numpy()), **QUICK)
    with torch.no_grad():
        assert field(points).abs().mean() < 0.02
        assert field(torch.zeros(1, 2)).item() < 0 < field(torch.tensor([[2.4, 0.0]])).item()


def test_a_lipschitz_network_is_fitted_and_its_bounds_fall(generator):
    mine, seen = LipschitzMLP(2, width=16, depth=2), []
    field = fit(
        mine,
        Circle(0.5),
        budget=Budget(steps=400),
        sampling=Sampling(n=256, given=5000),
        on_step=lambda progress: seen.append(progress.losses),
    )
    assert {*seen[-1]} == {"surface", "distance", "steepness"}
    points, _ = Circle(0.5).sample(2000, generator=generator)
    with torch.no_grad():
        assert field(points).abs().mean() < 0.01
        assert field.field.lipschitz < 0.7 * mine.lipschitz
        assert field.jet(field.box.uniform(500, generator=generator)).first.abs().sum(1).max() <= field.field.lipschitz


def test_a_box_of_ones_own_is_kept():
    box = Box((-1.0, -2.0), (1.0, 2.0))
    assert fit(network(), Circle(0.5), box=box, budget=Budget(steps=1)).box == box


def test_wrong_use_is_explained(monkeypatch):
    with pytest.raises(ValueError, match=r"depends on 1 time\(s\); give SIREN\(time=0\)"):
        fit(SIREN(2, 1), Circle(0.5))
    with pytest.raises(ValueError, match=r"3 space coordinates, the shape has 2; give LipschitzMLP\(2\)"):
        fit(LipschitzMLP(3), Circle(0.5))
    monkeypatch.setattr(OnSurface, "loss", lambda self, *batch: self.field(batch[0]) * float("nan"))
    with pytest.raises(Divergence, match="diverged") as caught:
        fit(network(), Circle(0.5), budget=Budget(steps=2))
    assert all(torch.isfinite(p).all() for p in caught.value.field.parameters())


def test_a_line_is_fitted_in_a_periodic_box(generator):
    """A wave of height 0.3, far from the origin: all along it the field and its slope go on beyond the sides."""
    box = Box((10.0, -4.0), (14.0, 0.0))

    def wave(x, t):
        return x[:, 1] + 2 - 0.3 * torch.sin(math.pi * (x[:, 0] - 10) / 2)

    key = Explicit(wave, 2, box=box)
    field = fit(Periodic(SIREN(3, width=32, depth=2), axes=(0,)), key, box=box, **QUICK)
    points, _ = Implicit(key).sample(1000, generator=generator)
    with torch.no_grad():
        assert field(points).abs().max() < 0.02
        assert torch.allclose(field(points + points.new_tensor([4.0, 0.0])), field(points), rtol=0, atol=1e-4)
    with pytest.raises(ValueError, match=r"fit: .* with the longest side of the box, and the sides are 4, 5; make"):
        fit(Periodic(SIREN(3, width=8), axes=(0,)), key, box=Box((10.0, -4.0), (14.0, 1.0)))
