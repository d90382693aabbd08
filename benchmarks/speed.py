"""What a training step, a fit and a mesh cost, each beside what they are compared with in the same run.

    python benchmarks/speed.py [steps|fit|extract|show ...] [--width 256] [--points 8192] [--mesh FILE] [--device cpu]

`steps`: a training step of each equation (residual at space-time points, squared, back to the weights) against nested
automatic differentiation, which is what the papers' codes do, and against the floor: the bare matrix products of the
step, in the same chunks, at the rate of this machine. Memory is the peak of one step beyond what was there before it;
`gradient` is how far the gradient of the weights is from that of nested differentiation.

`fit`: a fit with the default steps, and one with 50 seconds of training: all seconds, preparation included, and the
mean distance from the mesh in normalised units, for a mesh of one's own or the armadillo.

`extract`: seconds of a mesh at 128, 256 and 512 cells against the evaluation of the full grid (its time is that of 2^21
of its points, scaled), and what a frame costs beyond the evaluation of the field: finding cells, triangles and a
binary PLY file.

`show`: seconds of a picture of 512 x 512 pixels, traced and of a mesh, and of a new time in the viewer at its preview
resolution, colours included; the best of three.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from levelflow import SIREN, Budget, Mesh, Placed, Sphere, extract, fit, image, lift
from levelflow.equations import Constant, Eikonal, Equation, MeanCurvature, Morph, Rotation, Stationary, Transport
from levelflow.jets import Jet, identity
from levelflow.minimising import DEFAULT_BUDGET
from levelflow.viewer.viewed import ViewedField

EQUATIONS: dict[str, Equation] = {
    "MeanCurvature": MeanCurvature(0.1),
    "Transport": Transport(Rotation(1.0)),
    "Transport, constant": Transport(Constant((1.0, 0.0, 0.0))),
    "Morph": Morph(Sphere(0.5), since=-1.5, until=1.5),
    "Eikonal": Eikonal(),
    "Stationary": Stationary(),
}
MESHES = Path(os.environ.get("LEVELFLOW_MESHES", Path(__file__).parents[2] / "shared" / "meshes"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", default=[], metavar="steps|fit|extract|show", help="all by default")
    parser.add_argument("--width", type=int, default=256)
    parser.add_argument("--points", type=int, default=8192)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--chunk", type=int, default=1024)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--compiled", action="store_true", help="ours by torch.compile as well, which takes a minute")
    parser.add_argument("--mesh", type=Path, default=MESHES / "armadillo.obj")
    parser.add_argument("--way", choices=WAYS, help=argparse.SUPPRESS)
    parser.add_argument("--equation", choices=EQUATIONS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.way:
        print(_memory(options))
        return
    if unknown := set(options.parts) - set(PARTS):
        parser.error(f"there is no part {', '.join(sorted(unknown))}; known are {', '.join(PARTS)}")
    print(f"{options.device}, {torch.get_num_threads()} threads, PyTorch {torch.__version__}")
    for part in options.parts or PARTS:
        print()
        PARTS[part](options)


def steps(options: argparse.Namespace) -> None:
    """A table with a line for each equation and way."""
    network, x, t = _problem(options)
    print(f"a step: three hidden layers of {options.width}, {options.points} space-time points, float32")
    print(f"{'equation':<21}{'way':<18}{'seconds':>8}{'to nested':>11}{'to floor':>10}{'memory':>11}{'gradient':>10}")
    for name, equation in EQUATIONS.items():
        ways = {way: step for way, step in WAYS.items() if equation.order > 1 or way != "plain jet"}
        if not options.compiled:
            del ways["ours, compiled"]
        best, gradients = dict.fromkeys((*ways, "floor"), float("inf")), {}
        for repeat in range(options.repeats + 1):
            # One after the other in every repeat, so that all see the same noise of a shared machine.
            for way, step in ways.items():
                network.zero_grad()
                seconds = _seconds(partial(step, equation, network, x, t, options.chunk), x.device)
                best[way] = min(best[way], seconds) if repeat else best[way]
                gradients[way] = torch.cat([p.grad.reshape(-1) for p in network.parameters() if p.grad is not None])
            seconds = _seconds(partial(floor, equation, network, x, options.chunk), x.device)
            best["floor"] = min(best["floor"], seconds) if repeat else best["floor"]
        reference = gradients["nested autograd"]
        for way in ways:
            arguments = [f"--{key}={getattr(options, key)}" for key in ("width", "points", "chunk", "device")]
            memory = subprocess.run(
                [sys.executable, __file__, f"--way={way}", f"--equation={name}", *arguments],
                capture_output=True, text=True, check=True,
            ).stdout.strip()  # fmt: skip
            error = float((gradients[way] - reference).norm() / reference.norm())
            print(
                f"{name:<21}{way:<18}{best[way]:>8.3f}{best[way] / best['nested autograd']:>11.2f}"
                f"{best[way] / best['floor']:>10.2f}{memory:>8} MB{error:>10.0e}", flush=True,
            )  # fmt: skip


def fitting(options: argparse.Namespace) -> None:
    """Seconds and accuracy of fits."""
    for budget in (DEFAULT_BUDGET, Budget(seconds=50)):
        started = time.perf_counter()
        field = fit(SIREN().to(options.device), Mesh.read(options.mesh), budget=budget)
        seconds = time.perf_counter() - started
        error = field.provenance["accuracy"]["mean"] / field.box.frame.scale
        steps = field.provenance["steps"]
        print(f"fit of {options.mesh.stem}: mean distance {error:.5f}, {steps} steps, {seconds:.0f} seconds in all")


def extraction(options: argparse.Namespace) -> None:
    """Seconds of meshes at two resolutions, and of the full grid."""
    shape = Mesh.read(options.mesh)
    field = fit(SIREN().to(options.device), shape, budget=Budget(steps=300))
    print(f"extraction of {options.mesh.stem}, three hidden layers of 128")
    print(
        f"{'resolution':>10}{'vertices':>10}{'evaluated':>11}{'seconds':>9}{'full grid':>11}{'ratio':>7}{'beyond':>8}"
    )
    with tempfile.TemporaryDirectory() as folder:
        for resolution in (128, 256, 512):
            count, spent = 0, 0.0

            def watched(x: Tensor) -> Tensor:
                nonlocal count, spent
                started = time.perf_counter()
                value = field(x).cpu()
                count, spent = count + len(x), spent + time.perf_counter() - started
                return value

            started = time.perf_counter()
            mesh = extract(watched, resolution=resolution, box=field.box)
            mesh.write(Path(folder) / "frame.ply")
            seconds = time.perf_counter() - started
            points = field.box.uniform(1 << 21, generator=torch.Generator().manual_seed(0))
            with torch.no_grad():
                dense = _seconds(lambda: [field(part) for part in points.split(1 << 16)], field.device)  # noqa: B023
            grid = 1.0
            for side in field.box.size:
                grid *= resolution * side / max(field.box.size) + 1
            dense *= grid / len(points)
            print(
                f"{resolution:>10}{len(mesh.vertices):>10,}{count:>11,}{seconds:>9.1f}{dense:>11.1f}"
                f"{seconds / dense:>7.3f}{seconds - spent:>8.2f}", flush=True,
            )  # fmt: skip


def showing(options: argparse.Namespace) -> None:
    """Seconds until something is seen."""
    shape = Mesh.read(options.mesh)
    still = fit(SIREN().to(options.device), shape, budget=Budget(steps=300))
    moving = Placed(lift(still.field), still.box.during((0.0, 1.0)))
    mesh, viewed = extract(still, resolution=128), ViewedField(moving, name="")
    tasks: dict[str, Callable[[], object]] = {
        "a traced picture": lambda: image(still),
        "a picture of a mesh": lambda: image(mesh),
        "a new time in the viewer": lambda: viewed.surface((0.5,), resolution=64),
    }
    print(f"seconds until {options.mesh.stem} is seen, three hidden layers of 128, {len(mesh.faces):,} triangles")
    for name, task in tasks.items():
        print(f"{name:<26}{min(_seconds(task, still.device) for _ in range(3)):>6.2f}", flush=True)


def nested(equation: Equation, network: SIREN, x: Tensor, t: Tensor, chunk: int) -> None:
    """Gradient of the field, then the derivatives that a residual needs one by one, then the weights."""
    x, t = x.clone().requires_grad_(), t.clone().requires_grad_()
    u = torch.cat([x, t], dim=1)
    for layer in network.hidden:
        u = torch.sin(network.omega * layer(u))  # type: ignore[operator]
    f = network.last(u)[:, 0]
    gradient, dt = torch.autograd.grad(f.sum(), (x, t), create_graph=True)
    if isinstance(equation, MeanCurvature):
        norm = gradient.norm(dim=1)
        normal = gradient / norm[:, None]
        columns = [torch.autograd.grad(normal[:, i].sum(), x, create_graph=True)[0][:, i] for i in range(3)]
        residual = dt[:, 0] - equation.rate * norm * torch.stack(columns).sum(0)
    else:
        residual = equation.residual(x.detach(), t.detach(), Jet(f, torch.cat([gradient, dt], dim=1), None, 3))
    (residual**2).mean().backward()


def plain(equation: Equation, network: SIREN, x: Tensor, t: Tensor, chunk: int) -> None:
    """All derivative planes pushed forward, in chunks."""
    _by_jet(equation, lambda x, t: network.push(identity(x, t, order=equation.order)), x, t, chunk)


def ours(equation: Equation, network: SIREN, x: Tensor, t: Tensor, chunk: int) -> None:
    """What training does: the adjoint, and with it the Hessian, in chunks."""
    _by_jet(equation, lambda x, t: network.jet(x, t, order=equation.order), x, t, chunk)


def compiled(equation: Equation, network: SIREN, x: Tensor, t: Tensor, chunk: int) -> None:
    """Ours, with what stands between the matrix products fused by torch.compile."""
    _by_jet(equation, torch.compile(partial(network.jet, order=equation.order)), x, t, chunk)


def _by_jet(equation: Equation, jet: Callable[[Tensor, Tensor], Jet], x: Tensor, t: Tensor, chunk: int) -> None:
    for a, b in zip(x.split(chunk), t.split(chunk), strict=True):
        ((equation.residual(a, b, jet(a, b)) ** 2).sum() / len(x)).backward()


@torch.no_grad()
def floor(equation: Equation, network: SIREN, x: Tensor, chunk: int) -> None:
    """The matrix products of a step and nothing else.

    A layer takes the value, the adjoint, and for curvature the three planes of first derivatives: that many columns
    forward, the same for the gradient of its input, and again for that of its weight. The first layer has no gradient
    of its input, and its planes are the same for all points.
    """
    planes = 3 if equation.order > 1 else 0
    for part in x.split(chunk):
        n = len(part)
        for i, layer in enumerate(network.hidden):
            weight: Tensor = layer.weight  # type: ignore[assignment, union-attr]
            out, inner = weight.shape
            columns = n * (2 + planes) if i else n * 2
            left, right = weight.new_zeros(columns, inner), weight.new_zeros(columns, out)
            left @ weight.T
            right.T @ left
            if i:
                right @ weight


WAYS = {"nested autograd": nested, "plain jet": plain, "ours": ours, "ours, compiled": compiled}
PARTS = {"steps": steps, "fit": fitting, "extract": extraction, "show": showing}


def _seconds(run: Callable[[], object], device: torch.device) -> float:
    started = time.perf_counter()
    run()
    if device.type == "cuda":
        torch.cuda.synchronize()
    return time.perf_counter() - started


def _problem(options: argparse.Namespace) -> tuple[SIREN, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(0)
    network = SIREN(3, 1, width=options.width, depth=3).to(options.device)
    x = 2 * torch.rand(options.points, 3, generator=generator) - 1
    t = 2 * torch.rand(options.points, 1, generator=generator) - 1
    return network, x.to(options.device), t.to(options.device)


def _memory(options: argparse.Namespace) -> int:
    """Peak memory of one step in a process of its own, less what was there before it, in MB."""
    network, x, t = _problem(options)
    equation, step, few = EQUATIONS[options.equation], WAYS[options.way], slice(0, 8)
    step(equation, network, x[few], t[few], options.chunk)
    if x.is_cuda:
        torch.cuda.reset_peak_memory_stats()
        before = torch.cuda.memory_allocated()
        step(equation, network, x, t, options.chunk)
        return round((torch.cuda.max_memory_allocated() - before) / 2**20)
    Path("/proc/self/clear_refs").write_text("5")
    before = _peak()
    step(equation, network, x, t, options.chunk)
    return round(_peak() - before)


def _peak() -> float:
    """The greatest resident memory of this process since it was last reset, in MB; Linux only."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 2**10


if __name__ == "__main__":
    main()
