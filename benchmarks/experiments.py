"""The evolutions of the papers' experiments: what is solved, what is measured, and the picture of it.

Every function takes a `Run`, which knows the size of the network and the budget, and gives an `Outcome`. Shapes fill
[-0.8, 0.8] of the box [-1, 1]^3 as in the papers, so that lengths and times are theirs.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import constraints
import numpy as np
import torch
from jaxtyping import UInt8
from results import Cell
from torch import Tensor

from levelflow import (
    SIREN,
    Box,
    Budget,
    Camera,
    Field,
    Mesh,
    Placed,
    Sampling,
    Transported,
    contact_sheet,
    extract,
    fit,
    solve,
)
from levelflow.curvature import total_curvature
from levelflow.equations import Constant, Eikonal, Equation, MeanCurvature, Morph, Source, Stationary, Transport, Twist
from levelflow.extraction import EmptyLevelSet
from levelflow.measures import residual_table, surface_distance
from levelflow.shapes import Cuboid, Dumbbell, Solid, Sphere
from levelflow.shapes.implicit import Implicit, NoSurface
from levelflow.suite.suite import at_origin, change, radii

CUBE = Box((-1.0,) * 3, (1.0,) * 3)
"""The domain of the papers."""

AS_PUBLISHED = "rate 1, published"

CONTRADICTION = (
    "Two given shapes and motion by curvature contradict each other. With the published rate of 1 the first shape "
    "would have vanished long before the second is due, and our training leaves the surface of neither in between; "
    "the paper suggests a smaller rate, which is shown."
)

LIFTED = "It starts from a field fitted with twice the steps, lifted to space and time, as in Sec. 6.4."

POINTS = 1000
"""Points of each column of Tables 1 and 2, as in the paper."""


@dataclass(frozen=True)
class Setting:
    """How large a run is.

    Attributes:
        width: Neurons of a hidden layer.
        depth: Hidden layers: one more than the papers' count of maps from width to width.
        steps: Training steps of each field.
        omega: The frequency; None for our defaults, 10 in space-time and 15 in space.
        points: Samples of a step.
        shares: Of the samples: in space-time, on the surface, off it.
        fitted: The frequency of the static fields for the tables, if there is no other; 20 was tried on the armadillo.
        given: Points with their distances, from which the fields for the tables draw theirs.
        eikonal: The weight of |grad f| = 1 beside distances, in the fields for the tables.
        distance: The weight of the distance off the surface, in the fields with constraints for the tables.
        residual: The weight of the residual in them.
        knee: Where the square of the residual begins to count like its size.
        rate: The learning rate in them, at 128 neurons.
        wide: Neurons of a hidden layer of the fields for the tables, where they are more.
        longer: By how much more steps the fields with constraints for the tables have.
        few: Samples of a step of theirs, if not `points`.
    """

    width: int = 128
    depth: int = 3
    steps: int = 600
    omega: float | None = None
    points: int = 4096
    shares: tuple[float, float, float] = (0.5, 0.25, 0.25)
    fitted: float = 20.0
    given: int = 200_000
    eikonal: float = 1e-3
    distance: float = 1.0
    residual: float = 3.0
    knee: float = 0.01
    rate: float = constraints.RATE
    wide: int = 0
    longer: int = 2
    few: int = 0

    def __str__(self) -> str:
        frequency = "" if self.omega is None else f" of frequency {self.omega:g}"
        return (
            f"{self.depth} hidden layers of {self.width}{frequency}, {self.points:,} samples a step, "
            f"{self.steps:,} steps"
        )


@dataclass(frozen=True)
class Run:
    """A setting at work: meshes, networks and fields."""

    setting: Setting
    seed: int = 0

    def mesh(self, name: str) -> Mesh:
        """A mesh of the folder, the longest side of its box [-0.8, 0.8]."""
        folder = os.environ.get("LEVELFLOW_MESHES", Path(__file__).parents[2] / "shared" / "meshes")
        mesh = Mesh.read(Path(folder) / name).normalized(0.2)
        return Mesh(mesh.vertices, mesh.faces, name=name)

    def network(self, time: int = 1, *, space: int = 3) -> SIREN:
        return SIREN(space, time, width=self.setting.width, depth=self.setting.depth, omega=self.setting.omega)

    @property
    def budget(self) -> Budget:
        return Budget(self.setting.steps)

    @property
    def sampling(self) -> Sampling:
        space_time, surface, volume = self.setting.shares
        return Sampling(self.setting.points, space_time, surface, volume)

    def solve(self, equation: Equation, at: Mapping[float, Solid], until: object = None, **more: object) -> Placed:
        return solve(
            equation,
            self.network(),
            at=at,
            until=until,  # type: ignore[arg-type]
            budget=self.budget,
            sampling=self.sampling,
            seed=self.seed,
            **more,  # type: ignore[arg-type]
        )

    def fit(self, shape: Solid) -> Placed:
        return fit(self.network(0), shape, budget=self.budget, sampling=self.sampling, seed=self.seed)

    def steps_at_rest(self, shape: Solid) -> int:
        """Those of a static field: more than an evolution's, each of which costs several times as much."""
        return (8 if isinstance(shape, Mesh) else 4) * self.setting.steps

    def distance(self, shape: Solid) -> Placed:
        """A static field with the distance in the whole of the papers' domain."""
        omega = self.setting.omega or self.setting.fitted
        width = max(self.setting.width, self.setting.wide)
        network = SIREN(width=width, depth=self.setting.depth, omega=omega)
        sampling = replace(self.sampling, given=self.setting.given)
        budget = Budget(self.steps_at_rest(shape))
        eikonal = self.setting.eikonal
        return constraints.fit(network, shape, CUBE, budget=budget, sampling=sampling, seed=self.seed, eikonal=eikonal)

    def constrained(self, equation: Equation, start: Placed, shape: Solid, interval: tuple[float, float]) -> Placed:
        """A field of space and time by the papers' constraints, from a field of `distance`: see `in_words`."""
        return constraints.solve(
            equation,
            start,
            shape,
            interval=interval,
            budget=Budget(self.setting.longer * self.setting.steps),
            sampling=replace(self.sampling, given=self.setting.given, n=self.setting.few or self.setting.points),
            seed=self.seed,
            eikonal=self.setting.eikonal,
            distance=self.setting.distance,
            residual=self.setting.residual,
            knee=self.setting.knee,
            rate=self.setting.rate,
        )


