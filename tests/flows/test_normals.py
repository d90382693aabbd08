"""Normals at the vertices of spheres, circles and bad meshes."""

from __future__ import annotations

import numpy as np
import pytest

from levelflow.flows.normals import smooth_normals
from levelflow.shapes import Mesh
from tests.flows.examples import DIRTY, ball, polygon


def test_on_circles_and_spheres_they_are_exact_however_the_triangles_lie() -> None:
    rng = np.random.default_rng(0)
    angle = np.sort(rng.uniform(0, 2 * np.pi, 50))
    i = np.arange(50)
    circle = Mesh(np.stack([np.cos(angle), np.sin(angle)], axis=1), np.stack([i, (i + 1) % 50], axis=1))
    sphere = ball(3, 16, radius=0.5)
    round_ = Mesh(sphere.vertices / np.linalg.norm(sphere.vertices, axis=1, keepdims=True), sphere.faces)
    for mesh in (circle, round_):
        assert np.allclose(smooth_normals(mesh), mesh.vertices, atol=1e-9)
    assert np.abs(round_.vertex_normals - round_.vertices).max() > 0.1


def test_better_normals_are_taken_as_they_are() -> None:
    mesh = polygon(5)
    given = Mesh(mesh.vertices, mesh.faces, normals=mesh.vertices[::-1])
    assert np.array_equal(smooth_normals(given), mesh.vertices[::-1])


@pytest.mark.parametrize("name", DIRTY)
def test_they_are_unit_or_zero(name: str) -> None:
    lengths = np.linalg.norm(smooth_normals(DIRTY[name]), axis=1)
    assert np.all((np.abs(lengths - 1) < 1e-12) | (lengths == 0))
