"""Universal Scene Description: one mesh whose points, faces, normals and velocities are samples in time."""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from levelflow.export.scene import Scene, kept, origin
from levelflow.export.snapshots import Snapshot
from levelflow.rendering.shading import linear
from levelflow.shapes.mesh import Mesh
from levelflow.shapes.writing import replace_file

FORMATS = (".usd", ".usda", ".usdc")


def write_usd(snapshots: Iterable[Snapshot], path: str | Path, *, scene: Scene = Scene()) -> None:  # noqa: B008
    """Writes surfaces as one USD mesh, `/surface/mesh`, whose topology may change from sample to sample.

    Time codes are frames: 0 at the first time, n - 1 at the last. The attribute `levelflow:time` of the mesh holds the
    time of the field at each. Velocities are in units per second of film, as motion blur wants them, and only their
    part along the normal is known. The subdivision scheme is none. Where all snapshots share their faces, these are
    written once. A surface that has vanished is a mesh without points.

    Args:
        snapshots: In the order of time.
        path: The file, `.usda` for text, `.usdc` or `.usd` for binary; it appears whole or not at all.
        scene: The axis that is up, the unit, and the frames per second.

    Raises:
        FileNotFoundError: If the folder does not exist.
        ModuleNotFoundError: If the package usd-core is not installed.
        ValueError: If no snapshot holds a surface, one is a curve in the plane, or the extension is not known.

    Reference:
        Pixar, USD documentation: UsdGeomMesh, UsdGeomPointBased.
    """
    usd, geom, sdf, vt, gf = _modules()
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise ValueError(f"write_usd: cannot write {path.name!r}; known extensions are {', '.join(FORMATS)}.")
    snapshots = list(snapshots)
    found = kept(snapshots, call="write_usd")
    center, times = origin(found), [snapshot.time for snapshot in snapshots]
    frames, pace = scene.frames(times), 1 / scene.seconds_per_time(times)

    layer = sdf.Layer.CreateAnonymous(".usda")
    stage = usd.Stage.Open(layer)
    geom.SetStageUpAxis(stage, scene.up.value)
    geom.SetStageMetersPerUnit(stage, scene.metres_per_unit)
    stage.SetTimeCodesPerSecond(scene.fps)
    stage.SetFramesPerSecond(scene.fps)
    stage.SetStartTimeCode(frames[0])
    stage.SetEndTimeCode(frames[-1])
    root = geom.Xform.Define(stage, "/surface")
    stage.SetDefaultPrim(root.GetPrim())
    if center.any():
        root.AddTranslateOp().Set(gf.Vec3d(*center.tolist()))
    mesh = geom.Mesh.Define(stage, "/surface/mesh")
    mesh.CreateSubdivisionSchemeAttr(geom.Tokens.none)
    mesh.CreateOrientationAttr(geom.Tokens.rightHanded)
    mesh.SetNormalsInterpolation(geom.Tokens.vertex)
    clock = mesh.GetPrim().CreateAttribute("levelflow:time", sdf.ValueTypeNames.Double, custom=True)
    primvars = geom.PrimvarsAPI(mesh)
    colours, opacity, uv = (
        primvars.CreatePrimvar(name, kind, interpolation) if present else None
        for name, kind, interpolation, present in (
            ("displayColor", sdf.ValueTypeNames.Color3fArray, geom.Tokens.vertex, found[0].colours is not None),
            ("displayOpacity", sdf.ValueTypeNames.FloatArray, geom.Tokens.vertex, found[0].colours is not None),
            ("st", sdf.ValueTypeNames.TexCoord2fArray, geom.Tokens.faceVarying, found[0].uv is not None),
        )
    )
    constant = len(found) == len(snapshots) and all(_shares_faces(found[0], snapshot) for snapshot in found)
    for frame, snapshot in zip(frames, snapshots, strict=True):
        surface = snapshot.mesh
        points, normals, faces, velocities = _arrays(snapshot, center, pace)
        clock.Set(snapshot.time, frame)
        mesh.GetPointsAttr().Set(vt.Vec3fArray.FromNumpy(points), frame)
        mesh.GetNormalsAttr().Set(vt.Vec3fArray.FromNumpy(normals), frame)
        if not constant or snapshot is snapshots[0]:
            when = usd.TimeCode.Default() if constant else frame
            mesh.GetFaceVertexCountsAttr().Set(vt.IntArray(len(faces), 3), when)
            mesh.GetFaceVertexIndicesAttr().Set(vt.IntArray.FromNumpy(faces.reshape(-1)), when)
        if any(other.velocities is not None for other in found):
            mesh.GetVelocitiesAttr().Set(vt.Vec3fArray.FromNumpy(velocities), frame)
        corners = [points.min(0), points.max(0)] if surface is not None else np.zeros((2, 3))
        mesh.GetExtentAttr().Set(vt.Vec3fArray.FromNumpy(np.array(corners, np.float32)), frame)
        if colours is not None and opacity is not None:
            painted = np.empty((0, 4)) if snapshot.colours is None else snapshot.colours / 255
            colours.Set(vt.Vec3fArray.FromNumpy(linear(painted[:, :3]).astype(np.float32)), frame)
            opacity.Set(vt.FloatArray.FromNumpy(painted[:, 3].astype(np.float32)), frame)
        if uv is not None:
            corner = np.empty((0, 2)) if snapshot.uv is None else snapshot.uv.reshape(-1, 2)
            uv.Set(vt.Vec2fArray.FromNumpy(corner.astype(np.float32)), frame)
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / path.with_suffix(path.suffix.lower()).name
        layer.Export(str(written))
        replace_file(path, written.read_bytes())


def _modules() -> tuple[Any, ...]:
    """Usd, UsdGeom, Sdf, Vt and Gf, or the sentence that says how to get them."""
    try:
        return tuple(importlib.import_module(f"pxr.{name}") for name in ("Usd", "UsdGeom", "Sdf", "Vt", "Gf"))
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            "write_usd: USD files need the package usd-core; install it with: pip install 'levelflow[usd]'"
        ) from None


def _arrays(snapshot: Snapshot, center: np.ndarray, pace: float) -> tuple[np.ndarray, ...]:
    """Points, normals, faces and velocities as USD stores them; empty where the surface has vanished."""
    mesh: Mesh | None = snapshot.mesh
    if mesh is None:
        nothing = np.empty((0, 3), np.float32)
        return nothing, nothing, np.empty((0, 3), np.int32), nothing
    velocities = np.zeros_like(mesh.vertices) if snapshot.velocities is None else snapshot.velocities * pace
    points, normals, velocities = (
        array.astype(np.float32) for array in (mesh.vertices - center, mesh.vertex_normals, velocities)
    )
    return points, normals, mesh.faces.astype(np.int32), velocities


def _shares_faces(first: Snapshot, other: Snapshot) -> bool:
    return first.mesh is not None and other.mesh is not None and np.array_equal(first.mesh.faces, other.mesh.faces)
