"""What smoothing does to edges: curvature that spares sharp bends against plain mean curvature, at equal noise.

    python benchmarks/features.py [-o features.png] [--steps 1200] [--noise 0.012] [--threshold 12]

A machine part, a profile with corners and arcs extruded along z, is meshed with edges of 0.06 and its vertices are
moved at random. Two fields are solved from the noisy mesh. Each is judged at the start and when the noise is as small
as it becomes in both: the root mean square of the distance from the clean part, farther than 0.15 from its edges and
its arcs, which shrink; and the mean distances of the clean edges, and of the corners where three of them meet, from the
surface.
"""

from __future__ import annotations

import argparse
import math
import time

import numpy as np
import torch
from scipy.spatial import Delaunay, cKDTree
from torch import Tensor

from levelflow import SIREN, Budget, Camera, Mesh, Polygon, contact_sheet, equations, extract, solve

HEIGHT, SPACING, AWAY = 0.8, 0.06, 0.15
"""Of the part along z, of the vertices of its mesh, and how far flat parts are from what is not."""


def profile() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The outline, counter-clockwise and evenly spaced; which of its points are corners, and where it is bent."""
    low, high = np.pi - np.linspace(0, np.pi, 17), np.linspace(0, np.pi, 27)
    pieces = [
        np.array([[-0.9, -0.55], [-0.3, -0.55]]),
        np.array([0.0, -0.55]) + 0.3 * np.stack([np.cos(low), np.sin(low)], axis=1),
        np.array([[0.3, -0.55], [0.9, -0.55], [0.9, 0.05], [0.5, 0.05], [0.5, 0.35]]),
        np.array([0.0, 0.35]) + 0.5 * np.stack([np.cos(high), np.sin(high)], axis=1),
        np.array([[-0.5, 0.35], [-0.9, 0.35], [-0.9, -0.55]]),
    ]
    points: list[np.ndarray] = []
    for piece in pieces:
        for a, b in zip(piece, piece[1:], strict=False):
            n = max(1, round(float(np.linalg.norm(b - a)) / SPACING))
            points += [a + (b - a) * i / n for i in range(n)]
    outline = np.array(points)
    before, after = outline - np.roll(outline, 1, axis=0), np.roll(outline, -1, axis=0) - outline
    turn = (before * after).sum(1) / np.linalg.norm(before, axis=1) / np.linalg.norm(after, axis=1)
    return outline, turn < math.cos(0.6), turn < 1 - 1e-6


OUTLINE, CORNER, BENT = profile()
OUTLINE_POLYGON = Polygon(tuple(map(tuple, OUTLINE.tolist())))


def distance(x: Tensor) -> Tensor:
    """The signed distance from the clean part."""
    q = torch.stack([OUTLINE_POLYGON.distance(x[:, :2]), x[:, 2].abs() - HEIGHT / 2], dim=1)
    return torch.linalg.vector_norm(q.clamp_min(0), dim=1) + q.amax(1).clamp_max(0)


def upright(points: np.ndarray) -> np.ndarray:
    """The lines through points of the outline."""
    heights = np.linspace(-HEIGHT / 2, HEIGHT / 2, round(HEIGHT / SPACING) + 1)
    return np.column_stack([np.repeat(points, len(heights), axis=0), np.tile(heights, len(points))])


def edges() -> tuple[np.ndarray, np.ndarray]:
    """Points of the edges, and those of them where three meet."""
    ends = [np.column_stack([OUTLINE, np.full(len(OUTLINE), z)]) for z in (-HEIGHT / 2, HEIGHT / 2)]
    return np.concatenate([*ends, upright(OUTLINE[CORNER])]), np.concatenate([end[CORNER] for end in ends])


def part() -> Mesh:
    """The mesh of the part: the wall in triangles, and both ends triangulated with points of a grid inside."""
    n, levels = len(OUTLINE), round(HEIGHT / SPACING) + 1
    heights = np.linspace(-HEIGHT / 2, HEIGHT / 2, levels)
    wall = np.column_stack([np.tile(OUTLINE, (levels, 1)), np.repeat(heights, n)])
    i, j = np.meshgrid(np.arange(n), np.arange(levels - 1))
    here, there = (j * n + i).reshape(-1), (j * n + (i + 1) % n).reshape(-1)
    faces = [np.column_stack([here, there, there + n]), np.column_stack([here, there + n, here + n])]
    x, y = np.meshgrid(np.arange(-0.9, 0.9, SPACING), np.arange(-0.55, 0.9, 0.87 * SPACING))
    x[::2] += SPACING / 2
    inner = np.column_stack([x.reshape(-1), y.reshape(-1)])
    inner = inner[OUTLINE_POLYGON.distance(torch.from_numpy(inner)).numpy() < -0.6 * SPACING]
    flat = Delaunay(np.concatenate([OUTLINE, inner])).simplices
    corners = np.concatenate([OUTLINE, inner])[flat]
    flat = flat[OUTLINE_POLYGON.distance(torch.from_numpy(corners.mean(1))).numpy() < 0]
    corners = np.concatenate([OUTLINE, inner])[flat]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    flat = np.where((area > 0)[:, None], flat, flat[:, ::-1])
    vertices = [wall]
    for z, up in ((-HEIGHT / 2, False), (HEIGHT / 2, True)):
        rim = np.arange(n) + (n * (levels - 1) if up else 0)
        numbers = np.concatenate([rim, sum(map(len, vertices)) + np.arange(len(inner))])
        faces.append(numbers[flat if up else flat[:, ::-1]])
        vertices.append(np.column_stack([inner, np.full(len(inner), z)]))
    return Mesh(np.concatenate(vertices), np.concatenate(faces), name="part")


def noisy(clean: Mesh, noise: float, seed: int) -> Mesh:
    """The mesh with all of its vertices moved by normal random numbers of that size."""
    moved = clean.vertices + noise * np.random.default_rng(seed).normal(size=clean.vertices.shape)
    return Mesh(moved, clean.faces, name="noisy part")


def errors(mesh: Mesh) -> tuple[float, float, float]:
    """The noise on flat parts of a mesh, and the mean distances of the clean edges and corners from it."""
    edge, corner = edges()
    points = mesh.sample(20_000, generator=torch.Generator().manual_seed(1)).points
    bent = cKDTree(np.concatenate([edge, upright(OUTLINE[BENT])]))
    flat = points[torch.from_numpy(bent.query(points.numpy())[0]) > AWAY]
    noise = float(distance(flat).square().mean().sqrt())
    return noise, float(mesh.closest(edge).distance.mean()), float(mesh.closest(corner).distance.mean())


def when(times: list[float], noises: list[float], wanted: float) -> float:
    """The first time at which the noise is down to what is wanted, linear between those where it is known."""
    i = next(i for i, noise in enumerate(noises) if noise <= wanted)
    if i == 0:
        return times[0]
    return times[i - 1] + (times[i] - times[i - 1]) * (noises[i - 1] - wanted) / (noises[i - 1] - noises[i])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", default="features.png")
    parser.add_argument("--steps", type=int, default=1200)
    parser.add_argument("--noise", type=float, default=0.012)
    parser.add_argument("--threshold", type=float, default=12.0)
    parser.add_argument("--until", type=float, default=0.002)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    clean = part()
    start = noisy(clean, options.noise, options.seed)
    print(f"{options.steps} steps, {torch.get_num_threads()} threads, PyTorch {torch.__version__}, seed {options.seed}")
    print(f"{'':<24}{'time':>9}{'noise':>10}{'edges':>10}{'corners':>10}{'seconds':>9}")
    print(f"{'noisy mesh':<24}{'':>9}" + "".join(f"{error:>10.5f}" for error in errors(start)))
    motions = {
        "mean curvature": equations.MeanCurvature(1.0),
        "feature preserving": equations.FeaturePreserving(1.0, options.threshold),
    }
    times = [options.until * i / 8 for i in range(9)]
    fields, noises, seconds = {}, {}, {}
    for name, motion in motions.items():
        started = time.perf_counter()
        network = SIREN(time=1, omega=15.0)
        fields[name] = solve(
            motion, network, at={0.0: start}, until=options.until, budget=Budget(options.steps), seed=options.seed
        )
        seconds[name] = time.perf_counter() - started
        noises[name] = [errors(extract(fields[name].at(t), resolution=64))[0] for t in times]
        print(f"{name:<24}" + " ".join(f"{noise:.5f}" for noise in noises[name]) + " noise at eighths of the time")
    wanted = max(min(noise) for noise in noises.values())
    meshes, labels = [clean, start], ["clean", "noisy"]
    for name, field in fields.items():
        for t in (0.0, when(times, noises[name], wanted)):
            mesh = extract(field.at(t), resolution=128)
            print(
                f"{name:<24}{t:>9.5f}" + "".join(f"{error:>10.5f}" for error in errors(mesh)) + f"{seconds[name]:>9.0f}"
            )
        meshes.append(mesh)
        labels.append(name)
    camera = Camera.around(clean.vertices, azimuth=35, elevation=25, up=(0.0, 1.0, 0.0))
    contact_sheet(meshes, labels, options.output, camera=camera, title="edges at equal noise on flat parts")
    print(options.output)


if __name__ == "__main__":
    main()
