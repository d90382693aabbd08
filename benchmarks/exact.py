"""Where surfaces are, compared with exact solutions: the correctness suite, on the bunny, beside two rivals.

    python benchmarks/exact.py [CASE ...] [--steps N] [--mesh FILE] [--against grid recipe] [--cells 64]

Without `--against` this is `levelflow bench` on the bunny. With it each case is solved once more by the level-set
method on a grid of `--cells` along the longest side (grid.py), and by the published recipe (recipe.py) with the same
network in the same number of seconds that ours took for the row: `inf` where a surface is missing altogether.

The mesh is `bunny.obj` of the folder LEVELFLOW_MESHES, or of ../shared/meshes beside the repository, unless another is
named. Exit code 1 if ours misses a limit.
"""

from __future__ import annotations

import argparse
import functools
import math
import os
import sys
import warnings
from pathlib import Path

import grid
import recipe
import torch

from levelflow import Budget, Mesh, Sampling
from levelflow.extraction import EmptyLevelSet
from levelflow.minimising import DEFAULT_BUDGET
from levelflow.shapes.implicit import NoSurface
from levelflow.suite import CASES, Row, Suite, rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", default=[], metavar="CASE", help=f"all by default: {', '.join(CASES)}")
    parser.add_argument("--steps", type=int, default=DEFAULT_BUDGET.steps)
    parser.add_argument("--mesh", type=Path, default=_folder() / "bunny.obj")
    parser.add_argument("--against", nargs="*", choices=("grid", "recipe"), default=[])
    parser.add_argument("--cells", type=int, default=64)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if unknown := set(options.cases) - set(CASES):
        parser.error(f"there is no case {', '.join(sorted(unknown))}; known are {', '.join(CASES)}")
    ours = Suite(Mesh.read(options.mesh), options.mesh.stem, Budget(options.steps), seed=options.seed)
    machine = f"{torch.get_num_threads()} threads, PyTorch {torch.__version__}"
    print(f"{machine}, {options.steps} steps each, seed {options.seed}")
    print(f"{'case':<48}{'limit':>7}{'ours':>10}{'s':>5}" + "".join(f"{name:>10}{'s':>5}" for name in options.against))
    missed = False
    for case in options.cases or CASES:
        mine = list(rows(ours, [case]))
        others = [_rows(name, ours, case, mine, options.cells) for name in options.against]
        for row in mine:
            missed |= not row.error <= row.limit
            cells = [row, *(other.get(row.title) for other in others)]
            text = "".join(f"{'':>15}" if c is None else f"{c.error:>10.5f}{c.seconds:>5.0f}" for c in cells)
            print(f"{row.title:<48}{row.limit:>7.4f}{text}{'' if row.error <= row.limit else '  missed'}", flush=True)
    sys.exit(missed)


def _rows(name: str, ours: Suite, case: str, mine: list[Row], cells: int) -> dict[str, Row]:
    """The rows of a rival, by their titles; those that it is not asked for are absent."""
    if name == "grid":
        suite = Suite(ours.shape, ours.name, solver=functools.partial(grid.solve, resolution=cells))
    else:
        budget = Budget(seconds=max(row.seconds for row in mine))
        suite = Suite(ours.shape, ours.name, budget, Sampling(n=10_000), solver=recipe.solve)
    if case == "fit":
        return {}
    found: dict[str, Row] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what a rival warns of is in its errors
        try:
            for row in rows(suite, [case]):
                found[row.title] = row
        except (NoSurface, EmptyLevelSet):
            lost = [row for row in mine if ", carried" not in row.title and row.title not in found]
            found |= {row.title: Row(row.title, math.inf, row.limit, row.seconds) for row in lost}
    return found


def _folder() -> Path:
    return Path(os.environ.get("LEVELFLOW_MESHES", Path(__file__).parents[2] / "shared" / "meshes"))


if __name__ == "__main__":
    main()
