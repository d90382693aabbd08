"""Are points of a zero set uniform by area?

    python benchmarks/sampling.py [MESH ...] [--steps 400] [-n 2048] [--repeats 4]

A field is fitted to each mesh, and its zero set is extracted finely. Points that a sampler draws from the field are
compared with points drawn uniformly by area from the extracted mesh, and both distances divided by those between two
sets of the latter: 1 is what perfect samples have. How well the field fits the mesh makes no difference.

Samplers:
    langevin   from the whole box, five times noise of 0.01 and a Newton step, then Newton steps: "LD" of the paper
    rejection  the same, starting where |f| < 0.1: the paper's
    newton     the same start without noise, Newton steps only
    rays       all crossings of random lines with the surface; uniform but for what lies between two of 192 points
    ours       `sample_surface`

Columns:
    CDr        ratio of the chamfer distance: half the sum of the mean distances to the nearest point of the other set
    EMDr       ratio of the earth mover's distance: the mean distance of the best matching of the points
    s          processor seconds for n points
    10k s      the same for 10,000 points, seen once

Each ratio is that of means over repeats; behind EMDr stands its standard error. Lengths are normalised: the
box of the field is [-1, 1]^3.

Reference:
    Yang et al., Geometry Processing with Neural Fields, NeurIPS 2021, Sec. 5.1 and Table 1.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist
from torch import Tensor

from levelflow import SIREN, Budget, Field, Mesh, Placed, extract, fit, load, sample_surface, save
from levelflow.curvature import gradient_norm
from levelflow.shapes.sampling import project

MESHES = Path(
    os.environ.get("LEVELFLOW_MESHES", Path(__file__).resolve().parents[1].parent / "shared" / "meshes")
).expanduser()
NAMES = ("dino.off", "armadillo.obj", "bob.obj", "max-planck.obj")
NOISE, STEPS, SHELL = 0.01, 5, 0.1
PUBLISHED = (
    "published: dino langevin 1.54 and 3.38, theirs 1.04 and 1.15; armadillo langevin 1.36 and 3.30, 1.02 and 1.08"
)


def newton(field: Field, n: int, generator: torch.Generator) -> Tensor:
    """Points within the shell of the paper, projected."""
    return _collected(lambda: project(field, _shell(field, 2 * n, generator), field.box), n)


def langevin(field: Field, n: int, generator: torch.Generator) -> Tensor:
    """Langevin steps from points of the whole box."""
    return _collected(lambda: _walked(field, field.box.uniform(n, generator=generator), generator), n)


def rejection(field: Field, n: int, generator: torch.Generator) -> Tensor:
    """Langevin steps from points within the shell of the paper."""
    return _collected(lambda: _walked(field, _shell(field, 2 * n, generator), generator), n)


def ours(field: Field, n: int, generator: torch.Generator) -> Tensor:
    return sample_surface(field, n, generator=generator).points


@torch.no_grad()
def rays(field: Field, n: int, generator: torch.Generator, *, points: int = 192) -> Tensor:
    """Crossings of lines that are uniform among all that meet the ball around the box (Cauchy and Crofton)."""
    box, found, count = field.box, [], 0
    radius = math.dist(box.lower, box.upper) / 2
    along = torch.linspace(-radius, radius, points, dtype=torch.float64)
    while count < n:
        lines = max(256, n // 2)
        way = torch.nn.functional.normalize(torch.randn(lines, 3, generator=generator, dtype=torch.float64), dim=1)
        across = torch.nn.functional.normalize(
            torch.linalg.cross(way, torch.randn(lines, 3, generator=generator, dtype=torch.float64)), dim=1
        )
        # The foot of a line is uniform in the disk across it.
        foot = torch.tensor(box.center) + radius * across * torch.rand(lines, 1, generator=generator).double().sqrt()
        x = foot[:, None] + along[:, None] * way[:, None]
        inside = box.contains(x.reshape(-1, 3))
        values = torch.full((lines * points,), math.nan, dtype=torch.float64)
        values[inside] = torch.cat([field(part) for part in x.reshape(-1, 3)[inside].split(1 << 14)]).double()
        values = values.reshape(lines, points)
        line, step = (values[:, :-1] * values[:, 1:] < 0).nonzero().T
        low, high = along[step], along[step + 1]
        for _ in range(16):
            middle = (low + high) / 2
            same = field(foot[line] + middle[:, None] * way[line]).sign() == values[line, step].sign()
            low, high = torch.where(same, middle, low), torch.where(same, high, middle)
        found.append(foot[line] + low[:, None] * way[line])
        count += len(line)
    points_found = torch.cat(found)
    return points_found[torch.randperm(len(points_found), generator=generator)[:n]]


SAMPLERS: dict[str, Callable[[Field, int, torch.Generator], Tensor]] = {
    "langevin": langevin,
    "rejection": rejection,
    "newton": newton,
    "rays": rays,
    "ours": ours,
}


def _collected(draw: Callable[[], tuple], n: int) -> Tensor:
    """Points that have arrived, of as many rounds as it takes."""
    found: list[Tensor] = []
    while sum(map(len, found)) < n:
        samples, arrived = draw()
        found.append(samples.points[arrived])
    return torch.cat(found)[:n]


@torch.no_grad()
def _shell(field: Field, n: int, generator: torch.Generator) -> Tensor:
    """Points of the box where |f| is small, of as many as give about n of them."""
    found, half = [], field.box.frame.scale
    while sum(map(len, found)) < n:
        x = field.box.uniform(2 * n, generator=generator)
        values = torch.cat([field(part) for part in x.split(1 << 14)])
        found.append(x[(values.abs() < SHELL * half).to(x.device)])
    return torch.cat(found)[:n]


@torch.no_grad()
def _walked(field: Field, x: Tensor, generator: torch.Generator) -> tuple:
    """Points after Langevin steps and projection."""
    for _ in range(STEPS):
        x = x + NOISE * field.box.frame.scale * torch.randn(x.shape, generator=generator, dtype=x.dtype)
        jet = field.jet(x, order=1)
        x = x - (jet.value / gradient_norm(jet) ** 2)[:, None].to(x) * jet.gradient.to(x)
    return project(field, x, field.box)


def distances(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """The chamfer and the earth mover's distance of two sets of as many points."""
    near = (cKDTree(b).query(a)[0].mean() + cKDTree(a).query(b)[0].mean()) / 2
    cost = cdist(a, b)
    return float(near), float(cost[linear_sum_assignment(cost)].mean())


