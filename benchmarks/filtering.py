"""What does scaling the curvature of a field do, beside what smooths meshes?

    python benchmarks/filtering.py [ripples] [sphere] [armadillo] [--fields FOLDER] [-o FOLDER]

`ripples`: circles with low ripples. The measured gain of `scale_curvature` beside that which its docstring states.

`sphere`: a sphere of radius 0.5, one half of which has normal noise of 0.01 on the vertices of an icosphere. Columns:
    noisy      root mean square of the distance from the sphere, on the noisy half
    clean      the same on the half that was clean
    volume     by that of the sphere
    s          processor seconds, without the fit and the extraction

`armadillo`: smoothed and sharpened. Columns:
    moved      mean distance of the surface from that of the given field, in thousandths of half its box
    most       the greatest
    area, volume, s

Rows beside ours:
    Taubin, extracted   ten steps of his filter (0.5, -0.53, equal weights) on the mesh extracted from the field
    Taubin, decimated   the same, on the extracted mesh brought down to 3000 faces first: figure 2 of the paper
    flows.Taubin        ours, which knows areas, on the extracted mesh, up to the same wavelength
    mean curvature      `solve` from the same field, for as long as halves ripples of the same wavelength on a plane

A mesh that is sharpened goes as far the other way as it would go in smoothing.

Reference:
    Yang et al., Geometry Processing with Neural Fields, NeurIPS 2021, Sec. 4 and figure 2; Taubin, A signal processing
    approach to fair surface design (1995).
"""

from __future__ import annotations

import argparse
import math
import os
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import igl
import numpy as np
import torch
import trimesh

from levelflow import (
    SIREN,
    Budget,
    Camera,
    Field,
    Implicit,
    Mesh,
    Placed,
    Polygon,
    contact_sheet,
    extract,
    fit,
    flows,
    load,
    save,
    scale_curvature,
    solve,
)
from levelflow.equations import MeanCurvature
from levelflow.filtering import FINE
from levelflow.rendering.images import stack

MESHES = Path(
    os.environ.get("LEVELFLOW_MESHES", Path(__file__).resolve().parents[1].parent / "shared" / "meshes")
).expanduser()
RADIUS, NOISE = 0.5, 0.01


def timed(made: Callable[[], Placed | Mesh]) -> tuple[Placed | Mesh, float]:
    started = time.process_time()
    return made(), time.process_time() - started


def fitted(name: str, given: Callable[[], Mesh | Polygon], network: SIREN, steps: int, folder: Path | None) -> Placed:
    """The field of a shape, kept in a folder if there is one."""
    kept = folder and folder / f"{name}.safetensors"
    if kept and kept.exists():
        field = load(kept)
        assert isinstance(field, Placed)
        return field
    field = fit(network, given(), budget=Budget(steps))
    if kept:
        kept.parent.mkdir(parents=True, exist_ok=True)
        save(field, kept)
    return field


def taubin(mesh: Mesh) -> Mesh:
    """Ten steps of the filter as he gave it, with equal weights."""
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    trimesh.smoothing.filter_taubin(body, lamb=0.5, nu=0.53, iterations=10)
    return Mesh(np.asarray(body.vertices), mesh.faces)


def decimated(mesh: Mesh, faces: int = 3000) -> Mesh:
    """A mesh with fewer faces, by the quadrics of Garland and Heckbert."""
    vertices, triangles, _, _ = igl.qslim(
        np.asfortranarray(mesh.vertices), np.asfortranarray(mesh.faces.astype(np.int32)), faces
    )
    return Mesh(vertices, triangles)


def even_taubin(mesh: Mesh, wavelength: float, *, steps: int = 10) -> Mesh:
    """Steps of `flows.Taubin` that keep what is longer than a wavelength, in units of time."""
    ratio = 1.05
    # k0 = 4 (ratio - 1) / (rate dt) is to be (2 pi / wavelength)^2.
    flow = flows.Taubin(rate := 4 * (ratio - 1) * (wavelength / (2 * math.pi)) ** 2, -ratio * rate)
    for _ in range(steps):
        mesh = Mesh(mesh.vertices + flow.displacement(mesh, 1.0, time=0.0), mesh.faces)
    return mesh


def flattened(given: Placed, shape: Mesh, wavelength: float, steps: int) -> Placed:
    """What mean curvature makes of a field in the time t in which exp(-(2 pi / wavelength)^2 t) falls to a half."""
    time = math.log(2) * (wavelength / (2 * math.pi)) ** 2
    network = SIREN(3, 1, width=given.field.width, omega=20.0)  # type: ignore[union-attr, arg-type]
    return solve(MeanCurvature(1.0), network, at={0.0: shape}, until=time, start=given, budget=Budget(steps)).at(time)


