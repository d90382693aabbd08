"""Meshes for the tests of flows: extracted ones, regular ones and dirty ones; and steps without remeshing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from torch import Tensor

from levelflow import flows
from levelflow.boxes import Box
from levelflow.extraction import extract
from levelflow.shapes import Mesh

CORNERS = ((-1.0, -0.9, -0.95), (1.02, 1.0, 1.0))
"""A box in whose grid nothing is symmetric."""


def extracted(field: Callable[[Tensor], Tensor], resolution: int, *, space: int = 3, refine: int = 3) -> Mesh:
    """The zero set of a function, with the slivers of marching cubes."""
    lower, upper = (corner[:space] for corner in CORNERS)
    return extract(field, resolution=resolution, box=Box(lower, upper), refine=refine)


def ball(space: int, resolution: int, *, radius: float = 0.5) -> Mesh:
    """An extracted circle or sphere."""
    return extracted(lambda x: x.norm(dim=1) - radius, resolution, space=space)


def ring(resolution: int, *, major: float = 0.6, minor: float = 0.25) -> Mesh:
    """An extracted torus about the z axis."""

    def torus(x: Tensor) -> Tensor:
        return ((x[:, :2].norm(dim=1) - major) ** 2 + x[:, 2] ** 2).sqrt() - minor

    return extracted(torus, resolution)


def tube(around: int = 12, along: int = 7, *, radius: float = 0.5) -> Mesh:
    """A cylinder about the z axis from -1 to 1, open at both ends, of right-angled triangles."""
    angle, z = 2 * np.pi * np.arange(around) / around, np.linspace(-1, 1, along)
    a, h = np.meshgrid(angle, z, indexing="ij")
    vertices = np.stack([radius * np.cos(a), radius * np.sin(a), h], axis=2).reshape(-1, 3)
    i, j = (part.reshape(-1) for part in np.meshgrid(np.arange(around), np.arange(along - 1), indexing="ij"))
    near, far = i * along + j, (i + 1) % around * along + j
    faces = np.concatenate([np.stack([near, far, far + 1], 1), np.stack([near, far + 1, near + 1], 1)])
    return Mesh(vertices, faces)


def wound(around: int, across: int, *, major: float = 0.6, minor: float = 0.25) -> tuple[Mesh, np.ndarray]:
    """A torus of a regular grid, and the total curvature at its vertices."""
    u, v = np.meshgrid(*(2 * np.pi * np.arange(n) / n for n in (around, across)), indexing="ij")
    r = major + minor * np.cos(v)
    vertices = np.stack([r * np.cos(u), r * np.sin(u), minor * np.sin(v)], axis=2).reshape(-1, 3)
    i, j = (part.reshape(-1) for part in np.meshgrid(np.arange(around), np.arange(across), indexing="ij"))
    i1, j1 = (i + 1) % around, (j + 1) % across
    a, b, c, d = i * across + j, i1 * across + j, i1 * across + j1, i * across + j1
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return Mesh(vertices, faces), (1 / minor + np.cos(v) / r).reshape(-1)


def icosphere(subdivisions: int = 0, *, radius: float = 1.0) -> Mesh:
    """A sphere of nearly equilateral triangles."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return Mesh(ball.vertices, ball.faces)


def polygon(n: int, *, radius: float = 1.0, center: tuple[float, float] = (0.0, 0.0)) -> Mesh:
    """A regular polygon."""
    angle, i = 2 * np.pi * np.arange(n) / n, np.arange(n)
    vertices = np.array(center) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Mesh(vertices, np.stack([i, (i + 1) % n], axis=1))


def arc(n: int = 40) -> Mesh:
    """An open curve above the x axis from (-1, 0) to (1, 0), which runs to the left."""
    x = np.cos(np.linspace(0, np.pi, n))
    i = np.arange(n - 1)
    return Mesh(np.stack([x, (1 - x**2) * (0.6 + 0.3 * x)], axis=1), np.stack([i, i + 1], axis=1))


def joined(*meshes: Mesh) -> Mesh:
    """One mesh of several bodies."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def moved(mesh: Mesh, displacement: np.ndarray) -> Mesh:
    return Mesh(mesh.vertices + displacement, mesh.faces)


def after(flow: flows.Flow, mesh: Mesh, *, until: float, steps: int) -> Mesh:
    """The mesh at a time, by steps of the flow on the same triangles."""
    dt = until / steps
    for step in range(steps):
        mesh = moved(mesh, flow.displacement(mesh, dt, time=step * dt))
    return mesh


def _dirty() -> dict[str, Mesh]:
    corner = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    tetrahedron = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    sphere = ball(3, 12)
    pinched = sphere.vertices.copy()
    pinched[sphere.faces[0, 0]] = pinched[sphere.faces[0, 1]]
    crushed, random = icosphere(2), np.random.default_rng(2)
    ends = crushed.faces[random.random(len(crushed.faces)) < 0.2, :2]
    vertices = crushed.vertices.copy()
    vertices[ends[:, 0]] = vertices[ends[:, 1]] + 1e-9 * random.normal(size=(len(ends), 3))
    return {
        "needles": extracted(lambda x: x.norm(dim=1) - 0.5 + 1e-9 * (97 * x[:, 0]).sin(), 32),
        "not refined": extracted(lambda x: x.norm(dim=1) - 0.5, 24, refine=0),
        "an edge of no length": Mesh(pinched, sphere.faces),
        "edges of next to nothing": Mesh(vertices, crushed.faces),
        "all corners on a line": Mesh([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 0]], [[0, 1, 2], [0, 2, 3]]),
        "a vertex twice in a face": Mesh(corner, [*tetrahedron, [0, 0, 1]]),
        "a vertex of no face": Mesh([*corner, [5, 5, 5]], tetrahedron),
        "nothing but a point": Mesh(np.zeros((3, 3)), [[0, 1, 2]]),
        "three faces at an edge": Mesh([*corner, [0, -1, 0]], [[0, 1, 2], [0, 1, 3], [0, 1, 4]]),
        "two sides of a triangle": Mesh(corner[:3], [[0, 1, 2], [0, 2, 1]]),
        "open": tube(),
        "two bodies": joined(icosphere(1), tube()),
        "a segment of no length": Mesh([[0.0, 0], [1, 0], [1, 0], [0, 1]], [[0, 1], [1, 2], [2, 3], [3, 0]]),
        "an open curve and a circle": joined(arc(), polygon(20, center=(3, 0))),
        "an extracted circle": ball(2, 24),
    }


DIRTY = _dirty()
"""What extraction and files bring along."""
