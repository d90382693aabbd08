"""The papers' experiments: that each has its place, that records make a document, and that constraints constrain."""

import importlib
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from levelflow import SIREN, Box, Budget, Circle, Sampling, Transported, fit
from levelflow.equations import Constant, MeanCurvature, Transport
from levelflow.jets import identity
from levelflow.measures import residual_table
from levelflow.shapes import Rectangle
from tests.fields import siren

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks"
SQUARE = Box((-1.0, -1.0), (1.0, 1.0))
QUICK = {"budget": Budget(steps=250), "sampling": Sampling(n=512, given=8000)}

APPENDIX = {
    "sphere-transport", "armadillo-transport", "cube", "dumbbell", "armadillo", "cube-sphere", "armadillo-sphere",
    "woman-armadillo", "buddha-armadillo", "armadillo-armadillo",
}  # fmt: skip
PAPER = {"twist", "source-sink", "smoothing", "sharpening", "spot-bob", "falcon", "initialisation"}
SUPPLEMENT = {"interval", "rate", "proportions", "width", "shapes"}


@pytest.fixture
def script(monkeypatch):
    """Imports a script of the folder as its neighbours do."""
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module


def record(results, name, **more):
    given = {"title": "A ball", "source": "a paper", "setting": "small", "published": "large", "claim": "It is round."}
    return results.Record(name=name, **given | more)


def test_every_experiment_of_the_papers_is_there(script):
    papers = script("papers")
    assert set(papers.EXPERIMENTS) == APPENDIX | PAPER | SUPPLEMENT
    assert {papers.PUBLISHED_COLUMNS[name][0] for name in ("twist", "source-sink")} == {1}
    assert {papers.PUBLISHED_COLUMNS[name][0] for name in ("cube", "dumbbell", "armadillo")} == {2}
    for experiment in papers.EXPERIMENTS.values():
        assert experiment.laptop.steps < experiment.published.steps
        assert experiment.laptop.width <= experiment.published.width


def test_passes_over_a_cloud_are_steps(script):
    papers = script("papers")
    assert papers.EXPERIMENTS["cube"].published.steps == 8000 * 40_000 // 5000
    assert papers._epochs(10, 100, 1000) == 10


def test_a_record_is_read_as_it_was_written(script, tmp_path):
    results = script("results")
    written = record(results, "ball", lines=[["radius", 0.5, None]], columns={"ours": [0.1] * 6}, seconds=3.0)
    written.write(tmp_path)
    assert results.Record.read(tmp_path / "ball.json") == written
    assert json.loads((tmp_path / "ball.json").read_text())["name"] == "ball"


def test_a_document_is_put_together_from_records(script, tmp_path):
    results = script("results")
    columns = {"ours": [1e-4, 2.0, 1e-4, 1e-4, 1e-4, 1e-4]}
    record(results, "second", table=1, columns=columns, published_columns=[1e-3] * 6).write(tmp_path)
    record(results, "first", lines=[["radius", 0.51234, "no number"]], notes=["It is small."]).write(tmp_path)
    (tmp_path / "first.png").touch()
    text = results.document(tmp_path, ["first", "second", "third"], {1: ("balls", "All of them."), 2: ("none", "")})
    assert text.index("## first") < text.index("## second") and "Not run yet: third." in text
    assert "![A ball](first.png)" in text and "second.png" not in text
    assert "## Table 1: balls" in text and "Table 2" not in text
    assert (
        "| ours | 0.0001 | 2 | 0.0001 | 0.0001 | 0.0001 | 0.0001 | on-surface max |" in text and "All of them." in text
    )
    assert "| radius | 0.51 | no number |" in text and "It is small." in text


def test_what_is_greater_or_no_number_misses(script):
    results = script("results")
    found = record(results, "x", columns={"ours": [1.0, 2.0, float("nan"), 0.0, 0.0, 0.0]}, published_columns=[1.0] * 6)
    assert found.missed("ours") == ["on-surface max", "off-surface mean"]


def test_a_picture_is_small(script, tmp_path):
    results = script("results")
    noise = np.random.default_rng(0).integers(0, 256, (400, 500, 3), dtype=np.uint8)
    results.keep(noise, tmp_path / "noise.png")
    assert 0 < (tmp_path / "noise.png").stat().st_size <= results.LARGEST


def test_curves_fall_to_the_right(script):
    """The last column with ink has it lower than the first, for a loss that falls."""
    picture = script("studies").plot([[(1.0, 1.0), (50.0, 0.1), (100.0, 0.01)]], width=200, height=100)
    rows, columns = np.nonzero((picture < 60).all(2))
    assert rows[columns == columns.min()].mean() < 30 and rows[columns == columns.max()].mean() > 70


