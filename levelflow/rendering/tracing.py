"""Sphere tracing: where the ray through each pixel meets the zero set of a field, distance or not."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from levelflow.boxes import Box
from levelflow.curvature import normal
from levelflow.extraction import EmptyLevelSet
from levelflow.fields import Field
from levelflow.jets import Jet
from levelflow.rendering.camera import Camera, Vector
from levelflow.rendering.hits import Hits, towards_eye

# How much steeper than measured a field may be: samples of a slope underestimate it between the samples.
_SAFETY = 1.2
_SLOPE_SAMPLES = 8192
_POINTS_AT_ONCE = {"cpu": 1 << 13}
# The pictures whose hits foretell those of the next have at least this many pixels along the shorter side.
_COARSE = 48
# Pixels: the greatest slope of depth at which a coarser picture foretells a finer one, and how far before the surface
# the cones of the coarser picture may have ended.
_STEEPEST, _NEAR = 4.0, 8.0
# Pixels that a ray may go on near the surface where the usual slope, not the bound, says that there is none.
_STRIDE = 8.0
# Regula falsi after the sign has changed; the jet at the hit makes one Newton step more.
_FALSI = 2
# The cosine between the normals of neighbouring pixels below which there is an edge.
_CREASE = 0.8


def sphere_trace(
    field: Field,
    camera: Camera,
    *,
    height: int,
    width: int,
    box: Box | None = None,
    lipschitz: float | None = None,
    samples: int = 1,
) -> Hits:
    r"""The points of $\{f = 0\}$ seen in each pixel, with the normals of the field's jets.

    A ball of radius $|f(x)| / L$ around x holds no surface if L bounds the slope of f; so a ray may go on by that much,
    whether f is a distance or not. By default L is 1.2 times the steepest slope at 8192 points of the box. Near the
    surface a step is that of the secant, until the sign changes and regula falsi keeps it bracketed; it ends at most a
    pixel behind where the surface would be at the usual slope, so that thinner things may be passed over.

    Coarse pictures come first. A whole pixel of theirs goes on as a cone, as far as it certainly meets nothing, and the
    finer pixels in it start there. Where the coarse hits around a pixel lie on a smooth piece of surface, and the cones
    came near it, the depth between them is a guess that one Newton step brings home, or refutes.

    Args:
        field: A field over three space coordinates, without times.
        camera: From where.
        height: Rows of the picture.
        width: Columns.
        box: Where to look for the surface; by default the box of the field. It is seen open where it leaves the box.
        lipschitz: A bound L of the slope in the box, if one is known: 1 for a distance.
        samples: Rays per pixel and axis where there is an edge; elsewhere the ray through the pixel's centre suffices.

    Returns:
        The hits; depths are right to about a hundredth of a pixel.

    Raises:
        ValueError: If a size is not positive, the field is not over space alone, has no box, is not finite, or has no
            positive slope to bound.

    Reference:
        Hart, Sphere tracing, The Visual Computer 12 (1996); Hansson-Söderlund et al., Ray tracing of signed distance
        function grids, JCGT 11 (2022).
    """
    if min(height, width, samples) < 1:
        raise ValueError(
            f"sphere_trace(height={height}, width={width}, samples={samples}): a picture has at least one pixel and "
            "one sample."
        )
    if field.space != 3 or field.times:
        raise ValueError(
            f"sphere_trace(f): the field has {field.space} space and {field.times} time coordinates; it must be over "
            "space alone, R^3. Take a slice, `f.at(t)`, or draw a plane curve with `image(extract(f))`."
        )
    box = box or field.box
    if box is None:
        raise ValueError("sphere_trace(f): the field has no box; say where to look: `sphere_trace(..., box=Box(...))`.")
    with torch.no_grad():
        return _Tracer(field, camera, height, width, box, lipschitz).hits(samples)


def framed(
    field: Field,
    azimuth: float = 30.0,
    elevation: float = 15.0,
    *,
    up: Vector = (0.0, 1.0, 0.0),
    orthographic: bool = False,
    box: Box | None = None,
) -> Camera:
    """A camera that sees the surface of a field and little more, by `Camera.around` what a small picture shows of it.

    Raises:
        EmptyLevelSet: If that picture shows nothing.
    """
    box = box or field.box
    if box is None:
        raise ValueError("framed(f): the field has no box; say where its surface is: `framed(..., box=Box(...))`.")
    wide = Camera.around(box, azimuth, elevation, up=up, orthographic=orthographic)
    points = sphere_trace(field, wide, height=96, width=96, box=box).points
    if not len(points):
        raise EmptyLevelSet(
            f"framed(f): no surface is seen in the box from {box.lower} to {box.upper}: it has vanished, or lies "
            "outside the box."
        )
    return Camera.around(points, azimuth, elevation, up=up, orthographic=orthographic)


@dataclass(frozen=True)
class _Level:
    """A picture of pixels that are `factor` times as large: safe depths and hits, infinite where nothing is seen.

    Normals are NaN where they are not known yet.
    """

    factor: int
    safe: np.ndarray
    depth: np.ndarray
    side: np.ndarray
    normals: np.ndarray


@dataclass(frozen=True)
class _Rays:
    """Rays o + z v within the box, from the depth `first` to `last`."""

    origins: np.ndarray
    directions: np.ndarray
    first: np.ndarray
    last: np.ndarray

    def __getitem__(self, index: np.ndarray) -> _Rays:
        return _Rays(self.origins[index], self.directions[index], self.first[index], self.last[index])

    def at(self, depth: np.ndarray) -> np.ndarray:
        return self.origins + depth[:, None] * self.directions


class _Tracer:
    def __init__(
        self, field: Field, camera: Camera, height: int, width: int, box: Box, lipschitz: float | None
    ) -> None:
        self.field, self.camera, self.height, self.width = field, camera, height, width
        self.box, self.lower, self.upper = box, np.array(box.lower), np.array(box.upper)
        tensors = itertools.chain(field.parameters(), field.buffers())
        self.device = next((tensor.device for tensor in tensors), torch.device("cpu"))
        self.pixel = camera.footprint(height=height, width=width)
        slopes = self._slopes()
        self.lipschitz = _SAFETY * float(slopes.max()) if lipschitz is None else lipschitz
        # A field that is flat nearly everywhere is no less steep at its surface.
        self.usual = max(float(slopes.median()), self.lipschitz / 3)
        if not 0 < self.lipschitz < np.inf:
            raise ValueError(
                f"sphere_trace(f): the slope of the field in the box is bounded by {self.lipschitz:g}; without a "
                "positive slope there is no surface to find. Look at the training of the field, or at `lipschitz`."
            )

    def hits(self, samples: int) -> Hits:
        """The hits of the finest picture, with more rays where there are edges."""
        factor = 1
        while min(self.height, self.width) // (2 * factor) >= _COARSE:
            factor *= 2
        level = self._level(factor, None)
        coarser = level
        while factor > 1:
            coarser, factor = level, factor // 2
            level = self._level(factor, coarser)
        pixels = np.flatnonzero(np.isfinite(level.depth).reshape(-1))
        rows, columns = np.divmod(pixels, self.width)
        rays = self._rays(columns + 0.5, rows + 0.5)
        depth, normals = level.depth.reshape(-1)[pixels], level.normals.reshape(-1, 3)[pixels]
        rough = np.flatnonzero(np.isnan(normals[:, 0]))
        depth[rough], normals[rough] = self._landed(rays[rough], depth[rough])
        weights, points, behind = np.ones(len(pixels)), rays.at(depth), (normals * rays.directions).sum(1) > 0
        if samples > 1:
            edges = self._edges(pixels, depth, normals)
            inner = ~edges[pixels]
            more = self._samples(np.flatnonzero(edges), samples, coarser)
            old = (pixels, weights, points, normals, depth, behind)
            pixels, weights, points, normals, depth, behind = (
                np.concatenate([a[inner], b]) for a, b in zip(old, more, strict=True)
            )
        towards = towards_eye(self.camera, points)
        return Hits(self.height, self.width, pixels, weights, points, normals, depth, towards, behind)

    def _level(self, factor: int, coarser: _Level | None) -> _Level:
        """The picture with larger pixels: foretold by a coarser one where that is safe, else traced."""
        shape = (-(-self.height // factor), -(-self.width // factor))
        rows, columns = (index.reshape(-1) for index in np.indices(shape))
        rays = self._rays(factor * (columns + 0.5), factor * (rows + 0.5))
        safe, depth, side = np.full(len(rows), -np.inf), np.full(len(rows), np.inf), np.ones(len(rows))
        normals, todo = np.full((len(rows), 3), np.nan), np.arange(len(rows))
        if coarser is not None:
            safe = coarser.safe[rows // 2, columns // 2]
            guess, from_side, known = _foretold(coarser, rows, columns, self.camera, self.pixel)
            found, seen, right = self._confirmed(rays[known], guess[known], from_side[known], factor)
            known = known[right]
            side[known], depth[known], normals[known] = from_side[known], found[right], seen[right]
            todo = np.flatnonzero(np.isinf(depth) & np.isfinite(safe))
        if factor > 1 or coarser is None:
            # Pixels that were foretold need cones as well, for the sake of the next picture.
            alive = np.flatnonzero(safe < np.inf)
            safe[alive] = self._cones(rays[alive], safe[alive], factor)
            todo = todo[np.isfinite(safe[todo])]
        depth[todo], side[todo] = self._marched(rays[todo], safe[todo], factor)
        return _Level(
            factor, safe.reshape(shape), depth.reshape(shape), side.reshape(shape), normals.reshape(*shape, 3)
        )

    def _rays(self, columns: np.ndarray, rows: np.ndarray) -> _Rays:
        origins, directions = self.camera.rays(columns, rows, height=self.height, width=self.width)
        return _Rays(origins, directions, *self._interval(origins, directions, 0.0))

    def _interval(self, origins: np.ndarray, directions: np.ndarray, margin: float) -> tuple[np.ndarray, np.ndarray]:
        """The depths at which rays enter and leave the box with a margin around it; first > last where they miss it."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.stack([self.lower - margin - origins, self.upper + margin - origins]) / directions
        # A ray within a side of the box has 0 / 0 there, and is inside.
        ends = np.where(np.isnan(ends), np.array([-np.inf, np.inf])[:, None, None], ends)
        first, last = ends.min(0).max(1), ends.max(0).min(1)
        return (first if self.camera.orthographic else first.clip(min=0)), last

    def _radius(self, depth: np.ndarray, factor: int) -> np.ndarray:
        """Half the diagonal of a pixel at a depth."""
        side = factor * self.pixel * np.sqrt(0.5)
        return np.full_like(depth, side) if self.camera.orthographic else side * depth

    def _cones(self, rays: _Rays, start: np.ndarray, factor: int) -> np.ndarray:
        """How far each pixel as a whole meets nothing: a depth near the surface, infinite if it leaves the box."""
        reach = np.linalg.norm(self.camera.eye - (self.lower + self.upper) / 2) + np.linalg.norm(
            self.upper - self.lower
        )
        margin = float(self._radius(np.array([reach]), factor)[0])
        first, last = self._interval(rays.origins, rays.directions, margin)
        speed = np.linalg.norm(rays.directions, axis=1)
        widening = 0.0 if self.camera.orthographic else float(self._radius(np.ones(1), factor)[0])
        depth, out = np.maximum(first, start), np.full(len(start), np.inf)
        active = np.flatnonzero(depth < last)
        while len(active):
            points = rays[active].at(depth[active])
            inside = points.clip(self.lower, self.upper)
            # No point of the box is nearer to a point outside than it is to that point's projection onto the box.
            empty = np.hypot(np.abs(self._values(inside)) / self.lipschitz, np.linalg.norm(points - inside, axis=1))
            radius = self._radius(depth[active], factor)
            step = (empty - radius) / (speed[active] + widening)
            near = step < radius
            out[active[near]] = depth[active[near]]
            depth[active] += step
            active = active[~near & (depth[active] < last[active])]
        return out

    def _marched(self, rays: _Rays, start: np.ndarray, factor: int) -> tuple[np.ndarray, np.ndarray]:
        """The depths at which rays first meet the surface, infinite if they do not, and from which side they came."""
        depth, hit, side = np.maximum(rays.first, start), np.full(len(start), np.inf), np.ones(len(start))
        active = np.flatnonzero(depth <= rays.last)
        if not len(active):
            return hit, side
        value = np.zeros(len(start))
        value[active] = self._values(rays[active].at(depth[active]))
        side[active] = np.where(value[active] > 0, 1.0, -1.0)
        value = np.abs(value)
        bound = self.lipschitz * np.linalg.norm(rays.directions, axis=1)
        slope = -bound
        brackets: list[tuple[np.ndarray, ...]] = []
        while len(active):
            z, f, b, g = depth[active], value[active], bound[active], slope[active]
            pixel = factor * self.pixel * (1.0 if self.camera.orthographic else z)
            secant = np.where(g < 0, -1.02 * f / np.where(g < 0, g, 1.0) + 0.01 * pixel, np.inf)
            most = pixel + np.minimum(f / self.usual, _STRIDE * pixel)
            sure = np.maximum(f / b, np.minimum(secant, most))
            # Two empty balls that touch are as good as one: so far the ray goes if the slope along it stays the same.
            step = np.maximum(sure, 1.9 * f / (b - g.clip(-b, 0.9 * b)))
            there = np.minimum(z + step, rays.last[active])
            now = self._values(rays[active].at(there)) * side[active]
            apart = np.flatnonzero((there - z > sure) & (now < b * (there - z) - f))
            there[apart] = z[apart] + sure[apart]
            now[apart] = self._values(rays[active[apart]].at(there[apart])) * side[active[apart]]
            crossed = now <= 0
            brackets.append((active[crossed], z[crossed], f[crossed], there[crossed], now[crossed]))
            depth[active], value[active] = there, now
            slope[active] = (now - f) / np.where(there > z, there - z, np.inf)
            active = active[~crossed & (there < rays.last[active])]
        found, *bracket = (np.concatenate(parts) for parts in zip(*brackets, strict=True))
        hit[found] = self._regula_falsi(rays[found], side[found], *bracket)
        return hit, side

    def _regula_falsi(
        self, rays: _Rays, side: np.ndarray, a: np.ndarray, fa: np.ndarray, b: np.ndarray, fb: np.ndarray
    ) -> np.ndarray:
        for _ in range(_FALSI):
            middle = _secant(a, fa, b, fb)
            value = self._values(rays.at(middle)) * side
            before = value > 0
            a, fa = np.where(before, middle, a), np.where(before, value, fa)
            b, fb = np.where(before, b, middle), np.where(before, fb, value)
        return _secant(a, fa, b, fb)

    def _confirmed(
        self, rays: _Rays, guess: np.ndarray, side: np.ndarray, factor: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Guessed depths after one Newton step; the normals, NaN unless the step is tiny; and whether both are right.

        They are if the step is small and the surface faces the right way.
        """
        inside = (guess >= rays.first) & (guess <= rays.last)
        step, normals, slope = self._newton(rays, np.where(inside, guess, rays.first.clip(max=1e300)))
        most = factor * self.pixel * (1.0 if self.camera.orthographic else guess)
        normals[np.abs(step) > most / 50] = np.nan
        return guess + step, normals, inside & (slope * side < 0) & (np.abs(step) < most / 2)

    def _landed(self, rays: _Rays, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Depths after a last Newton step, and the normals."""
        step, normals, _ = self._newton(rays, depth)
        most = self.pixel * (1.0 if self.camera.orthographic else depth)
        step = np.where(np.abs(step) < most / 2, step, 0.0)
        return np.clip(depth + step, rays.first, rays.last), normals

    def _newton(self, rays: _Rays, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The step along each ray to where f is zero to first order; the normal and the slope along the ray."""
        jet = self._jets(rays.at(depth))
        slope = (jet.gradient.numpy() * rays.directions).sum(1)
        return -jet.value.numpy() / np.where(slope == 0, np.inf, slope), normal(jet).numpy(), slope

    def _edges(self, pixels: np.ndarray, depth: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Whether a pixel and one of its four neighbours see different pieces of surface, (h * w,) booleans."""
        shape = (self.height, self.width)
        n, z = np.zeros((*shape, 3)), np.full(shape, np.inf)
        n.reshape(-1, 3)[pixels], z.reshape(-1)[pixels] = normals, depth
        edges = np.zeros(shape, bool)
        for axis in (0, 1):
            first, last = (np.moveaxis(edges, axis, 0)[part] for part in (slice(-1), slice(1, None)))
            (za, zb), (na, nb) = ((np.moveaxis(v, axis, 0)[:-1], np.moveaxis(v, axis, 0)[1:]) for v in (z, n))
            seen = np.isfinite(za) & np.isfinite(zb)
            with np.errstate(invalid="ignore"):
                jump = np.abs(za - zb) > _NEAR * self.pixel * (1.0 if self.camera.orthographic else za)
            differs = (np.isfinite(za) != np.isfinite(zb)) | (seen & (jump | ((na * nb).sum(-1) < _CREASE)))
            first |= differs
            last |= differs
        return edges.reshape(-1)

    def _samples(self, pixels: np.ndarray, samples: int, coarser: _Level) -> tuple[np.ndarray, ...]:
        """Pixels, weights, points, normals, depths and sides of what a grid of rays in each of some pixels sees."""
        share = (np.arange(samples) + 0.5) / samples
        down, right = (part.reshape(-1) for part in np.meshgrid(share, share, indexing="ij"))
        owner = np.repeat(pixels, samples**2)
        rows, columns = np.divmod(owner, self.width)
        rays = self._rays(columns + np.tile(right, len(pixels)), rows + np.tile(down, len(pixels)))
        scale = coarser.factor
        depth, _ = self._marched(rays, coarser.safe[rows // scale, columns // scale], 1)
        seen = np.isfinite(depth)
        rays = rays[seen]
        depth, normals = self._landed(rays, depth[seen])
        behind = (normals * rays.directions).sum(1) > 0
        weights = np.full(len(depth), 1 / samples**2)
        return owner[seen], weights, rays.at(depth), normals, depth, behind

    def _slopes(self) -> Tensor:
        """The slopes of the field at points of the box."""
        points = self.box.uniform(_SLOPE_SAMPLES, generator=torch.Generator().manual_seed(0))
        return torch.linalg.vector_norm(self._jets(points.numpy()).gradient.detach(), dim=1)

    def _values(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        parts = [self.field(part.to(self.device)).double().cpu() for part in self._parts(points)]
        values = torch.cat(parts).numpy() if parts else np.zeros(0)
        if not np.isfinite(values).all():
            where = tuple(points[~np.isfinite(values)][0].tolist())
            raise ValueError(
                f"sphere_trace(f): the field is not finite at {int((~np.isfinite(values)).sum())} of {len(values)} "
                f"points, first at {where}. Training may have diverged, or the box leaves the field's domain."
            )
        return values

    def _jets(self, points: Float[np.ndarray, "n 3"]) -> Jet:
        jets = [self.field.jet(part.to(self.device), order=1) for part in self._parts(points)]
        if not jets:
            return Jet(torch.zeros(0), torch.zeros(0, 3), None, 3)
        value, first = torch.cat([jet.value for jet in jets]), torch.cat([jet.gradient for jet in jets])
        return Jet(value.double().cpu(), first.double().cpu(), None, 3)

    def _parts(self, points: np.ndarray) -> tuple[Tensor, ...]:
        n = _POINTS_AT_ONCE.get(self.device.type, 1 << 18)
        return torch.from_numpy(points).split(n) if len(points) else ()


def _secant(a: np.ndarray, fa: np.ndarray, b: np.ndarray, fb: np.ndarray) -> np.ndarray:
    return a + (b - a) * fa / np.where(fa > fb, fa - fb, 1.0)


def _foretold(
    coarser: _Level, rows: np.ndarray, columns: np.ndarray, camera: Camera, pixel: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depths between the hits of a picture with pixels twice as large, the sides, and for which pixels they count."""
    from scipy.ndimage import maximum_filter, minimum_filter

    depth = coarser.depth
    unit = coarser.factor * pixel * (1.0 if camera.orthographic else depth)
    with np.errstate(invalid="ignore"):
        flat = (
            maximum_filter(depth, 3, mode="nearest") - minimum_filter(depth, 3, mode="nearest") < 2 * _STEEPEST * unit
        )
        near = depth - minimum_filter(coarser.safe, 3, mode="nearest") < _NEAR * unit
    one_side = maximum_filter(coarser.side, 3, mode="nearest") == minimum_filter(coarser.side, 3, mode="nearest")
    parent = (rows // 2, columns // 2)
    known = np.flatnonzero((np.isfinite(depth) & flat & near & one_side)[parent])
    # The nearness is affine on the image of a plane, and so exact between the centres of the larger pixels.
    nearness = depth if camera.orthographic else 1 / depth
    nearness = np.pad(nearness, 1, mode="edge")
    i, j = (index[known] for index in parent)
    v, u = 0.5 * (rows[known] % 2) - 0.25, 0.5 * (columns[known] % 2) - 0.25
    di, dj = np.where(v > 0, 1, -1), np.where(u > 0, 1, -1)
    u, v = np.abs(u), np.abs(v)
    a, b, c, d = (nearness[i + 1 + p, j + 1 + q] for p, q in ((0, 0), (0, dj), (di, 0), (di, dj)))
    between = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
    guess = np.full(len(rows), np.inf)
    guess[known] = between if camera.orthographic else 1 / between
    return guess, coarser.side[parent], known
