"""The papers' comparisons of settings: two starts of a network, and the supplement's ablations 4.1 to 4.5.

The comparison of starts and 4.5 are in space. The other ablations are of many runs each and are done in the plane, on
the section of the bunny through its middle, where a run takes seconds: what a setting does to the constraints is the
same question there. "Lifted" starts from a field fitted to the shape at rest, lifted to space-time; "standard" from the
usual random weights, without our warm-up, as in the paper.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from experiments import Outcome, Run, Setting, area_rate, columns, frames
from jaxtyping import UInt8
from results import Cell
from torch import Tensor

from levelflow import Box, Field, Mesh, Placed, contact_sheet, extract, fit, solve
from levelflow.equations import MeanCurvature
from levelflow.measures import accuracy, residual_table
from levelflow.minimising import Progress
from levelflow.shapes import Solid
from levelflow.shapes.shape import Samples
from levelflow.shapes.tabulated import Tabulated

STARTS = ("lifted", "standard")


def initialisation(run: Run) -> Outcome:
    """The bunny under curvature from three starts: loss and accuracy against steps and seconds."""
    shape, equation = run.mesh("bunny.obj"), MeanCurvature(1e-3)
    started = time.perf_counter()
    given = fit(run.network(0), shape, budget=run.budget, sampling=run.sampling, seed=run.seed)
    fitting = time.perf_counter() - started
    lines: list[list[Cell]] = []
    curves: dict[str, list[tuple[float, float]]] = {}
    last: dict[str, Placed] = {}
    ways: dict[str, dict[str, object]] = {
        "lifted": {"start": given},
        "standard": {"warm_up": 0.0},
        "standard with our warm-up": {},
    }
    steps = [max(1, run.setting.steps * share // 16) for share in (1, 2, 4, 8, 16)]
    for way, more in ways.items():
        kept: dict[int, tuple[float, dict[str, Tensor]]] = {}
        curve = curves.setdefault(way, [])

        def on_step(now: Progress, kept=kept, curve=curve) -> None:
            data = sum(now.losses[name] for name in ("surface", "distance"))
            if now.step > 1:
                curve.append((now.step, data + now.losses.get("motion", 0.0)))
            if now.step in steps:
                kept[now.step] = now.seconds, now.state()

        field = run.solve(equation, {0.0: shape}, (-0.2, 0.6), on_step=on_step, **more)
        for step, (seconds, state) in kept.items():
            earlier = _restored(field, state)
            error = accuracy(earlier.at(0.0), shape, seed=run.seed)
            surface, *_, residual, _ = columns(earlier, equation, shape)
            found = error["mean"] if error else "no surface"
            lines.append([way, str(step), f"{seconds:.0f}", surface, residual, found])
        last[way] = field
    rows = [list(frames(last[way], (-0.2, 0.0, 0.6))) for way in STARTS]
    pictures = contact_sheet(
        [mesh for row in rows for mesh in row],
        [f"{way}, t = {t:g}" for way in STARTS for t in (-0.2, 0.0, 0.6)],
        columns=3, size=180,
    )  # fmt: skip
    notes = [
        f"The fit that is lifted took {fitting:.0f} s more, once for all evolutions of the shape.",
        "Under the pictures: the loss (its logarithm, a running mean of some 50 steps) against steps; the lifted start "
        "in dark, the standard one in red, the standard one with our warm-up, which leaves the equation out of the "
        "first quarter, in blue.",
    ]
    header = ["start", "steps", "seconds", "on-surface mean", "equation mean", "mean distance at t = 0"]
    moving = ", ".join(f"{way} {area_rate(field, 0.2):.2f}" for way, field in last.items())
    notes.append(
        "Early on the lifted field stands still, which leaves a small residual at a small rate. What has been learnt "
        f"of the motion is in the change of the area at t = 0.2, over that by its curvature, 1 if exact: {moving}."
    )
    picture = np.concatenate([pictures, plot(list(curves.values()), width=pictures.shape[1])])
    return Outcome(picture, lines, notes=notes, header=header)


def _restored(field: Placed, state: Mapping[str, Tensor]) -> Placed:
    """A field as it was at an earlier step."""
    earlier = copy.deepcopy(field)
    with torch.no_grad():
        for i, parameter in enumerate(earlier.parameters()):
            parameter.copy_(state[f"parameter.{i}"])
    return earlier


def plot(
    curves: Sequence[Sequence[tuple[float, float]]], *, width: int, height: int = 180
) -> UInt8[np.ndarray, "h w 3"]:
    """Curves with a logarithmic ordinate, on common axes."""
    from PIL import Image, ImageDraw

    points = np.array([point for curve in curves for point in curve if point[1] > 0])
    low, high = np.log(points[:, 1].min()), np.log(points[:, 1].max())
    last, margin = points[:, 0].max(), 12
    picture = Image.new("RGB", (width, height), (255, 255, 255))
    pen = ImageDraw.Draw(picture)
    for curve, colour in zip(curves, ((40, 40, 40), (200, 60, 50), (60, 90, 200)), strict=False):
        line = [
            (margin + x / last * (width - 2 * margin),
             margin + (high - np.log(y)) / max(high - low, 1e-9) * (height - 2 * margin))
            for x, y in curve if y > 0
        ]  # fmt: skip
        pen.line(line, fill=colour, width=2)
    text = f"loss from {np.exp(high):.1g} to {np.exp(low):.1g} in {last:.0f} steps"
    pen.text((width - margin, margin), text, (90, 90, 90), anchor="ra")
    return np.array(picture)


class Section(Solid):
    """The section x = 0 of a mesh, a region of the plane of (z, y).

    The distance is that to the curve, from marching squares of the mesh's distance.
    """

    def __init__(self, mesh: Mesh) -> None:
        def distance(p: Tensor) -> Tensor:
            return mesh.distance(torch.stack([torch.zeros_like(p[:, 0]), p[:, 1], p[:, 0]], dim=1))

        self.curve = extract(distance, box=Box((-1.0, -1.0), (1.0, 1.0)), resolution=192, refine=2)

    @property
    def box(self) -> Box:
        return self.curve.box

    def distance(self, x: Tensor) -> Tensor:
        return self.curve.distance(x)

    def sample(self, n: int, *, generator: torch.Generator) -> Samples:
        return self.curve.sample(n, generator=generator)


def _both(
    run: Run, setting: Setting, given: Placed, shape: Solid, rate: float, interval: tuple[float, float]
) -> tuple[list[float], Field]:
    """Mean of |f(., 0)| on the curve and mean of |F|, of the lifted start and then of the standard one."""
    found, fields = [], []
    sized = replace(run, setting=setting)
    for start in (given, None):
        field = solve(
            MeanCurvature(rate), sized.network(space=2), at={0.0: shape}, until=interval, start=start,
            warm_up=0.0, budget=sized.budget, sampling=sized.sampling, seed=run.seed,
        )  # fmt: skip
        generator = torch.Generator().manual_seed(5)
        table = residual_table(field, MeanCurvature(rate), shape, time=0.0, n=4000, generator=generator)
        found += [table.surface.mean, table.equation.mean]
        fields.append(field)
    return found, fields[0]


def agreement(lines: Sequence[Sequence[Cell]], order: Mapping[str, Sequence[tuple[int, int]]]) -> str:
    """In how many comparisons the order of the paper is found.

    Args:
        lines: Of an ablation: a label, then data and equation of each start.
        order: For data and equation the pairs of lines of which the first is to be less by the paper.
    """
    parts = []
    for i, name in enumerate(("data", "equation")):
        for j, start in enumerate(STARTS):
            column = 1 + 2 * j + i
            holds = sum(lines[a][column] < lines[b][column] for a, b in order[name])  # type: ignore[operator]
            parts.append(f"{holds} of {len(order[name])} ({name}, {start})")
    lifted = sum(line[i] < line[i + 2] for line in lines for i in (1, 2))  # type: ignore[operator]
    return (
        f"The paper's order is found in {', '.join(parts)} comparisons of lines; the lifted start is the better one in "
        f"{lifted} of {2 * len(lines)}."
    )


def _steps(n: int) -> list[tuple[int, int]]:
    """Each line before the next."""
    return [(i, i + 1) for i in range(n - 1)]


INTERVALS = [(3 * a + b, 3 * a + b + 1) for a in range(3) for b in range(2)] + [(i, i + 3) for i in range(6)]
"""Shorter before longer, and a shorter negative part before a longer one."""

ORDERS: Mapping[str, Mapping[str, Sequence[tuple[int, int]]]] = {
    "interval": {"data": INTERVALS, "equation": INTERVALS},
    "rate": {"data": _steps(7), "equation": _steps(7)},
    "proportions": {"data": [(b, a) for a, b in _steps(3)], "equation": _steps(3)},
    "width": {"data": [(b, a) for a, b in _steps(9)], "equation": [(b, a) for a, b in _steps(9)]},
}
"""What the paper says of the lines of each ablation: which has the smaller constraint."""


def _ablation(
    run: Run, cases: Iterable[tuple[str, Setting, float, tuple[float, float], float]], what: str, name: str
) -> Outcome:
    """A line for each case: label, setting, rate, interval, and the time that is shown."""
    cases = list(cases)
    shape = Tabulated(Section(run.mesh("bunny.obj")), resolution=192)
    narrowest = min(setting.width for _, setting, *_ in cases)
    small = replace(run, setting=replace(run.setting, width=narrowest))
    given = fit(small.network(0, space=2), shape, budget=small.budget, sampling=small.sampling, seed=run.seed)
    lines: list[list[Cell]] = []
    curves, labels = [], []
    for label, setting, rate, interval, shown in cases:
        found, field = _both(run, setting, given, shape, rate, interval)
        lines.append([label, *found])
        curves += frames(field, (shown,), resolution=128)
        labels.append(f"{label}, t = {shown:g}")
    header = [what, *(f"{start}: {name}" for start in STARTS for name in ("data", "equation"))]
    picture = contact_sheet(curves, labels, columns=min(5, len(curves)), size=170)
    note = "In the plane: the section of the bunny; data is the mean |f| on the curve at t = 0, equation the mean |F|."
    return Outcome(picture, lines, notes=[note, agreement(lines, ORDERS[name])], header=header)


def interval(run: Run) -> Outcome:
    """Supplement 4.1: how long the interval is, and whether it has a negative part."""
    cases = [(f"({a:g}, {b:g})", run.setting, 1e-3, (a, b), b) for a in (0.0, -0.1, -0.25) for b in (0.25, 0.5, 1.0)]
    return _ablation(run, cases, "interval", "interval")


def rate(run: Run) -> Outcome:
    """Supplement 4.2: the rate."""
    cases = [(f"{i / 1000:g}", run.setting, i / 1000, (-0.1, 1.0), 1.0) for i in (1, 2, 3, 4, 5, 10, 100)]
    return _ablation(run, cases, "rate", "rate")


def proportions(run: Run) -> Outcome:
    """Supplement 4.3: the shares of the samples on the surface, off it and in space-time."""
    shares = [(0.1, 0.1, 0.8), (0.25, 0.25, 0.5), (0.4, 0.4, 0.2)]
    cases = [
        (f"{on:g}, {off:g}, {rest:g}", replace(run.setting, shares=(rest, on, off)), 1e-3, (-0.1, 1.0), 0.0)
        for on, off, rest in shares
    ]
    return _ablation(run, cases, "on, off, in space-time", "proportions")


def width(run: Run) -> Outcome:
    """Supplement 4.4: nine widths from half of the largest to the largest, as 128, 144, ..., 256 in the paper."""
    largest = run.setting.width
    widths = [largest // 2 + i * largest // 16 for i in range(9)]
    cases = [(str(w), replace(run.setting, width=w), 1e-3, (-0.25, 1.0), 1.0) for w in widths]
    return _ablation(run, cases, "width", "width")


def shapes(run: Run) -> Outcome:
    """Supplement 4.5: five shapes with networks, intervals and rates of their own."""
    cases = (
        ("Bob", "bob.obj", 64, 2, (-0.5, 1.0), 1e-2, 5.04),
        ("Max Planck", "max-planck.obj", 128, 3, (-0.5, 1.0), 2e-3, 7.07),
        ("falcon", "falcon.obj", 160, 3, (-0.1, 1.0), 1e-3, 112.17),
        ("Cheburashka for the witch", "cheburashka.off", 256, 3, (-0.5, 1.0), 1e-3, 143.34),
        ("genus 6 for Neptune", "genus6.ply", 300, 3, (-0.1, 1.0), 2e-4, 162.42),
    )
    lines: list[list[Cell]] = []
    meshes, labels = [], []
    for title, file, wide, deep, (first, last), speed, published in cases:
        sized = min(wide, run.setting.width)
        each = replace(run, setting=replace(run.setting, width=sized, depth=deep))
        shape = run.mesh(file)
        started = time.perf_counter()
        field = each.solve(MeanCurvature(speed), {0.0: shape}, (first, last), start=each.fit(shape))
        seconds = time.perf_counter() - started
        given = field.provenance["accuracy"]["0"]
        lines.append([
            title, f"{deep} of {sized}", f"({first:g}, {last:g})", f"{speed:g}", f"{seconds:.0f}", published,
            given["mean"] / field.box.frame.scale if given else "no surface",
        ])  # fmt: skip
        meshes += frames(field, (first, 0.0, last), resolution=64)
        labels += [f"{title.split(' for ')[0]}, t = {t:g}" for t in (first, 0.0, last)]
    header = ["shape", "layers", "interval", "rate", "seconds", "published, 500 epochs", "mean distance at t = 0"]
    picture = contact_sheet(meshes, labels, columns=6, size=140)
    return Outcome(picture, lines, notes=["From lifted fits, whose time is in the seconds."], header=header)