def test_the_order_of_the_paper_is_counted(script):
    studies = script("studies")
    lines = [["a", 1.0, 1.0, 2.0, 3.0], ["b", 2.0, 0.5, 3.0, 0.1]]
    text = studies.agreement(lines, {"data": [(0, 1)], "equation": [(0, 1)]})
    assert "1 of 1 (data, lifted), 1 of 1 (data, standard), 0 of 1 (equation, lifted)" in text
    assert "the lifted start is the better one in 3 of 4" in text
    longest = {
        name: max(max(pair) for pairs in order.values() for pair in pairs) for name, order in studies.ORDERS.items()
    }
    assert longest == {"interval": 8, "rate": 6, "proportions": 2, "width": 8}


def test_distances_are_asked_for_everywhere(script, generator):
    """`fit` knows the distance near the surface; the constraints, wherever the box is."""
    network = SIREN(2, width=24, depth=2)
    found = script("constraints").fit(network, Circle(0.3), SQUARE, **QUICK)
    usual = fit(network, Circle(0.3), box=SQUARE, **QUICK)
    x = SQUARE.uniform(500, generator=generator)
    distance = Circle(0.3).distance(x)
    off, other = ((f(x) - distance).abs().mean() for f in (found, usual))
    assert off < 0.02 and other > 3 * off


def test_the_residual_is_asked_for_everywhere(script, generator):
    """A circle that is moved: from one that stands still, the residual falls and the start stays."""
    constraints, motion = script("constraints"), Transport(Constant((0.2, 0.0)))
    still = constraints.fit(SIREN(2, width=24, depth=2), Circle(0.3), SQUARE, **QUICK)
    moved = constraints.solve(motion, still, Circle(0.3), interval=(0.0, 1.0), **QUICK)
    table = residual_table(moved, motion, Circle(0.3), time=0.0, generator=generator)
    assert moved.box.times == ((0.0, 1.0),)
    assert table.equation.mean < 0.02 and table.surface.mean < 0.01
    x = torch.tensor([[0.5, 0.0], [-0.1, 0.0], [0.9, 0.0]], dtype=torch.float64)
    assert moved.at(1.0)(x).tolist() == pytest.approx([0.0, 0.0, 0.4], abs=0.06)


def test_the_root_of_the_time_has_exact_jets_and_slices(script, generator):
    clock = script("constraints").RootClock(siren(2, 1))
    x = 2 * torch.rand(9, 2, generator=generator, dtype=torch.float64) - 1
    t = 2 * torch.rand(9, 1, generator=generator, dtype=torch.float64) - 1
    jet, pushed = clock.jet(x, t, order=2), clock.push(identity(x, t, order=2))
    for fast, plain in ((jet.value, pushed.value), (jet.first, pushed.first), (jet.hessian, pushed.hessian)):
        assert torch.allclose(fast, plain, rtol=0, atol=1e-13)
    h = 1e-6
    slope = (clock(x, t + h) - clock(x, t - h)) / (2 * h)
    assert torch.allclose(jet.dt[:, 0], slope, rtol=0, atol=1e-7)
    assert torch.allclose(clock.at(0.25)(x), clock(x, torch.full_like(t, 0.25)), rtol=0, atol=1e-13)


def test_a_corner_that_melts_is_followed_by_the_root_of_the_time(script, generator):
    """Only where an equation of second order begins at the shape; and most of the samples are early then."""
    constraints, square = script("constraints"), Rectangle((0.8, 0.8))
    still = constraints.fit(SIREN(2, width=24, depth=2), square, SQUARE, **QUICK)
    melted = constraints.solve(MeanCurvature(0.1), still, square, interval=(0.0, 0.3), **QUICK)
    other = constraints.solve(MeanCurvature(0.1), still, square, interval=(-0.3, 0.3), **QUICK)
    assert isinstance(melted.field, constraints.RootClock) and isinstance(other.field, SIREN)
    (z,) = constraints.Everywhere(melted, MeanCurvature(0.1), n=8000, weight=1.0).sample(generator)
    early = (z[:, 2] < -0.98).double().mean()
    assert early == pytest.approx(0.8 * 0.01**0.5 + 0.2 * 0.01, rel=0.2)
    corner = torch.tensor([[0.38, 0.38]], dtype=torch.float64)
    assert melted.at(0.3)(corner) > 0.02 > still(corner)


def test_the_usual_greatest_values_of_a_circle_that_is_too_large(script):
    """On the surface and off it by the same everywhere, and still: what stands still solves its equation."""
    still = Transport(Constant((0.0, 0.0)))
    large = Transported(still, Circle(0.4), box=SQUARE.during((0.0, 1.0)))
    found = script("experiments").usual_greatest(large, still, Circle(0.3), samples=3)
    assert found == pytest.approx([0.1, 0.1, 0.0], abs=1e-6)


@pytest.mark.slow
def test_an_experiment_leaves_a_record_a_picture_and_the_document(script, tmp_path):
    papers = script("papers")
    found = papers.run("sphere-transport", tmp_path, steps=60)
    papers.assemble(tmp_path)
    assert found == script("results").Record.read(tmp_path / "sphere-transport.json")
    assert "60 steps" in found.setting and found.seconds > 0
    assert (tmp_path / "sphere-transport.png").stat().st_size <= script("results").LARGEST
    assert "![A sphere of radius 1/2" in (tmp_path / "README.md").read_text()
