"""The papers' experiments: what was measured beside what was published, with a picture of each.

    python benchmarks/papers.py [NAME ...] [--published] [--steps N] [-o docs/results]
    python benchmarks/papers.py --list
    python benchmarks/papers.py --document

Each named experiment, all if none is, leaves NAME.json and NAME.png in the folder, and the document README.md is put
together anew from all records that lie there. `--published` takes the paper's network, frequency, samples and steps,
which is days on a laptop; without it each has a size that ends in minutes. The intervals, rates and shapes are the
paper's in both, as far as the meshes are at hand. The training is ours in both. Meshes are read from the folder
LEVELFLOW_MESHES, or from ../shared/meshes beside the repository. Threads are those of OMP_NUM_THREADS.

References:
    Novello et al., Neural homotopies (2022), Sec. 6 and appendix A;
    Novello et al., Neural Implicit Surface Evolution, ICCV 2023, Sec. 6 and supplement, Sec. 4.
"""

from __future__ import annotations

import argparse
import datetime
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import experiments
import studies
import torch
from experiments import Outcome, Run, Setting
from results import Record, document, keep

from levelflow.shapes import Sphere
from levelflow.shapes.writing import replace_file

CARRIED = """Carried along exact characteristics the mesh itself meets every column, on and off the surface trivially:
there is no network in it. A fit that is carried meets the equation columns to rounding, or to the accuracy of the
Runge-Kutta steps where the flow has no formula, and in the others has the errors of a fit at rest. Off the surface
the weight of |grad f| = 1 beside the distances decides: ten times as much took the greatest error of a fit of Spot
from 0.017 to 0.009 (1,000 steps, frequency 15, by hand), where more steps did nothing. On it width decides, with a rate
of learning that falls as the width grows (256 neurons at that of 128 came out five times worse) and a last fifth of
the steps at 2e-4: by hand the armadillo had 0.00052 and 0.0033 after 8,000 steps, 0.00049 and 0.0032 after 12,000, and
0.00042 and 0.0026 after 8,000 and 2,000 of that kind. One network of space and time does not come to the
equation columns: the shape goes a long way in the interval (under the twist the top turns by 1.6 radians each way),
its details with it, in far fewer steps than the published ones. A network that is wrong by 1e-3 over lengths of 0.1
is wrong by 1e-2 in its gradient, and so in F; how the published ones come to 1e-5 the paper does not say. The rows of
constraints are of a loss that grew like the logarithm of the residual beyond 0.03, the twist's at twice the rate of
learning that wide networks now have."""

SMOOTHED = """Means are met, but that of the armadillo's equation only to the digits that are published (0.0019001), and
the greatest values of the distance but for the dumbbell's off the surface; those of the equation are not. The published
networks have ten times as many samples in a step, and 2 to 35 times the steps. At our budget the columns are bought
from each other by the weights of their terms: with a third of the weight for the distance and half of that for the
residual, which counted like its size beyond 0.03 and not 0.01, and half of the samples early, the cube had 0.00019,
0.0052, 0.0016, 0.033, 0.001 and 0.018. Errors fall with the rate of learning, not with steps at the same rate: the
equation mean of the cube was 0.0037 after 11,000 of its 20,000 steps, and 0.0009 in the end.

What brought the means down was found in the plane, on a square under the same motion (128 neurons, 3,000 steps of 2,048
samples, by hand). Residuals that count like their size beyond 0.03, where the square counts up to 0.3 otherwise, took
the means from 0.00032, 0.0012 and 0.0015 to 0.00011, 0.00098 and 0.0011; 0.01 took more. 1,500 steps of 4,096 samples,
and 750 of 8,192, came to worse. Samples drawn where the residual is large, at once (with weights that make up for it,
or without) or in the second half, made everything worse: what is largest no network follows. Twice the rate of learning
left distances wrong by 0.1 for good. Slower moments of the optimiser (0.99, 0.999), bases turned every second step, a
fourth layer, samples on a lattice, and a knee of 0.004 changed nothing or made it worse.

Steps count more than width, for equal time (by hand): after 430 to 510 seconds the cube's three means were 0.00033,
0.0013 and 0.0014 with 96 neurons (17,000 steps), 0.00032, 0.0014 and 0.0016 with 128 (12,000), 0.00044, 0.0018 and
0.0021 with 256 (4,000; the rates of learning as 1 / width, from 0.0007 at 128). That does not last: 60,000 steps with
128 (40 minutes of a processor, as for 20,000 with 256), at that rate and a weight of 3 for the distance, gave the cube
0.00025, 0.0076, 0.00099, 0.024, 0.001 and 0.028, and the dumbbell 0.00007, 0.00205, 0.00039, 0.009, 0.00048 and 0.15.
So the dumbbell's distance off the surface can be met, then at the cost of 2 per cent too much on it; the table keeps
256. The armadillo's greatest distance was brought below the published by a third more steps (15,000 before) at 0.7 of
the rate.

The greatest values of the equation have three causes. At the kinks of the distance, the edges of the cube and the
medial axes, curvature has no bound at the given time. A kink moves by the root of the time; where the shape is given at
the beginning, the network is given that root for its time, and most samples are uniform by it. In the cube's column
four points are above 0.009, and all four in the first eightieth of the interval. On the axis of the dumbbell, where the
neck was, level sets end in tips of a radius of 0.03; the point that decides its column lies 0.004 from the axis, and
the next has 0.019. The armadillo is given half way: before that the equation asks for details that grow, which the
given distance does not have, and most of the greatest errors are there, at claws and ears. How much is chance stands
with the experiments: medians over a hundred samples like the table's. By them the dumbbell meets its last column, and
the armadillo its greatest distances; but the cube's residual is 0.025. The default of `solve` does not compete: it asks
for nothing of the distance beyond a band."""

