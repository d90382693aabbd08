"""Every mesh of the shared folder, with what its README says of it."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import torch

from levelflow.shapes import Mesh, MeshWarning

CLOSED = [
    "armadillo.obj",
    "bob.obj",
    "bunny.obj",
    "cactus_highres.off",
    "cheburashka.off",
    "dino.off",
    "falcon.obj",
    "genus6.ply",
    "max-planck.obj",
    "rind_wide.ply",
    "spot.obj",
    "woman.obj",
]
GENUS = {"bob.obj": 1, "spot.obj": 0, "bunny.obj": 0, "genus6.ply": 6, "armadillo.obj": 0}


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def sampled(mesh: Mesh) -> None:
    """Samples lie on the surface, and to their outer side is outside."""
    points, normals = mesh.sample(2000, generator=generator())
    size = max(mesh.box.size)
    assert mesh.distance(points).abs().max() < 1e-12 * size
    step = 1e-4 * size * normals
    assert (mesh.distance(points + step) > 0).double().mean() > 0.99
    assert (mesh.distance(points - step) < 0).double().mean() > 0.99


@pytest.mark.parametrize("name", CLOSED)
def test_closed_meshes_are_watertight_and_give_no_warning(meshes: Path, name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mesh = Mesh.read(meshes / name)
        sampled(mesh)
    assert mesh.is_watertight
    assert mesh.components == 1
    assert mesh.volume > 0
    if name in GENUS:
        assert len(mesh.vertices) - len(mesh.faces) // 2 == 2 - 2 * GENUS[name]


@pytest.mark.parametrize("name", ["cylinder_small.off", "plane-holes.obj"])
def test_open_meshes_warn_of_their_sign(meshes: Path, name: str) -> None:
    mesh = Mesh.read(meshes / name)
    assert not mesh.is_watertight
    with pytest.warns(
        MeshWarning, match=rf"^{name}: the sign of the distance is uncertain, because it is open"
    ) as caught:
        sampled(mesh)
    assert len(caught) == 1
    found = mesh.sign_uncertainty()
    assert found.open_edges == {"cylinder_small.off": 40, "plane-holes.obj": 341}[name]
    assert 1e-4 < found.share < 0.1


def test_the_bar_is_turned(meshes: Path) -> None:
    with pytest.warns(MeshWarning, match="bar1.off: the faces point inward .* turned outward") as caught:
        mesh = Mesh.read(meshes / "bar1.off")
    assert len(caught) == 1
    sampled(mesh)
    assert mesh.volume == pytest.approx(138042.6, rel=1e-6)


def test_all_are_covered(meshes: Path) -> None:
    there = {path.name for path in meshes.iterdir() if path.suffix in (".obj", ".off", ".ply")}
    assert there == {*CLOSED, "cylinder_small.off", "plane-holes.obj", "bar1.off"}


@pytest.mark.parametrize("name", ["max-planck.obj", "genus6.ply"])
def test_units_and_pose_come_back(meshes: Path, tmp_path: Path, name: str) -> None:
    mesh = Mesh.read(meshes / name)
    unit = mesh.normalized()
    assert np.abs(unit.vertices).max() == pytest.approx(1)
    unit.write(tmp_path / "back.obj")
    assert np.abs(Mesh.read(tmp_path / "back.obj").vertices - mesh.vertices).max() < 1e-12 * max(mesh.box.size)
