"""What a training step of a mean-curvature residual costs, by three exact ways to the same gradient.

    python benchmarks/jets.py [--width 256] [--points 8192] [--repeats 5] [--device cpu]

Nested autograd (what the papers' codes do), the plain jet (all planes pushed forward), and the adjoint Hessian that
training uses, in chunks. Each line has the best of the repeats, its ratio to nested autograd in the same run, the peak
memory of the step beyond what was there before, and how far its gradient is from that of nested autograd.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from levelflow import SIREN
from levelflow.equations import MeanCurvature
from levelflow.jets import Jet, identity

RATE = 0.1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=256)
    parser.add_argument("--points", type=int, default=8192)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--chunk", type=int, default=1024)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--way", choices=WAYS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.way:
        print(_memory(options))
        return
    network, x, t = _problem(options)
    print(
        f"SIREN, three hidden layers of {options.width}, {options.points} space-time points, float32, "
        f"{options.device}, {torch.get_num_threads()} threads, PyTorch {torch.__version__}"
    )
    print(f"{'way':<18}{'seconds':>10}{'ratio':>8}{'memory':>12}{'gradient':>12}")
    best, gradients = {way: float("inf") for way in WAYS}, {}
    for repeat in range(options.repeats + 1):
        # One after the other in every repeat, so that all see the same noise of a shared machine.
        for way, step in WAYS.items():
            network.zero_grad()
            started = time.perf_counter()
            step(network, x, t, options.chunk)
            if x.is_cuda:
                torch.cuda.synchronize()
            if repeat:
                best[way] = min(best[way], time.perf_counter() - started)
            gradients[way] = torch.cat([p.grad.reshape(-1) for p in network.parameters() if p.grad is not None])
    reference = gradients["nested autograd"]
    for way in WAYS:
        arguments = [f"--{name}={getattr(options, name)}" for name in ("width", "points", "chunk", "device")]
        memory = subprocess.run(
            [sys.executable, __file__, f"--way={way}", *arguments], capture_output=True, text=True, check=True
        ).stdout.strip()
        error = float((gradients[way] - reference).norm() / reference.norm())
        print(f"{way:<18}{best[way]:>10.3f}{best[way] / best['nested autograd']:>8.2f}{memory:>9} MB{error:>12.0e}")


def nested(network: SIREN, x: Tensor, t: Tensor, chunk: int) -> None:
    """Gradient of the field, then divergence of the normal component by component, then the weights."""
    x, t = x.clone().requires_grad_(), t.clone().requires_grad_()
    u = torch.cat([x, t], dim=1)
    for layer in network.hidden:
        u = torch.sin(network.omega * layer(u))
    f = network.last(u)[:, 0]
    gradient, dt = torch.autograd.grad(f.sum(), (x, t), create_graph=True)
    norm = gradient.norm(dim=1)
    normal = gradient / norm[:, None]
    columns = [torch.autograd.grad(normal[:, i].sum(), x, create_graph=True)[0][:, i] for i in range(3)]
    residual = dt[:, 0] - RATE * norm * torch.stack(columns).sum(0)
    (residual**2).mean().backward()


def plain(network: SIREN, x: Tensor, t: Tensor, chunk: int) -> None:
    """All derivative planes pushed forward, in chunks."""
    _by_jet(lambda x, t: network.push(identity(x, t, order=2)), x, t, chunk)


def adjoint(network: SIREN, x: Tensor, t: Tensor, chunk: int) -> None:
    """The adjoint Hessian, in chunks."""
    _by_jet(lambda x, t: network.jet(x, t, order=2), x, t, chunk)


def _by_jet(jet: Callable[[Tensor, Tensor], Jet], x: Tensor, t: Tensor, chunk: int) -> None:
    equation = MeanCurvature(RATE)
    for a, b in zip(x.split(chunk), t.split(chunk), strict=True):
        ((equation.residual(a, b, jet(a, b)) ** 2).sum() / len(x)).backward()


WAYS = {"nested autograd": nested, "plain jet": plain, "adjoint Hessian": adjoint}


def _problem(options: argparse.Namespace) -> tuple[SIREN, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(0)
    network = SIREN(3, 1, width=options.width, depth=3).to(options.device)
    x = 2 * torch.rand(options.points, 3, generator=generator) - 1
    t = 2 * torch.rand(options.points, 1, generator=generator) - 1
    return network, x.to(options.device), t.to(options.device)


def _memory(options: argparse.Namespace) -> int:
    """Peak memory of one step in a process of its own, less what was there before it, in MB."""
    network, x, t = _problem(options)
    few = slice(0, 8)
    WAYS[options.way](network, x[few], t[few], options.chunk)
    if x.is_cuda:
        torch.cuda.reset_peak_memory_stats()
        before = torch.cuda.memory_allocated()
        WAYS[options.way](network, x, t, options.chunk)
        return round((torch.cuda.max_memory_allocated() - before) / 2**20)
    Path("/proc/self/clear_refs").write_text("5")
    before = _peak()
    WAYS[options.way](network, x, t, options.chunk)
    return round(_peak() - before)


def _peak() -> float:
    """The greatest resident memory of this process since it was last reset, in MB; Linux only."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 2**10


if __name__ == "__main__":
    main()