def sharpened(mesh: Mesh, smooth: Callable[[Mesh], Mesh]) -> Mesh:
    return Mesh(2 * mesh.vertices - smooth(mesh).vertices, mesh.faces)


def ripples(options: argparse.Namespace) -> None:
    """A table of gains."""
    print("\nripples        length  factor   stated   found")
    for count in (6, 12):
        angle = np.arange(1200) * math.pi / 600
        outline = (RADIUS + 0.01 * np.cos(count * angle))[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        network = SIREN(2, width=32, depth=2, omega=20.0, generator=torch.Generator().manual_seed(0))
        given = fitted(f"ripples{count}", lambda: Polygon(tuple(map(tuple, outline.tolist()))), network, 400,  # noqa: B023
                       options.fields)  # fmt: skip
        for ratio, factor in ((0.7, 0.0), (1.0, 0.0), (1.5, 0.0), (1.0, 0.5), (0.7, 2.0), (1.0, 2.0)):
            length = ratio * 2 * math.pi * RADIUS / count
            field = scale_curvature(given, factor, wavelength=length, threshold=1000.0, budget=Budget(200))
            stated = (1 + factor * ratio**4) / (1 + ratio**4)
            found = height(field, count) / height(given, count)
            print(f"{count:<15}{ratio:>6.1f}{factor:>8.1f}{stated:>9.3f}{found:>8.3f}", flush=True)


def height(field: Field, count: int) -> float:
    """That of ripples: the Fourier coefficient of the radius."""
    x = Implicit(field).sample(20_000, generator=torch.Generator().manual_seed(0)).points
    angle = torch.atan2(x[:, 1], x[:, 0])
    parts = torch.stack([torch.ones_like(angle), (count * angle).cos(), (count * angle).sin()], dim=1)
    return float(torch.linalg.lstsq(parts, x.norm(dim=1, keepdim=True)).solution[1])


def half_noisy() -> Mesh:
    body = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    vertices = np.array(body.vertices)
    moved = NOISE / RADIUS * np.random.default_rng(0).normal(size=len(vertices)) * (vertices[:, 2] > 0)
    return Mesh(vertices * (1 + moved)[:, None], body.faces)


def deviations(surface: Placed | Mesh) -> tuple[float, float, float]:
    """The distance from the sphere on both halves, away from where they meet, and the volume."""
    mesh = surface if isinstance(surface, Mesh) else extract(surface, resolution=96, refine=2)
    x = mesh.sample(40_000, generator=torch.Generator().manual_seed(0)).points.numpy()
    off = np.linalg.norm(x, axis=1) - RADIUS
    noisy, clean = (float(np.sqrt((off[side] ** 2).mean())) for side in (x[:, 2] > 0.1, x[:, 2] < -0.1))
    return noisy, clean, mesh.volume / (4 / 3 * math.pi * RADIUS**3)


def sphere(options: argparse.Namespace) -> np.ndarray:
    """A table and the row of pictures."""
    network = SIREN(3, omega=20.0, generator=torch.Generator().manual_seed(0))
    shape = half_noisy()
    given = fitted("half-noisy", lambda: shape, network, 900, options.fields)
    print(f"\n{'half-noisy sphere':<32}{'noisy':>9}{'clean':>9}{'volume':>9}{'s':>6}")
    shown: dict[str, Placed | Mesh] = {}

    def row(name: str, surface: Placed | Mesh, seconds: float | None = None) -> None:
        noisy, clean, volume = deviations(surface)
        shown[name] = surface
        text = "" if seconds is None else f"{seconds:.0f}"
        print(f"{name:<32}{noisy:>9.5f}{clean:>9.5f}{volume:>9.4f}{text:>6}", flush=True)

    row("given", given)
    for length in options.lengths:
        field, seconds = timed(
            lambda length=length: scale_curvature(given, 0.0, wavelength=length, budget=Budget(options.steps))  # type: ignore[misc]
        )
        row(f"ours, {length:g}", field, seconds)
    mesh = extract(given, resolution=96, refine=2)
    row("Taubin, extracted", *timed(lambda: taubin(mesh)))
    row("Taubin, decimated", *timed(lambda: taubin(decimated(mesh))))
    for length in options.lengths:
        row(f"flows.Taubin, {length:g}", *timed(lambda length=length: even_taubin(mesh, length)))  # type: ignore[misc]
    for length in options.lengths:
        row(
            f"mean curvature, {length:g}",
            *timed(lambda length=length: flattened(given, shape, length, options.steps)),  # type: ignore[misc]
        )
    return pictures(shown, "a sphere, noisy above", azimuth=30, elevation=35)


def armadillo(options: argparse.Namespace) -> list[np.ndarray]:
    """A table and two rows of pictures, whole and from near."""
    shape = Mesh.read(MESHES / "armadillo.obj")
    network = SIREN(3, width=160, omega=20.0, generator=torch.Generator().manual_seed(0))
    given = fitted("armadillo160", lambda: shape, network, 1200, options.fields)
    unit = given.box.frame.scale
    before = extract(given, resolution=192)
    few = decimated(before, 8000)
    print(f"\n{'armadillo':<32}{'moved':>8}{'most':>8}{'area':>9}{'volume':>9}{'s':>6}")

    def row(name: str, surface: Placed | Mesh, seconds: float) -> Mesh:
        mesh = surface if isinstance(surface, Mesh) else extract(surface, resolution=192)
        off = before.closest(mesh.sample(20_000, generator=torch.Generator().manual_seed(0)).points.numpy()).distance
        print(
            f"{name:<32}{1000 * off.mean() / unit:>8.2f}{1000 * off.max() / unit:>8.1f}"
            f"{mesh.area / before.area - 1:>+9.2%}{mesh.volume / before.volume - 1:>+9.2%}{seconds:>6.0f}", flush=True,
        )  # fmt: skip
        return mesh

    shown = {"given": before}
    for title, factors in (("smoothed", options.smooth), ("sharpened", [2.0])):
        for factor in factors:
            field, seconds = timed(
                lambda factor=factor: scale_curvature(given, factor, budget=Budget(options.steps))  # type: ignore[misc]
            )
            shown[f"ours, {factor:g}"] = row(f"ours, {factor:g}", field, seconds)
        if title == "smoothed":
            label = "mean curvature, smoothed"
            field, seconds = timed(lambda: flattened(given, shape, FINE * unit, options.steps))
            shown[label] = row(label, field, seconds)
        for name, mesh in (("extracted", before), ("decimated", few)):
            act = taubin if title == "smoothed" else lambda mesh: sharpened(mesh, taubin)
            label = f"Taubin, {name}, {title}"
            shown[label] = row(label, *timed(lambda mesh=mesh, act=act: act(mesh)))  # type: ignore[misc]
    low, high = np.array(before.box.lower), np.array(before.box.upper)
    head = low + np.array([0.25, 0.55, 0.0]) * (high - low), low + np.array([0.75, 1.0, 1.0]) * (high - low)
    near = before.vertices[((before.vertices > head[0]) & (before.vertices < head[1])).all(1)]
    return [
        pictures(shown, title, points=points, azimuth=options.azimuth, elevation=10)
        for points, title in ((before.vertices, "smoothed and sharpened"), (near, "from near"))
    ]


def pictures(
    shown: dict[str, Placed | Mesh] | dict[str, Mesh], title: str, *, points: np.ndarray | None = None, **where: float
) -> np.ndarray:
    meshes = [s if isinstance(s, Mesh) else extract(s, resolution=96) for s in shown.values()]
    camera = Camera.around(np.concatenate([m.vertices for m in meshes]) if points is None else points, **where)  # type: ignore[arg-type]
    return contact_sheet(meshes, list(shown), columns=len(shown), size=260, title=title, camera=camera)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help="ripples, sphere, armadillo; all by default")
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--lengths", type=float, nargs="+", default=[0.2, 0.4], help="wavelengths for the sphere")
    parser.add_argument("--smooth", type=float, nargs="+", default=[0.5, 0.0], help="factors for the armadillo")
    parser.add_argument("--azimuth", type=float, default=30.0)
    parser.add_argument("--fields", type=Path, help="a folder where fitted fields are kept")
    parser.add_argument("-o", "--output", type=Path, default=Path(), help="the folder for the pictures")
    options = parser.parse_args()
    known = {"ripples": ripples, "sphere": sphere, "armadillo": armadillo}
    if unknown := set(options.parts) - set(known):
        parser.error(f"there is no part {', '.join(sorted(unknown))}; known are {', '.join(known)}")
    print(f"{options.steps} steps, {torch.get_num_threads()} threads, PyTorch {torch.__version__}")
    warnings.simplefilter("ignore")
    for part in options.parts or known:
        made = known[part](options)
        if made is not None:
            stack(made if isinstance(made, list) else [made], options.output / f"filtering-{part}.png")


if __name__ == "__main__":
    main()
