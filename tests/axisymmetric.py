"""References for surfaces of revolution under mean curvature of rate 1, in one and two dimensions instead of three.

The fronts are the accurate ones: a profile r(z, t) and a closed curve (r, z)(u, t), by the method of lines and a stiff
solver with error control, to within the last thousandth of their time. `Revolved` is the level-set method in the half
plane, which shares nothing with them and goes on through pinches and poles.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
import torch.nn.functional as F
from scipy.integrate import solve_ivp
from torch import Tensor

from levelflow.shapes import Solid


class Neck:
    r"""A surface of revolution with the profile r(z, t), 0 <= z <= length, mirrored at both ends, until it pinches.

    $r_t = m(z) (r_{zz} / (1 + r_z^2) - 1 / r)$, by central differences on n cells; the mask m, 1 by default,
    holds ends where it is 0. A thin neck shrinks like a cylinder, so that the time left at the radius $\epsilon$ at
    which it is stopped is about $\epsilon^2 / 2$.

    Attributes:
        pinch: The time at which the neck at z = 0 closes; NaN if it has not by the time `last`.
    """

    def __init__(
        self,
        profile: Callable[[np.ndarray], np.ndarray],
        length: float,
        *,
        n: int,
        stop: float,
        mask: Callable[[np.ndarray], np.ndarray] = np.ones_like,
        last: float = 1.0,
    ) -> None:
        self._z = np.linspace(0, length, n + 1)
        h, moves = length / n, mask(self._z)

        def rate(t: float, r: np.ndarray) -> np.ndarray:
            wide = np.concatenate([r[1:2], r, r[-2:-1]])
            slope, bend = (wide[2:] - wide[:-2]) / (2 * h), (wide[2:] + wide[:-2] - 2 * r) / h**2
            return moves * (bend / (1 + slope**2) - 1 / r)

        self._run = _until(lambda r: r[0] - stop, rate, profile(self._z), last=last, method="LSODA", lband=1, uband=1)
        self.pinch = float(self._run.t[-1]) + stop**2 / 2 if self._run.status == 1 else math.nan

    def radius(self, z: np.ndarray, t: float) -> np.ndarray:
        """The radius at heights z, at a time before the neck was stopped."""
        return np.interp(z, self._z, self._run.sol(t))


def ring(major: float, minor: float, *, n: int = 64) -> float:
    r"""When a torus collapses to a circle or, if it is fat, its hole closes.

    The curve $X(u, t)$ of its section moves by $X_{uu} / |X_u|^2 - (n_r / r)\, n$, which is the motion along n with a
    tangential part that keeps points apart; derivatives are those of the trigonometric interpolant. What is left of a
    thin section of area A takes $A / 2 \pi$, and of a hole of radius r about $r^2 / 2$.
    """
    u, wave = 2 * np.pi * np.arange(n) / n, 1j * np.fft.fftfreq(n, 1 / n)

    def derivative(x: np.ndarray, order: int) -> np.ndarray:
        return np.fft.ifft(wave**order * np.fft.fft(x)).real

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        r, z = x[:n], x[n:]
        ru, zu = derivative(r, 1), derivative(z, 1)
        square = ru**2 + zu**2
        return np.concatenate(
            [
                derivative(r, 2) / square - zu**2 / (square * r),
                derivative(z, 2) / square + zu * ru / (square * r),
            ]
        )

    def area(x: np.ndarray) -> float:
        return float(np.mean(x[:n] * derivative(x[n:], 1) - x[n:] * derivative(x[:n], 1))) * np.pi

    start = np.concatenate([major + minor * np.cos(u), minor * np.sin(u)])
    run = _until(lambda x: min(area(x) - 1e-5, x[:n].min() - 0.02), rate, start, method="BDF")
    last = run.y[:, -1]
    return float(run.t[-1]) + (area(last) / (2 * np.pi) if area(last) < 1e-4 else last[:n].min() ** 2 / 2)


def bent_ring(major: float, minor: float, times: list[float], *, n: int = 33) -> np.ndarray:
    r"""The least and the greatest radius and the energy of a torus under Willmore flow of rate 1, a row for each time.

    The curve X(u, t) of its section moves by $v\,n$, $v = \tfrac12 (\Delta \kappa + \kappa (k_1^2 + k_2^2) - \tfrac12
    \kappa^3)$, and along itself so that the points stay evenly spaced; derivatives are those of the trigonometric
    interpolant of an odd number of points.
    """
    u, wave = 2 * np.pi * np.arange(n) / n, 1j * np.fft.fftfreq(n, 1 / n)

    def derivative(x: np.ndarray, order: int = 1) -> np.ndarray:
        return np.fft.ifft(wave**order * np.fft.fft(x)).real

    def geometry(x: np.ndarray) -> tuple[np.ndarray, ...]:
        r, z = x[:n], x[n:]
        ru, zu = derivative(r), derivative(z)
        g = np.hypot(ru, zu)
        return r, ru, zu, g, (ru * derivative(z, 2) - zu * derivative(r, 2)) / g**3, zu / (g * r)

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        r, ru, zu, g, k1, k2 = geometry(x)
        kappa = k1 + k2
        v = (derivative(r / g * derivative(kappa)) / (r * g) + kappa * (k1**2 + k2**2) - kappa**3 / 2) / 2
        uneven = np.fft.fft(g * (np.mean(g * k1 * v) / np.mean(g) - k1 * v))
        along = np.fft.ifft(np.concatenate([[0], uneven[1:] / wave[1:]])).real
        return np.concatenate([v * zu / g + along * ru / g, -v * ru / g + along * zu / g])

    start = np.concatenate([major + minor * np.cos(u), minor * np.sin(u)])
    run = solve_ivp(rate, (0, max(times)), start, method="BDF", rtol=1e-7, atol=1e-9, t_eval=times)
    fine = np.exp(1j * np.outer(np.linspace(0, 2 * np.pi, 2000), np.fft.fftfreq(n, 1 / n)))
    rows = []
    for x in run.y.T:
        r, _, _, g, k1, k2 = geometry(x)
        radii = (fine @ (np.fft.fft(r) / n)).real
        rows.append((radii.min(), radii.max(), np.pi**2 * np.mean((k1 + k2) ** 2 * r * g)))
    return np.array(rows)


def _until(event: Callable, rate: Callable, start: np.ndarray, *, last: float = 1.0, **more: object):
    """The solution until the event becomes zero."""

    def stop(t: float, x: np.ndarray) -> float:
        return event(x)

    stop.terminal = True
    return solve_ivp(rate, (0.0, last), start, rtol=1e-8, atol=1e-10, events=stop, dense_output=True, **more)


class Revolved:
    """A surface of revolution about the z axis, symmetric in z, on its way, whatever becomes of it.

    Its field f(r, z, t) moves by the curvature of the plane and that of the parallels,

        f_t = rate m(z) (f_rr + f_zz - n^T H n + f_r / r),   n = grad f / |grad f|,

    on a grid that lies half a cell off the axis and off the plane z = 0, in which all is mirrored. Central differences
    and Euler's steps of a fifth of h^2: of second order in h.

    Args:
        solid: Gives the signed distance in three dimensions.
        radius: How far the grid reaches from the axis.
        height: How far it reaches from z = 0; there it is mirrored too, as a period of a wave is.
        spacing: h.
        rate: As in `MeanCurvature`.
        mask: m, which holds the surface where it is 0; 1 unless it is given.

    Attributes:
        f: The values, (radii, heights).
        time: Where it stands.
    """

    def __init__(
        self,
        solid: Solid,
        radius: float,
        height: float,
        *,
        spacing: float,
        rate: float = 1.0,
        mask: Callable[[Tensor], Tensor] = torch.ones_like,
    ) -> None:
        self.spacing, self.rate, self.time = spacing, rate, 0.0
        self.r, self.z = (
            spacing * (torch.arange(math.ceil(reach / spacing - 1e-9), dtype=torch.float64) + 0.5)
            for reach in (radius, height)
        )
        self._moves = mask(self.z)
        r, z = torch.meshgrid(self.r, self.z, indexing="ij")
        points = torch.stack([r, torch.zeros_like(r), z], dim=-1).reshape(-1, 3)
        self.f = solid.distance(points).reshape(r.shape)

    def step(self, limit: float = math.inf) -> None:
        """One Euler step, not beyond the time `limit`."""
        h = self.spacing
        dt = min(0.2 * h**2 / self.rate, limit - self.time)
        f = F.pad(self.f[None, None], (1, 1, 1, 1), mode="replicate")[0, 0]
        middle, inner, outer, below, above = f[1:-1, 1:-1], f[:-2, 1:-1], f[2:, 1:-1], f[1:-1, :-2], f[1:-1, 2:]
        fr, fz = (outer - inner) / (2 * h), (above - below) / (2 * h)
        frr, fzz = (outer + inner - 2 * middle) / h**2, (above + below - 2 * middle) / h**2
        frz = (f[2:, 2:] + f[:-2, :-2] - f[2:, :-2] - f[:-2, 2:]) / (4 * h**2)
        across = fz**2 * frr - 2 * fr * fz * frz + fr**2 * fzz
        # Where the gradient vanishes the direction of the level set is anyone's: half the Laplacian is its mean.
        plane = torch.where(fr**2 + fz**2 > 1e-10, across / (fr**2 + fz**2).clamp_min(1e-10), (frr + fzz) / 2)
        self.f = middle + dt * self.rate * self._moves * (plane + fr / self.r[:, None])
        self.time += dt

    def run(self, time: float) -> Revolved:
        """Goes on to a time."""
        while self.time < time - 1e-15:
            self.step(time)
        return self

    def on_axis(self, height: int = 0) -> float:
        """The value on the axis beside a row of the grid; the row 0 is at z = 0. Even in r, so of fourth order."""
        return float((9 * self.f[0, height] - self.f[1, height]) / 8)

    def profile(self) -> tuple[Tensor, Tensor]:
        """The heights z of the rows that the surface crosses, and its outermost radius there."""
        rows, radii = [], []
        for j in range(len(self.z)):
            crossed = ((self.f[:-1, j] < 0) & (self.f[1:, j] >= 0)).nonzero()
            if len(crossed):
                i = int(crossed[-1])
                a, b = self.f[i, j], self.f[i + 1, j]
                rows.append(self.z[j])
                radii.append(self.r[i] + self.spacing * a / (a - b))
        return torch.stack(rows), torch.stack(radii)

    def time_of(self, quantity: Callable[[Revolved], float], *, last: float) -> float:
        """The time at which a quantity changes its sign, linear between two steps."""
        now = quantity(self)
        while self.time < last:
            before, value = self.time, now
            self.step()
            now = quantity(self)
            if (now < 0) != (value < 0):
                return before + (self.time - before) * value / (value - now)
        raise ValueError(f"Revolved.time_of(last={last:g}): the quantity is still {now:g}; wait longer.")


def pinch(flow: Revolved, *, last: float) -> float:
    """The time at which the neck at z = 0 closes, or the hole there."""
    return flow.time_of(lambda now: now.on_axis(), last=last)


def collapse(flow: Revolved, *, last: float) -> float:
    """The time at which nothing is left."""
    return flow.time_of(lambda now: float(now.f.min()), last=last)
