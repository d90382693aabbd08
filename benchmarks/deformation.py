"""What becomes of a deformed surface: the field as an elastic shell, beside meshes that are as rigid as possible.

    python benchmarks/deformation.py [EDIT ...] [--fields FOLDER] [--steps 600] [--with-edit] [-o deformation.png]
    python benchmarks/deformation.py --plane [-o deformation-plane.png]

Fields are fitted to the meshes, or read from FOLDER if they are there; what is fitted is left in it. The first prints a
table of rows for each edit, and a picture with a row for each. The second has the ablations of nfgp-2021, figures 4 and
7, in the plane: a bar with its right end turned by 90 degrees, as curves.

Edits: of a `bar` and a `cylinder` (rotate, translate, twist by 90 and 180 degrees), and one each of the cactus, the
armadillo and the dinosaur.

Rows:
    field      `deform`
    cubes      as rigid as possible on the mesh of marching cubes
    decimated  the same on that mesh with a quarter of the faces
    original   the same on the mesh that was read, but for the bar and the cylinder, whose faces are large
    edit       what `levelflow edit` does: the field follows its mesh in 8 steps (with --with-edit)

Columns:
    handles  how far the surface is from where the handles want what they held of it, in half sides of the box: the
             mean, and the farthest. Vertices of meshes are put there.
    volume   gained
    stretch  the mean of |1 - J^T J|^2 in the tangent plane over the area at rest, of the faces of the same mesh, with
             what the field does to its vertices
    bend     the same of 3 (angle - angle at rest)^2 l^2 / A at the edges, l long and between faces of the area A, in
             half sides of the box; 3 / r^2 for a flat regular grid that is rolled up
    cuts     pairs of faces that pass through each other
    s        seconds of the processor

Reference:
    Yang et al., Geometry Processing with Neural Fields, NeurIPS 2021, Sec. 6 and figures 4 to 7.
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import igl
import numpy as np
import torch
from torch import nn

from levelflow import (
    SIREN,
    Box,
    Budget,
    Jet,
    Map,
    Mesh,
    Placed,
    Shell,
    contact_sheet,
    deform,
    evolve,
    extract,
    fit,
    load,
    save,
)
from levelflow.deformation import Guess, Held, Motion, after, invertible
from levelflow.flows import AsRigidAsPossible, BlendedMotions, Edit, handle_error, volume_change
from levelflow.handles import BoxRegion, Handle
from levelflow.minimising import Term, minimise
from levelflow.networks.invertible import InvertibleResNet
from levelflow.rendering.images import stack
from levelflow.shapes import Rectangle

MESHES = Path(os.environ.get("LEVELFLOW_MESHES", Path(__file__).resolve().parent.parent.parent / "shared" / "meshes"))


def between(lower: Sequence[float], upper: Sequence[float]) -> BoxRegion:
    """A region from one corner to the other."""
    return BoxRegion(Box(tuple(lower), tuple(upper)))


def rods(lower: np.ndarray, upper: np.ndarray, axis: int) -> dict[str, list[Handle]]:
    """Edits of a rod along an axis: a sixth of it is held at one end, and a sixth is moved at the other."""
    size, far = upper - lower, 10 * (upper - lower).max()
    low_end, high_end = upper + far, lower - far
    low_end[axis], high_end[axis] = lower[axis] + size[axis] / 6, upper[axis] - size[axis] / 6
    low, high = between(lower - far, low_end), between(high_end, upper + far)
    along, across = np.eye(3)[axis], np.eye(3)[(axis + 1) % 3]
    middle = (lower + upper) / 2
    held, tip = Handle.fix(low), middle + along * size[axis] * 5 / 12

    def turned(angle: float, about: np.ndarray, center: np.ndarray) -> list[Handle]:
        return [held, Handle.rotate(high, angle=angle, axis=tuple(about), center=tuple(center))]

    return {
        "rotate": turned(60, across, middle),
        "translate": [held, Handle.move(high, by=tuple(size[axis] / 4 * np.eye(3)[(axis + 2) % 3]))],
        "twist 90": turned(90, along, tip),
        "twist 180": turned(180, along, tip),
    }


def edits() -> dict[str, tuple[str, list[Handle]]]:
    """Each edit: the file of its mesh, and its handles."""
    bar, cylinder = (Mesh.read(MESHES / f"{name}.off") for name in ("bar1", "cylinder_small"))
    made = {}
    for name, file, mesh, axis in (("bar", "bar1.off", bar, 1), ("cylinder", "cylinder_small.off", cylinder, 2)):
        corners = (np.array(mesh.box.lower), np.array(mesh.box.upper))
        made |= {f"{name} {what}": (file, handles) for what, handles in rods(*corners, axis).items()}
    made["cactus"] = (
        "cactus_highres.off",
        [
            Handle.fix(between((0, 0, -1), (1, 1, 0.3))),
            Handle.rotate(between((0, 0, 0.75), (1, 1, 2)), angle=45, axis=(1, 0, 0), center=(0.5, 0.5, 0.5)),
        ],
    )
    made["armadillo"] = (
        "armadillo.obj",
        [
            Handle.fix(between((-1, -1, -1), (1, 0, 1))),
            Handle.rotate(between((-1, 0.2, -1), (-0.33, 1, 1)), angle=-60, axis=(0, 0, 1), center=(-0.15, 0.15, 0.1)),
        ],
    )
    made["dino"] = (
        "dino.off",
        [
            Handle.fix(between((-1, -1, -1), (0.1, 1, 1))),
            Handle.rotate(between((0.4, -1, -1), (1, 1, 1)), angle=40, axis=(0, 1, 0), center=(0.2, 0, -0.1)),
        ],
    )
    return made


def stretch(rest: Mesh, now: Mesh) -> float:
    """The energy of the faces of a mesh whose vertices have moved; see above."""
    before, after = (mesh.vertices[mesh.faces] for mesh in (rest, now))
    before, after = (corners[:, 1:] - corners[:, :1] for corners in (before, after))
    before, after = before @ before.swapaxes(1, 2), after @ after.swapaxes(1, 2)
    size = np.sqrt(np.maximum(np.linalg.det(before), 0)), np.sqrt(np.maximum(np.linalg.det(after), 0))
    known = (size[0] > 1e-3 * size[0].mean()) & (size[1] > 1e-3 * size[0].mean())
    change = np.eye(before.shape[1]) - np.linalg.solve(after[known], before[known])
    return float((np.einsum("nij,nji->n", change, change) * size[1][known]).sum() / size[0].sum())


def bend(rest: Mesh, now: Mesh, scale: float) -> float:
    """The energy of the edges of a mesh whose vertices have moved; see above."""
    edges, sides = np.unique(
        np.sort(rest.faces[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2)), axis=0, return_inverse=True
    )
    order = np.argsort(sides, kind="stable")
    pairs = order[np.flatnonzero(np.bincount(sides)[sides[order]] == 2)].reshape(-1, 2) // 3
    both = edges[np.bincount(sides) == 2]

    def angles(mesh: Mesh) -> np.ndarray:
        a, b = (mesh.face_normals[pairs[:, i]] for i in (0, 1))
        along = np.diff(mesh.vertices[both], axis=1)[:, 0]
        along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-30)
        return np.arctan2((np.cross(a, b) * along).sum(1), (a * b).sum(1))

    turned = (angles(now) - angles(rest) + np.pi) % (2 * np.pi) - np.pi
    areas = rest.face_areas[pairs].sum(1)
    length = np.linalg.norm(np.diff(rest.vertices[both], axis=1)[:, 0], axis=1)
    known = areas > 1e-2 * areas.mean()
    return float((3 * turned**2 * length**2 / np.maximum(areas, 1e-30))[known].sum() / rest.area * scale**2)


def cuts(mesh: Mesh) -> int:
    """How many pairs of faces pass through each other."""
    from igl.copyleft import cgal

    return len(cgal.remesh_self_intersections(mesh.vertices, mesh.faces, detect_only=True)[2])


class Free(Map):
    """The map x -> x + (g_1(x), ..., g_d(x)) with networks g that nothing bounds."""

    def __init__(self, space: int) -> None:
        super().__init__()
        self.space, self.times = space, 0
        self.networks = nn.ModuleList(
            SIREN(space, width=64, generator=torch.Generator().manual_seed(i)) for i in range(space)
        )

    def push(self, jet: Jet) -> Jet:
        parts = [network.push(jet.to(next(self.parameters()))) for network in self.networks]  # type: ignore[operator]

        def beside(*planes: torch.Tensor | None) -> torch.Tensor | None:
            known = [plane for plane in planes if plane is not None]
            return torch.stack(known, dim=-1) if known else None

        value = beside(*(part.value for part in parts))
        assert value is not None
        first, second = beside(*(part.first for part in parts)), beside(*(part.second for part in parts))
        return jet.to(value) + Jet(value, first, second, jet.space)


def carried(field: Placed, mesh: Mesh) -> Mesh:
    """The mesh with its vertices where the deformation takes them."""
    u = field.box.frame.to_unit(torch.tensor(mesh.vertices)).to(field.dtype)
    x = field.field.deformation.inverse(u, tolerance=1e-5)  # type: ignore[union-attr, operator]
    return Mesh(field.box.frame.from_unit(x.double()).cpu().numpy(), mesh.faces)


def row(name: str, gaps: np.ndarray, rest: Mesh, now: Mesh, scale: float, seconds: float) -> None:
    """Prints a row."""
    print(
        f"{name:<12}{gaps.mean() / scale:>10.1e}{gaps.max() / scale:>9.1e}{100 * volume_change(rest, now):>8.1f} %"
        f"{stretch(rest, now):>10.4f}{bend(rest, now, scale):>9.3f}{cuts(now):>6}{seconds:>7.0f}",
        flush=True,
    )


def timed(work: Callable[[], object]) -> tuple[object, float]:
    """What some work returns, and the seconds of the processor that it took."""
    started = time.process_time()
    return work(), time.process_time() - started


def table(name: str, file: str, handles: list[Handle], options: argparse.Namespace) -> np.ndarray:
    """Prints the rows of an edit, and returns their picture."""
    path, original = options.fields / f"{Path(file).stem}.safetensors", Mesh.read(MESHES / file)
    if not path.exists():
        options.fields.mkdir(parents=True, exist_ok=True)
        save(fit(SIREN(3, width=options.width), original, budget=Budget(options.fit_steps)), path)
    field = load(path)
    assert isinstance(field, Placed)
    scale = field.box.frame.scale
    cubes = extract(field, resolution=options.resolution, refine=2)
    coarse = igl.decimate(cubes.vertices, cubes.faces, len(cubes.faces) // 4)
    coarse = coarse[1:] if isinstance(coarse[0], bool) else coarse
    meshes = {"cubes": cubes, "decimated": Mesh(coarse[0], coarse[1])}
    if len(original.vertices) > 1500:
        meshes["original"] = original
    print(f"\n{name:<12}{'handles':>10}{'':>9}{'volume':>10}{'stretch':>10}{'bend':>9}{'cuts':>6}{'s':>7}", flush=True)
    deformed, seconds = timed(
        lambda: deform(
            field, handles, shell=Shell(options.stretch, options.bend, options.thicken), budget=Budget(options.steps),
            resolution=options.resolution, n=options.samples, network=None if options.blocks is None
            else invertible(3, blocks=options.blocks, frequencies=options.frequencies),
        )
    )  # fmt: skip
    assert isinstance(deformed, Placed)
    shown, labels = [cubes, carried(deformed, cubes)], [f"{name}: at rest", "field"]
    for kind, rest in meshes.items():
        edit = Edit(rest, handles, densify=AsRigidAsPossible(iterations=100))
        now = carried(deformed, rest)
        wanted = [h.target(rest.vertices[i], 1.0) for h, i in zip(handles, edit.vertices, strict=True)]
        gaps = np.linalg.norm(now.vertices[np.concatenate(edit.vertices)] - np.concatenate(wanted), axis=1)
        row("field", gaps, rest, now, scale, seconds)
        rigid, own = timed(lambda edit=edit: edit.deformed(steps=4))
        assert isinstance(rigid, Mesh)
        row(kind, np.zeros(1), rest, rigid, scale, own)
        shown.append(rigid)
        labels.append(kind)
    if options.with_edit:
        edit = Edit(cubes, handles, densify=BlendedMotions())
        box = field.box.union(deformed.box.during())
        followed, own = timed(lambda: evolve(field, edit, dt=1 / 8, steps=8, substeps=1, box=box))
        assert isinstance(followed, Placed)
        mesh = extract(followed.at(1.0), resolution=options.resolution, refine=2)
        gap, change = handle_error(edit, mesh), volume_change(cubes, mesh)
        print(
            f"{'edit':<12}{gap.mean / scale:>10.1e}{gap.max / scale:>9.1e}{100 * change:>8.1f} %{own:>32.0f}",
            flush=True,
        )
        shown.append(mesh)
        labels.append("edit")
    return contact_sheet(shown, labels, columns=len(shown), size=options.size)


def plane(options: argparse.Namespace) -> np.ndarray:
    """The ablations of figures 4 and 7 on a bar in the plane."""
    field = fit(SIREN(2, width=48), Rectangle((1.6, 0.4), radius=0.03), box=Box((-1, -1), (1, 1)), budget=Budget(400))
    handles = [Handle.fix(between((-1, -1), (-0.6, 1))), Handle(between((0.6, -1), (1, 1)), by=(-0.35, 0.6), angle=90)]
    shown, labels = [extract(field, resolution=160, refine=2)], ["at rest"]
    budget, plain = Budget(options.steps), InvertibleResNet(2, blocks=6, width=64, depth=1, frequencies=0)
    rows = {
        "stretch and bend": {},
        "stretch only": {"shell": Shell(0.1, 0.0)},
        "bend only": {"shell": Shell(0.0, 1e-3)},
        "no energy": {"shell": Shell(0.0, 0.0, 0.0)},
        "no encoding": {"network": plain},
    }
    print(f"\n{'in the plane':<18}{'handles':>10}{'':>9}{'stretching':>12}{'bending':>9}{'s':>7}", flush=True)
    for name, more in rows.items():
        made, seconds = timed(lambda more=more: deform(field, handles, budget=budget, n=512, **more))
        assert isinstance(made, Placed)
        missed, energy = made.provenance["handles"], made.provenance["energy"]
        print(
            f"{name:<18}{missed['mean']:>10.1e}{missed['max']:>9.1e}{energy['stretching']:>12.4f}"
            f"{energy['bending']:>9.3f}{seconds:>7.0f}",
            flush=True,
        )
        shown.append(extract(made, resolution=160, refine=2))
        labels.append(name)
    motion, free = Motion.of(field, handles, path=False, resolution=96), Free(2)
    held = Held(free, motion, n=256)
    terms: list[Term] = [Guess(free, motion, n=512), held]
    minimise(free.parameters(), terms, budget=budget, generator=torch.Generator().manual_seed(0))
    gaps = held.missed() * motion.box.frame.scale
    print(f"{'no inverse':<18}{float(gaps.mean()):>10.1e}{float(gaps.max()):>9.1e}")
    shown.append(extract(after(field, free, motion.box), resolution=160, refine=2))
    labels.append("no inverse")
    return contact_sheet(shown, labels, columns=4, size=options.size)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("edits", nargs="*", default=[], metavar="EDIT", help="all by default")
    parser.add_argument("--plane", action="store_true", help="the ablations in the plane instead")
    parser.add_argument("--fields", type=Path, default=Path("deformation-fields"), metavar="FOLDER")
    parser.add_argument("--fit-steps", type=int, default=1000)
    parser.add_argument("--steps", type=int, default=600, help="of a deformation")
    parser.add_argument("--samples", type=int, default=1024)
    parser.add_argument("--blocks", type=int, help="of its network")
    parser.add_argument("--frequencies", type=int, default=3, help="of its encoding, if --blocks is given")
    parser.add_argument("--stretch", type=float, default=0.1)
    parser.add_argument("--bend", type=float, default=1e-3)
    parser.add_argument("--thicken", type=float, default=0.1)
    parser.add_argument("--width", type=int, default=128, help="of fitted networks")
    parser.add_argument("--resolution", type=int, default=72)
    parser.add_argument("--with-edit", action="store_true")
    parser.add_argument("--size", type=int, default=220, help="pixels of a picture")
    parser.add_argument("-o", "--output", type=Path, default=Path("deformation.png"))
    options = parser.parse_args()
    print(f"{options.steps} steps, {torch.get_num_threads()} threads, PyTorch {torch.__version__}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what is missed is seen in the table
        if options.plane:
            sheets = [plane(options)]
        else:
            known = edits()
            if unknown := set(options.edits) - set(known):
                parser.error(f"there is no edit {', '.join(sorted(unknown))}; known are {', '.join(known)}")
            sheets = [table(name, *known[name], options) for name in options.edits or known]
    widest = max(sheet.shape[1] for sheet in sheets)
    stack([np.pad(s, ((0, 0), (0, widest - s.shape[1]), (0, 0)), mode="edge") for s in sheets], options.output)
    print(options.output)


if __name__ == "__main__":
    main()