TABLES: Mapping[int, tuple[str, str]] = {
    1: ("motion by velocity fields", CARRIED),
    2: ("motion by mean curvature", SMOOTHED),
}

PUBLISHED_COLUMNS: Mapping[str, tuple[int, list[float]]] = {
    "twist": (1, [8e-4, 3e-3, 2e-3, 2.8e-2, 1e-5, 4e-4]),
    "source-sink": (1, [9e-4, 5e-3, 1e-3, 1.5e-2, 2.7e-6, 5e-4]),
    "cube": (2, [6e-4, 7e-3, 1.3e-3, 2.4e-2, 1.5e-3, 9e-3]),
    "dumbbell": (2, [3e-4, 2e-3, 1e-3, 1.3e-2, 9e-4, 1.7e-2]),
    "armadillo": (2, [8e-4, 4e-3, 2.2e-3, 1.6e-2, 1.9e-3, 1.3e-2]),
}


@dataclass(frozen=True)
class Experiment:
    """One experiment of a paper.

    Attributes:
        title: What it shows, with the shape that stands in where the paper's is not at hand.
        source: Where in the papers it is.
        run: What solves, measures and draws it.
        published: The paper's setting.
        claim: What the paper says or shows.
        laptop: The setting that ends in minutes.
    """

    title: str
    source: str
    run: Callable[[Run], Outcome]
    published: Setting
    claim: str
    laptop: Setting = Setting(steps=300)  # noqa: RUF009


def _epochs(number: int, cloud: int, on_surface: int) -> int:
    """Steps of so many passes over a cloud in batches."""
    return round(number * max(1.0, cloud / on_surface))


HOMOTOPIES, NISE, MORE = "neural-homotopies", "nise-2023", "nise-2023, supplement"
PLANE = Setting(width=64, points=2048, steps=150)
TABLE = Setting(steps=1000, given=1_000_000, residual=2.0, wide=256, longer=20, few=2048)

