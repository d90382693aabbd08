"""One mesh carried along with a moving surface, so that all its frames share vertices and faces."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from levelflow.export.normal_motion import carry
from levelflow.export.snapshots import Snapshot, check_times, on_surface
from levelflow.extraction import EmptyLevelSet, extract
from levelflow.fields import Field
from levelflow.shapes import simplices
from levelflow.shapes.distance import TriangleDistance
from levelflow.shapes.mesh import Mesh

# Farther than this many cells from the surface, a carried mesh has left a part of it uncovered.
_NEAR = 2.0
# The share of the area that may face the wrong way: slivers of marching cubes turn over easily.
_TURNED = 0.01


class TopologyChange(ValueError):
    """A mesh carried along with a surface did not arrive."""


def track(field: Field, times: Sequence[float], *, resolution: int = 128, refine: int = 3) -> Iterator[Snapshot]:
    """The surface of the first time, its vertices carried along the normal to the others.

    Vertices move with the normal velocity, which is all that a surface knows of its motion: under a rotation of a
    sphere they stand still, and where the surface grows the triangles grow with it. Those of a `Transported` field move
    as it does, tangentially as well. At each time the carried mesh is
    compared to the surface extracted afresh; it must have as many bodies and holes, cover it to within two cells, and
    face outward.

    Args:
        field: A field of space and one time.
        times: The times in increasing order, in the interval of the field.
        resolution: Cells along the longest side of the box, for the first surface and the comparisons.
        refine: Steps that move each vertex onto the surface itself.

    Raises:
        EmptyLevelSet: If there is no surface at the first time.
        TopologyChange: If the mesh does not arrive at one of the times.
        ValueError: If the field does not move, or the times are not its own, or not in order.
    """
    if not field.times:
        raise ValueError("track: the field does not depend on time, and nothing moves; leave the tracking out.")
    times = check_times(field, times, call="track")
    mesh = extract(field.at(times[0]), resolution=resolution, refine=refine)
    cell = max((field.box or mesh.box).size) / resolution
    yield on_surface(field, mesh, times[0])
    for before, t in zip(times, times[1:], strict=False):
        try:
            there = extract(field.at(t), resolution=resolution, refine=refine)
        except EmptyLevelSet:
            raise _lost(before, t, "the surface vanishes") from None
        carried = carry(field, mesh.vertices, before, t, step=2 * cell)
        if not carried.arrived.all():
            lost = int((~carried.arrived).sum())
            raise _lost(before, t, f"{lost} of {len(carried.arrived)} vertices lose the surface")
        mesh = Mesh(carried.points, mesh.faces, name=mesh.name)
        _compare(mesh, there, before, t, cell)
        snapshot = on_surface(field, mesh, t)
        _check_orientation(snapshot, before)
        yield snapshot


def _compare(mesh: Mesh, there: Mesh, before: float, t: float, cell: float) -> None:
    """Raises unless the carried mesh is the surface that is there, up to its sampling."""
    kinds = [(surface.components, _euler_number(surface)) for surface in (mesh, there)]
    if kinds[0] != kinds[1]:
        bodies = "; ".join(
            f"{name} has {components} bodies and Euler number {euler}"
            for name, (components, euler) in zip(("the mesh", "the surface"), kinds, strict=True)
        )
        raise _lost(before, t, f"the topology changes: {bodies}")
    gap = float(TriangleDistance(mesh.vertices, mesh.faces).closest(there.vertices).distance.max())
    if gap > _NEAR * cell:
        raise _lost(before, t, f"a part of the surface, {gap:.3g} away, is not covered by the mesh")


def _check_orientation(snapshot: Snapshot, before: float) -> None:
    mesh = snapshot.mesh
    assert mesh is not None and mesh.normals is not None
    vectors = simplices.area_vectors(mesh.vertices, mesh.faces)
    inward = (vectors * mesh.normals[mesh.faces].mean(1)).sum(1) < 0
    share = float(mesh.face_areas[inward].sum()) / mesh.area
    if share > _TURNED:
        raise _lost(before, snapshot.time, f"{100 * share:.2g} % of the mesh folds over")


def _euler_number(mesh: Mesh) -> int:
    """Vertices - edges + faces, without the vertices of no face; vertices - segments in the plane."""
    used = len(np.unique(mesh.faces))
    if mesh.faces.shape[1] == 2:
        return used - len(mesh.faces)
    return used - int(simplices.ridge_numbers(mesh.faces, len(mesh.vertices)).max() + 1) + len(mesh.faces)


def _lost(before: float, t: float, why: str) -> TopologyChange:
    return TopologyChange(
        f"track: the mesh does not arrive at t = {t:g}: between t = {before:g} and then, {why}. "
        "Ask for times before that, or export without tracking: each frame then has a mesh of its own."
    )