def judged(field: Placed, mesh: Mesh, options: argparse.Namespace) -> None:
    """Prints the rows of a field."""
    generator = torch.Generator().manual_seed(options.seed)
    scale = field.box.frame.scale

    def uniform() -> np.ndarray:
        return mesh.sample(options.n, generator=generator).points.numpy() / scale

    truth = [uniform() for _ in range(options.repeats)]
    perfect = np.array([distances(points, uniform()) for points in truth for _ in range(2)])
    reference = perfect.mean(0)
    for name in options.samplers:
        rows, seconds = [], []
        for points in truth:
            started = time.process_time()
            drawn = SAMPLERS[name](field, options.n, generator)
            seconds.append(time.process_time() - started)
            rows.append(distances(points, drawn.numpy() / scale))
        started = time.process_time()
        SAMPLERS[name](field, 10_000, generator)
        many = time.process_time() - started
        near, moved = np.mean(rows, axis=0) / reference
        spread = np.var([row[1] for row in rows]) / len(rows) + np.var(perfect[:, 1]) / len(perfect)
        error = math.sqrt(spread) / reference[1]
        print(f"  {name:<12}{near:>7.3f}{moved:>8.3f} ± {error:.3f}{min(seconds):>8.2f}{many:>8.2f}", flush=True)


def fitted(path: Path, options: argparse.Namespace) -> Placed:
    """The field of a mesh, kept in a folder if there is one."""
    kept = options.fields and options.fields / f"{path.stem}.safetensors"
    if kept and kept.exists():
        field = load(kept)
        assert isinstance(field, Placed)
        return field
    network = SIREN(3, omega=15.0, generator=torch.Generator().manual_seed(options.seed))
    field = fit(network, Mesh.read(path), budget=Budget(options.steps), seed=options.seed)
    if kept:
        save(field, kept)
    return field


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", type=Path, nargs="*", metavar="MESH")
    parser.add_argument("--samplers", nargs="*", choices=SAMPLERS, default=list(SAMPLERS), metavar="NAME")
    parser.add_argument("-n", type=int, default=2048)
    parser.add_argument("--repeats", type=int, default=8)
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--resolution", type=int, default=192, help="of the mesh that is extracted")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--fields", type=Path, help="a folder where fitted fields are kept")
    options = parser.parse_args()
    print(
        f"{options.steps} steps, n = {options.n}, {options.repeats} repeats, {torch.get_num_threads()} threads, "
        f"PyTorch {torch.__version__}\n{PUBLISHED}"
    )
    for path in options.meshes or [MESHES / name for name in NAMES]:
        field = fitted(path, options)
        print(f"\n{path.stem:<14}{'CDr':>7}{'EMDr':>8}{'':>8}{'s':>8}{'10k s':>8}", flush=True)
        judged(field, extract(field, resolution=options.resolution, refine=2), options)


if __name__ == "__main__":
    main()
