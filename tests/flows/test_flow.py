"""What all flows have in common: sums, symmetries, and that no mesh breaks them."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from levelflow import flows
from levelflow.equations import Rotation
from levelflow.flows import (
    Descent,
    Flow,
    MeanCurvature,
    NormalOffset,
    Prescribed,
    SumOfFlows,
    Taubin,
    VolumePreserving,
    area,
    dirichlet,
)
from levelflow.shapes import Mesh
from tests.flows.examples import DIRTY, arc, ball, tube

FLOWS: dict[str, Flow] = {
    "mean curvature": MeanCurvature(0.1),
    "mean curvature, free boundary": MeanCurvature(0.1, fixed_boundary=False),
    "Taubin": Taubin(0.1, -0.103),
    "constant velocity": Prescribed((0.3, -0.2)),
    "offset": NormalOffset(0.2),
    "descent of the area": Descent(area, 0.1),
    "descent of Dirichlet's energy": Descent(dirichlet, 0.1, reach=0.05),
    "volume preserving": VolumePreserving(MeanCurvature(0.1)),
    "sum": MeanCurvature(0.1) + NormalOffset(0.2) + Descent(area, 0.3, reach=0.1),
}
"""One of every kind, none of which knows where the origin is."""


def flow_in(name: str, space: int) -> Flow:
    return Prescribed((0.3, -0.2, 0.5)) if name == "constant velocity" and space == 3 else FLOWS[name]


@dataclass(frozen=True)
class Swell(Flow):
    """A flow of one's own."""

    by: float

    def displacement(self, mesh: Mesh, dt: float, *, time: float) -> np.ndarray:
        return self.by * dt * (1 + time) * mesh.vertices


def test_sums_add_displacements() -> None:
    mesh = ball(2, 16)
    both = Swell(0.3) + NormalOffset(0.1) + Swell(0.2)
    alone = [flow.displacement(mesh, 0.1, time=2.0) for flow in (Swell(0.3), NormalOffset(0.1), Swell(0.2))]
    assert isinstance(both, SumOfFlows)
    assert np.allclose(both.displacement(mesh, 0.1, time=2.0), sum(alone))
    assert np.allclose(Swell(0.5).displacement(mesh, 0.1, time=2.0), 0.15 * mesh.vertices)


def test_they_say_what_they_are() -> None:
    assert repr(MeanCurvature(0.1) + NormalOffset(0.2)) == (
        "MeanCurvature(rate=0.1, fixed_boundary=True) + NormalOffset(speed=0.2)"
    )
    assert repr(VolumePreserving(Prescribed(Rotation(2.0)))) == f"VolumePreserving(flow=Prescribed({Rotation(2.0)!r}))"


@pytest.mark.parametrize("name", FLOWS)
@pytest.mark.parametrize("mesh", [ball(2, 16), arc(), ball(3, 10), tube()], ids=["circle", "arc", "sphere", "tube"])
def test_a_moved_mesh_moves_the_same(name: str, mesh: Mesh) -> None:
    """The displacement does not change with the place, and turns with the mesh."""
    flow, d = flow_in(name, mesh.vertices.shape[1]), mesh.vertices.shape[1]
    here = flow.displacement(mesh, 0.01, time=0.0)
    assert np.abs(here).max() > 1e-6
    there = Mesh(mesh.vertices + np.array([7.0, -3, 2])[:d], mesh.faces)
    assert np.allclose(flow.displacement(there, 0.01, time=0.0), here, atol=1e-9)
    if name != "constant velocity":
        turn = np.linalg.qr(np.random.default_rng(0).normal(size=(d, d)))[0]
        turn[:, 0] *= np.linalg.det(turn)
        turned = flow.displacement(Mesh(mesh.vertices @ turn.T, mesh.faces), 0.01, time=0.0)
        assert np.allclose(turned, here @ turn.T, atol=1e-9)


@pytest.mark.parametrize("name", FLOWS)
def test_the_order_of_vertices_and_faces_does_not_matter(name: str) -> None:
    mesh, shuffle = ball(3, 10), np.random.default_rng(0)
    place, order = shuffle.permutation(len(mesh.vertices)), shuffle.permutation(len(mesh.faces))
    flow = flow_in(name, 3)
    other = Mesh(mesh.vertices[place], np.argsort(place)[mesh.faces[order]])
    assert np.allclose(
        flow.displacement(other, 0.01, time=0.0), flow.displacement(mesh, 0.01, time=0.0)[place], atol=1e-9
    )


@pytest.mark.parametrize("mesh", DIRTY)
@pytest.mark.parametrize("name", [name for name in FLOWS if name != "volume preserving"])
def test_no_mesh_breaks_a_flow(name: str, mesh: str) -> None:
    body = DIRTY[mesh]
    flow = flow_in(name, body.vertices.shape[1])
    for dt in (1e-6, 1e-2, 1.0):
        displacement = flow.displacement(body, dt, time=0.0)
        assert displacement.shape == body.vertices.shape
        assert np.isfinite(displacement).all()
        assert np.abs(displacement).max() < 10 * max(body.box.size) + dt


@pytest.mark.parametrize("file", sorted(Path(flows.__file__).parent.glob("*.py")), ids=lambda file: file.stem)
def test_flows_see_no_fields(file: Path) -> None:
    sources = {node.module for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.ImportFrom)}
    assert not sources & {"levelflow.fields", "levelflow.networks", "levelflow.jets"}