EXPERIMENTS: Mapping[str, Experiment] = {
    "twist": Experiment(
        "The armadillo under the twist y (-z, 0, x)",
        f"{NISE}, Sec. 6.1, Fig. 1, Table 1",
        experiments.twist,
        Setting(256, 3, 48_000, 30.0, 58_000, (8, 25, 25)),
        "The surfaces at t = 0, 0.25, 0.5.",
        Setting(steps=1250, given=1_000_000, eikonal=4e-3, wide=256),
    ),
    "source-sink": Experiment(
        "Spot under a source in its body and a sink in its head",
        f"{NISE}, Sec. 6.1, Fig. 2, Table 1",
        experiments.source_sink,
        Setting(128, 2, 46_000, 30.0, 6_500),
        "The head shrinks while the body grows.",
        Setting(steps=500, fitted=12.0, given=1_000_000, eikonal=1e-2),
    ),
    "cube": Experiment(
        "A cube of side 1.2 under mean curvature of rate 0.1",
        f"{HOMOTOPIES}, A.2.1, Fig. 3; {NISE}, Sec. 6.2.1, Fig. 3, Table 2",
        experiments.cube,
        Setting(256, 4, _epochs(8000, 40_000, 5000), 16.0, 20_000),
        "It contracts at the corners first, and is very close to a sphere before it vanishes.",
        replace(TABLE, distance=3.0),
    ),
    "dumbbell": Experiment(
        "A dumbbell under mean curvature of rate 0.05",
        f"{HOMOTOPIES}, A.2.2, Fig. 4; {NISE}, Sec. 6.2.1, Fig. 4, Table 2",
        experiments.dumbbell,
        Setting(256, 4, _epochs(2800, 80_000, 5000), 16.0, 20_000),
        "The neck pinches first; each part becomes a small sphere and vanishes.",
        TABLE,
    ),
    "armadillo": Experiment(
        "The armadillo under mean curvature of rate 0.001, given at t = -1",
        f"{HOMOTOPIES}, A.2.3, Fig. 5; {NISE}, Sec. 6.2.2, Table 2",
        experiments.armadillo,
        Setting(360, 4, _epochs(33_000, 80_000, 5000), 30.0, 20_000),
        "It becomes smoother; what is convex, as the fingers, contracts.",
        replace(TABLE, steps=1250, eikonal=4e-3, distance=2.0, residual=3.0, knee=0.03, rate=7e-4, longer=16),
    ),
    "sphere-transport": Experiment(
        "A sphere of radius 1/2 moved along (0, 1, 1)",
        f"{HOMOTOPIES}, A.1.1, Fig. 1",
        lambda run: experiments.transported(run, Sphere(0.5), (0.0, 0.29, 0.57, 0.86)),
        Setting(128, 4, _epochs(990, 32_000, 4000), 10.0, 16_000),
        "Well approximated; cut off where it leaves the box. Ours takes a box that holds the motion.",
    ),
    "armadillo-transport": Experiment(
        "The armadillo moved along (0, 1, 1)",
        f"{HOMOTOPIES}, A.1.2, Fig. 2",
        lambda run: experiments.transported(run, run.mesh("armadillo.obj"), (0.0, 0.2, 0.4, 0.6)),
        Setting(256, 4, _epochs(1800, 40_000, 4000), 30.0, 16_000),
        "Well approximated, with a spurious piece below the last one.",
    ),
    "cube-sphere": Experiment(
        "A cube into a sphere by two constraints",
        f"{HOMOTOPIES}, A.3.1, Figs. 6 and 7",
        experiments.cube_sphere,
        Setting(128, 4, _epochs(6780, 40_000, 5000), 20.0, 15_000, (1, 1, 1)),
        "Both arrive; under curvature, of rate 1, it is round earlier.",
    ),
    "armadillo-sphere": Experiment(
        "The armadillo into a sphere under mean curvature",
        f"{HOMOTOPIES}, A.3.2, Fig. 8",
        experiments.armadillo_sphere,
        Setting(256, 4, _epochs(1800, 80_000, 5000), 30.0, 15_000, (1, 1, 1)),
        "Most of the change is near the armadillo.",
    ),
    "woman-armadillo": Experiment(
        "A woman into the armadillo through distances",
        f"{HOMOTOPIES}, A.3.3, Fig. 9",
        experiments.woman_armadillo,
        Setting(256, 4, _epochs(9900, 80_000, 3750), 30.0, 15_000),
        "Both are represented, with a morph in between. The woman is another mesh than the paper's.",
    ),
    "buddha-armadillo": Experiment(
        "A shape of another topology into the armadillo: Bob, a ring, stands in for the Happy Buddha",
        f"{HOMOTOPIES}, A.3.4, Figs. 10 and 11",
        experiments.buddha_armadillo,
        Setting(256, 4, _epochs(4000, 120_000, 4500), 30.0, 18_000),
        "A coherent transition; more surface tension under curvature.",
    ),
    "armadillo-armadillo": Experiment(
        "The armadillo into itself by two constraints",
        f"{HOMOTOPIES}, A.3.5, Figs. 12 and 13",
        experiments.armadillo_armadillo,
        Setting(256, 4, _epochs(1400, 80_000, 3750), 30.0, 15_000),
        "With distances alone details are lost in between; with f_t = 0 all surfaces are the same.",
    ),
    "smoothing": Experiment(
        "The armadillo smoothed, rate 0.001",
        f"{NISE}, Sec. 6.2.2, Fig. 5",
        experiments.smoothing,
        Setting(256, 3, _epochs(33_000, 80_000, 5000), 30.0, 20_000),
        "Smoother as time goes on.",
    ),
    "sharpening": Experiment(
        "The armadillo sharpened, rate 0.001",
        f"{NISE}, Sec. 6.2.2, Fig. 6",
        experiments.sharpening,
        Setting(256, 3, _epochs(33_000, 80_000, 5000), 30.0, 20_000),
        "Convex regions expand, features are enhanced.",
    ),
    "spot-bob": Experiment(
        "Bob into Spot",
        f"{NISE}, Sec. 6.3, Fig. 9",
        experiments.spot_bob,
        Setting(128, 2, 20_000, 30.0, 8_000),
        "Smooth transitions. The number of epochs is not given; that of Fig. 10 is taken.",
    ),
    "falcon": Experiment(
        "A bust of Max Planck, for the witch, into the falcon",
        f"{NISE}, Sec. 6.3, Fig. 10",
        experiments.falcon,
        Setting(128, 3, 20_000, 30.0, 8_000),
        "Both ends are well approximated, beak and talons included.",
    ),
    "initialisation": Experiment(
        "The bunny under mean curvature from a lifted field and from random weights",
        f"{NISE}, Sec. 6.4, Figs. 11 and 12",
        studies.initialisation,
        Setting(256, 3, 1500, 30.0, 10_000),
        "The lifted start is nearer to a minimum from the beginning and keeps more detail.",
    ),
    "interval": Experiment(
        "The interval of time",
        f"{MORE}, Sec. 4.1, Figs. 1 and 2",
        studies.interval,
        Setting(256, 3, 1500, 30.0, 10_000),
        "Short intervals converge faster, those with a negative part slower; the lifted start is better.",
        PLANE,
    ),
    "rate": Experiment(
        "The rate of mean curvature",
        f"{MORE}, Sec. 4.2, Figs. 3 and 4",
        studies.rate,
        Setting(256, 3, 1500, 30.0, 10_000),
        "Convergence is in the order of the rates; at 0.1 the equation dominates and the data get worse at first.",
        PLANE,
    ),
    "proportions": Experiment(
        "The shares of the samples",
        f"{MORE}, Sec. 4.3, Figs. 5 to 7",
        studies.proportions,
        Setting(256, 3, 1500, 30.0, 10_000),
        "Fewer samples at t = 0 make the equation converge faster and the shape slower. The shares are read as on the "
        "surface, off it, in space-time; the supplement's text names them in another order than its numbers.",
        PLANE,
    ),
    "width": Experiment(
        "The width of the network",
        f"{MORE}, Sec. 4.4, Figs. 8 and 9",
        studies.width,
        Setting(256, 3, 1500, 30.0, 10_000),
        "Wider is better.",
        PLANE,
    ),
    "shapes": Experiment(
        "Five shapes with networks, intervals and rates of their own",
        f"{MORE}, Sec. 4.5, Table 1, Fig. 10",
        studies.shapes,
        Setting(300, 3, 2500, 30.0, 10_000),
        "Features are enhanced backwards in time, and smoothed forwards.",
        Setting(width=128, points=2048, steps=150),
    ),
}