def in_words(run: Run, shape: Solid) -> str:
    """The steps of the fields for the tables."""
    setting = run.setting
    few = f" of {setting.few:,} samples" if setting.few else ""
    wide = f", both with layers of {setting.wide}" if setting.wide > setting.width else ""
    return (
        f"For the table, the static field has {run.steps_at_rest(shape):,} steps for the distance in the whole box, at "
        f"{setting.given:,} points, and the one with constraints {setting.longer * setting.steps:,} more{few}, for "
        f"distance and residual there{wide}."
    )


@dataclass
class Outcome:
    """What an experiment found: see `results.Record`."""

    picture: UInt8[np.ndarray, "h w 3"]
    lines: list[list[Cell]]
    columns: dict[str, list[float]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    header: list[str] | None = None


def frames(f: Field, times: Sequence[float], *, resolution: int = 72) -> list[Mesh | None]:
    """Meshes of a field at some times; None where the surface has vanished."""
    found: list[Mesh | None] = []
    for t in times:
        try:
            found.append(extract(f.at(t), resolution=resolution))
        except EmptyLevelSet:
            found.append(None)
    return found


def sheet(
    rows: Mapping[str, Field], times: Sequence[float], *, size: int = 180, azimuth: float = 30.0
) -> UInt8[np.ndarray, "h w 3"]:
    """Pictures at some times under one camera, a row for each field, with its name under the first."""
    rows_of = {name: frames(f, times) for name, f in rows.items()}
    meshes = [mesh for row in rows_of.values() for mesh in row]
    labels = [
        f"{name}, t = {t:.3g}" if not i and len(rows_of) > 1 else f"t = {t:.3g}"
        for name in rows_of
        for i, t in enumerate(times)
    ]
    seen = [mesh.vertices for mesh in meshes if mesh is not None]
    camera = Camera.around(np.concatenate(seen), azimuth) if seen else None
    return contact_sheet(meshes, labels, columns=len(times), size=size, camera=camera)


def columns(
    f: Field, equation: Equation, shape: Solid, *, time: float = 0.0, generator: torch.Generator | None = None
) -> list[float]:
    """The six columns of Tables 1 and 2: `levelflow.measures.residual_table` on points that training has not seen."""
    generator = generator or torch.Generator().manual_seed(2023)
    table = residual_table(f, equation, shape, time=time, n=POINTS, generator=generator)
    assert table.distance is not None
    return [value for spread in (table.surface, table.distance, table.equation) for value in spread]


def usual_greatest(f: Field, equation: Equation, shape: Solid, *, samples: int = 100) -> list[float]:
    """The median of the second, fourth and sixth column over many samples like theirs: what chance makes of them."""
    generator = torch.Generator().manual_seed(0)
    found = torch.tensor([columns(f, equation, shape, generator=generator)[1::2] for _ in range(samples)])
    return found.median(0).values.tolist()


def distance_from_moved(f: Field, t: float, shape: Solid, motion: Equation, *, n: int = 3000) -> float:
    """The mean distance between the surface at a time and the shape moved along exact characteristics.

    Points of the surface are carried back to the shape, and points of the shape forward to the surface, there to first
    order; the greater mean counts.
    """

    def carried(x: Tensor, start: float, end: float) -> Tensor:
        y = motion.carry(x, x.new_full((len(x),), start), x.new_full((len(x),), end), steps=64)
        assert y is not None
        return y

    surface = Implicit(f.at(t))
    there = shape.distance(carried(surface.sample(n, generator=_seeded()).points, t, 0.0)).abs().mean()
    here = surface.gap(carried(shape.sample(n, generator=_seeded()).points, 0.0, t)).mean()
    return max(float(there), float(here))


def transported(run: Run, shape: Solid, times: Sequence[float]) -> Outcome:
    """A shape moved by b = (0, 1, 1): on characteristics, and by one network."""
    motion = Transport(Constant((0.0, 1.0, 1.0)))
    ways: dict[str, Field] = {
        "carried": Transported(motion, run.fit(shape), until=times[-1]),
        "one network": run.solve(motion, {0.0: shape}, times[-1]),
    }
    lines: list[list[Cell]] = []
    for way, f in ways.items():
        errors = [distance_from_moved(f, t, shape, motion) for t in times]
        last = frames(f, times[-1:])[0]
        lines.append([f"{way}: mean distance from the moved shape, at worst", max(errors), "no number"])
        lines.append([f"{way}: pieces of the last surface", "0" if last is None else str(last.components), None])
    return Outcome(sheet(ways, times), lines)


def moved(run: Run, shape: Solid, motion: Transport, *, times: Sequence[float], azimuth: float = 30.0) -> Outcome:
    """A row of Table 1, in four ways."""
    static, interval = run.distance(shape), (-1.0, 1.0)
    ways: dict[str, Field] = {
        "carried, a fit": Transported(motion, static, box=CUBE.during(interval)),
        "carried, the mesh itself": Transported(motion, shape, box=CUBE.during(interval)),
        "one network, constraints": run.constrained(motion, static, shape, interval),
        "one network, default": run.solve(motion, {0.0: shape}, interval),
    }
    lines: list[list[Cell]] = []
    for way, f in ways.items():
        errors = [distance_from_moved(f, t, shape, motion) for t in times]
        lines.append([f"{way}: mean distance from the moved shape, at worst", max(errors), "no number"])
    shown = {way: ways[way] for way in ("carried, a fit", "one network, default")}
    found = {way: columns(f, motion, shape) for way, f in ways.items()}
    return Outcome(sheet(shown, times, azimuth=azimuth), lines, found, [in_words(run, shape)])


def twist(run: Run) -> Outcome:
    """The armadillo twisted about the y axis, its ground at rest."""
    shape = run.mesh("armadillo.obj")
    motion = Transport(Twist(-1.0, center=(0.0, shape.box.lower[1], 0.0)))
    return moved(run, shape, motion, times=(0.0, 0.25, 0.5))


def source_sink(run: Run) -> Outcome:
    """Spot with a source in the body and a sink in the head."""
    shape = run.mesh("spot.obj")
    body, head = (0.0, -0.1, 0.3), (0.0, 0.3, -0.5)
    motion = Transport(Source(body, 1.0) + Source(head, -1.0))
    return moved(run, shape, motion, times=(-1.0, 0.0, 1.0), azimuth=210.0)


def smoothed(
    run: Run,
    shape: Solid,
    rate: float,
    *,
    times: Sequence[float],
    interval: tuple[float, float],
    azimuth: float = 30.0,
) -> tuple[Placed, Placed, Outcome]:
    """A row of Table 2: the default of `solve` over the times of the figure, and the papers' constraints."""
    equation = MeanCurvature(rate)
    default = run.solve(equation, {times[0]: shape}, times[-1])
    constrained = run.constrained(equation, run.distance(shape), shape, interval)
    found = {
        "default": columns(default, equation, shape, time=times[0]),
        "constraints": columns(constrained, equation, shape),
    }
    usual = ", ".join(f"{value:.2g}" for value in usual_greatest(constrained, equation, shape))
    lines: list[list[Cell]] = [["constraints: its three maxima, medians of 100 samples like the table's", usual, None]]
    outcome = Outcome(sheet({"default": default}, times, azimuth=azimuth), lines, found, [in_words(run, shape)])
    first, last = interval
    outcome.notes.append(
        f"The times of `default` are those of the figure, from {times[0]:g} to {times[-1]:g}; those of `constraints` "
        f"from {first:g} to {last:g}."
    )
    return default, constrained, outcome


def cube(run: Run) -> Outcome:
    """A cube that becomes round."""
    f, other, outcome = smoothed(
        run, Cuboid((1.2, 1.2, 1.2)), 0.1, times=[i / 5 for i in range(6)], interval=(0.0, 1.0)
    )
    for t in (0.0, 0.4, 0.8):
        own, others = radii(f.at(t)), radii(other.at(t))
        ratio = float(own.max() / own.min())
        lines: list[list[Cell]] = [
            [f"default: greatest radius over the least, t = {t:g}", ratio, "towards 1" if t else "1.7 for a cube"],
            [f"constraints: the same, t = {t:g}", float(others.max() / others.min()), None],
        ]
        outcome.lines += lines
    return outcome


def dumbbell(run: Run) -> Outcome:
    """A dumbbell that pinches, and whose two parts vanish."""
    rate, pinch, vanished = 0.05, 0.0075904, 0.3**2 / 4
    f, other, outcome = smoothed(
        run, Dumbbell(0.3, 1.0, 0.12), rate,
        times=(0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4), interval=(0.0, 0.4), azimuth=75.0,
    )  # fmt: skip
    for way, g in (("default", f), ("constraints", other)):
        found = change(lambda t, g=g: at_origin(g, t) < 0, 0.0, 0.4)  # type: ignore[misc]
        outcome.lines.append([f"{way}: time of the pinch (exactly {pinch / rate:.3f})", f"{found:.3f}", "no number"])
    outcome.notes.append(
        f"Ours has balls of radius 0.3 and a neck of 0.12; the exact time of its pinch is that of `levelflow bench` "
        f"and its balls would vanish at about {vanished / rate:.2f} if they were alone."
    )
    return outcome


def armadillo(run: Run) -> Outcome:
    """The armadillo smoothed from t = -1 to 1, and the row of Table 2."""
    shape = run.mesh("armadillo.obj")
    f, _, outcome = smoothed(run, shape, 1e-3, times=(-1.0, -0.5, 0.0, 0.5, 1.0), interval=(-1.0, 1.0))
    outcome.lines += _areas(f, (-1.0, 0.0, 1.0), "less")
    return outcome


def smoothing(run: Run) -> Outcome:
    """The armadillo a little later, t = 0, 0.1, 0.2."""
    f = _from_a_fit(run, 0.2)
    outcome = Outcome(sheet({"": f}, (0.0, 0.1, 0.2)), _areas(f, (0.0, 0.1, 0.2), "less"), notes=[LIFTED])
    outcome.lines.append(["rate of the area at t = 0.1 over that of its curvature", area_rate(f, 0.1), "1 if exact"])
    return outcome


def sharpening(run: Run) -> Outcome:
    """The armadillo a little earlier, t = 0, -0.1, -0.2."""
    f = _from_a_fit(run, -0.2)
    outcome = Outcome(sheet({"": f}, (0.0, -0.1, -0.2)), _areas(f, (0.0, -0.1, -0.2), "more"), notes=[LIFTED])
    outcome.notes.append("Backwards the equation is ill-posed; `solve` warns of it.")
    return outcome


def _from_a_fit(run: Run, until: float) -> Placed:
    """The armadillo under curvature from a field fitted with twice the steps, whose details a short run keeps."""
    shape = run.mesh("armadillo.obj")
    doubled = replace(run, setting=replace(run.setting, steps=2 * run.setting.steps))
    return run.solve(MeanCurvature(1e-3), {0.0: shape}, until, start=doubled.fit(shape))


def area_rate(f: Placed, t: float, *, rate: float = 1e-3, dt: float = 0.02) -> float:
    r"""The change of the area in time over $-\alpha \int \kappa^2$: 1 under mean curvature, 0 if nothing moves."""
    before, now, after = (extract(f.at(t + s * dt), resolution=128, refine=3) for s in (-1, 0, 1))
    points = now.sample(20_000, generator=_seeded()).points
    with torch.no_grad():
        kappa = total_curvature(f.at(t).jet(points, order=2))
    return (after.area - before.area) / (2 * dt) / (-rate * now.area * float((kappa**2).mean()))


def _areas(f: Placed, times: Sequence[float], expected: str) -> list[list[Cell]]:
    """The accuracy at the first time, and the areas later, relative to the first."""
    given = f.provenance["accuracy"][f"{times[0]:.15g}"]
    meshes = frames(f, times, resolution=96)
    areas = [0.0 if mesh is None else mesh.area for mesh in meshes]
    lines: list[list[Cell]] = [["mean distance from the given surface", given["mean"] if given else "none", None]]
    for t, area in list(zip(times, areas, strict=True))[1:]:
        lines.append([f"area at t = {t:g} over that at {times[0]:g}", f"{area / areas[0]:.3f}", expected])
    return lines


def morphed(
    run: Run,
    shapes: tuple[Solid, Solid],
    ways: Mapping[str, Equation],
    times: Sequence[float],
    *,
    last: float = 0.5,
    same: bool = False,
    azimuth: float = 30.0,
) -> Outcome:
    """One shape at t = 0 into another at the last time, by several equations in between."""
    first, second = shapes
    fields = {way: run.solve(equation, {0.0: first, last: second}) for way, equation in ways.items()}
    lines: list[list[Cell]] = []
    for way, f in fields.items():
        ends = [accuracy["mean"] if accuracy else None for accuracy in f.provenance["accuracy"].values()]
        known = [f"{end / f.box.frame.scale:.2g}" if end is not None else "no surface" for end in ends]
        lines.append([f"{way}: mean distance from the given shapes, at both ends", ", ".join(known), "no number"])
        x, t = f.box.uniform(POINTS, generator=_seeded()), f.box.uniform_times(POINTS, generator=_seeded())
        residual = ways[way].residual(x, t, f.jet(x, t, order=ways[way].order)).detach().abs()
        lines.append([f"{way}: mean residual in the box", float(residual.mean()), None])
        if same:
            lines.append([f"{way}: mean distance from the shape half way", _half_way(f, first, last / 2), None])
    return Outcome(sheet(fields, times, azimuth=azimuth), lines)


def _half_way(f: Placed, shape: Solid, t: float) -> Cell:
    try:
        return surface_distance(Implicit(f.at(t)), shape, n=10_000, generator=_seeded()).chamfer
    except NoSurface:
        return "no surface"


def cube_sphere(run: Run) -> Outcome:
    """A rounded cube into a sphere: distances in between, or curvature."""
    shapes = Cuboid((1.0, 1.0, 1.0), radius=0.05), Sphere(0.5)
    ways = {"eikonal": Eikonal(), AS_PUBLISHED: MeanCurvature(1.0), "rate 0.1": MeanCurvature(0.1)}
    outcome = morphed(run, shapes, ways, [i / 14 for i in (0, 1, 3, 5, 7)])
    return replace(outcome, notes=[CONTRADICTION])


def armadillo_sphere(run: Run) -> Outcome:
    """The armadillo into a sphere under curvature."""
    shapes = run.mesh("armadillo.obj"), Sphere(0.5)
    ways = {AS_PUBLISHED: MeanCurvature(1.0), "rate 0.01": MeanCurvature(0.01)}
    outcome = morphed(run, shapes, ways, [i**3 / 686 for i in (0, 2, 4, 6, 7)])
    return replace(outcome, notes=[CONTRADICTION])


def woman_armadillo(run: Run) -> Outcome:
    """A woman into the armadillo through distances."""
    shapes = run.mesh("woman.obj"), run.mesh("armadillo.obj")
    return morphed(run, shapes, {"eikonal": Eikonal()}, [i / 18 for i in (0, 2, 4, 7, 9)])


def buddha_armadillo(run: Run) -> Outcome:
    """A shape of another topology into the armadillo."""
    shapes = run.mesh("bob.obj"), run.mesh("armadillo.obj")
    ways = {"eikonal": Eikonal(), "rate 0.01": MeanCurvature(0.01)}
    outcome = morphed(run, shapes, ways, [i / 18 for i in (0, 2, 4, 7, 9)])
    return replace(outcome, notes=[CONTRADICTION])


def armadillo_armadillo(run: Run) -> Outcome:
    """The armadillo into itself: distances in between, or f_t = 0."""
    shape = run.mesh("armadillo.obj")
    ways = {"eikonal": Eikonal(), "standing still": Stationary()}
    return morphed(run, (shape, copy.copy(shape)), ways, [i / 18 for i in (0, 2, 4, 7, 9)], same=True)


def spot_bob(run: Run) -> Outcome:
    """Bob into Spot by the motion towards a target."""
    return _interpolated(run, run.mesh("bob.obj"), run.mesh("spot.obj"), azimuth=150.0)


def falcon(run: Run) -> Outcome:
    """A bust into the falcon by the motion towards a target."""
    return _interpolated(run, run.mesh("max-planck.obj"), run.mesh("falcon.obj"))


def _interpolated(run: Run, first: Solid, second: Solid, *, azimuth: float = 30.0) -> Outcome:
    return morphed(
        run, (first, second), {"morph": Morph(second)}, (0.0, 0.25, 0.5, 0.75, 1.0), last=1.0, azimuth=azimuth
    )


def _seeded() -> torch.Generator:
    return torch.Generator().manual_seed(1)