def run(name: str, folder: Path, *, published: bool = False, steps: int | None = None) -> Record:
    """Runs one experiment and leaves its record and picture in a folder."""
    experiment = EXPERIMENTS[name]
    setting = experiment.published if published else experiment.laptop
    if steps is not None:
        setting = replace(setting, steps=steps)
    started, used = time.perf_counter(), time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # sharpening, open sides and vanished surfaces are in the records
        outcome = experiment.run(Run(setting))
    table, columns = PUBLISHED_COLUMNS.get(name, (None, []))
    record = Record(
        name=name,
        title=experiment.title,
        source=experiment.source,
        setting=str(setting),
        published=str(experiment.published),
        claim=experiment.claim,
        seconds=time.perf_counter() - started,
        processor=time.process_time() - used,
        threads=torch.get_num_threads(),
        date=datetime.date.today().isoformat(),
        version=torch.__version__,
        lines=outcome.lines,
        columns=outcome.columns,
        table=table,
        published_columns=columns,
        notes=outcome.notes,
    )
    if outcome.header is not None:
        record.header = outcome.header
    keep(outcome.picture, folder / f"{name}.png")
    record.write(folder)
    return record


def assemble(folder: Path) -> None:
    """Writes README.md from the records of a folder."""
    replace_file(folder / "README.md", document(folder, list(EXPERIMENTS), TABLES).encode())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=[], metavar="NAME", help="all by default; see --list")
    parser.add_argument("--published", action="store_true", help="the paper's network, frequency, samples and steps")
    parser.add_argument("--steps", type=int, help="of each field, instead of those of the setting")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/results"), help="where records are kept")
    parser.add_argument("--list", action="store_true", help="only list the experiments")
    parser.add_argument("--document", action="store_true", help="only put the document together")
    options = parser.parse_args()
    if unknown := set(options.names) - set(EXPERIMENTS):
        parser.error(f"there is no experiment {', '.join(sorted(unknown))}; known are {', '.join(EXPERIMENTS)}")
    if options.list:
        for name, experiment in EXPERIMENTS.items():
            print(f"{name:<22}{experiment.title} ({experiment.source})")
        return
    for name in () if options.document else options.names or EXPERIMENTS:
        record = run(name, options.output, published=options.published, steps=options.steps)
        print(f"{name:<22}{record.seconds:>7.0f} s, {record.setting}", flush=True)
        assemble(options.output)
    assemble(options.output)
    print(options.output / "README.md")


if __name__ == "__main__":
    main()
