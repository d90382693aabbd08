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
from levelflow.rendering.colours import linear
from levelflow.shapes.writing import replace_file

FORMATS = (".usd", ".usda", ".usdc")
_TYPES = {
    ("f4", (3,)): "Vec3fArray",
    ("f4", (2,)): "Vec2fArray",
    ("f4", ()): "FloatArray",
    ("i4", ()): "IntArray",
}


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
    if found[0].colours is not None:
        primvars.CreatePrimvar("displayColor", sdf.ValueTypeNames.Color3fArray, geom.Tokens.vertex)
        primvars.CreatePrimvar("displayOpacity", sdf.ValueTypeNames.FloatArray, geom.Tokens.vertex)
    if found[0].uv is not None:
        primvars.CreatePrimvar("st", sdf.ValueTypeNames.TexCoord2fArray, geom.Tokens.faceVarying)
    constant = len(found) == len(snapshots) and all(_shares_faces(found[0], snapshot) for snapshot in found)
    for frame, snapshot in zip(frames, snapshots, strict=True):
        clock.Set(snapshot.time, frame)
        for name, array in _arrays(snapshot, found[0], center, pace).items():
            once = constant and name in ("faceVertexCounts", "faceVertexIndices")
            if not once or snapshot is snapshots[0]:
                values = getattr(vt, _TYPES[array.dtype.str[1:], array.shape[1:]]).FromNumpy(array)
                mesh.GetPrim().GetAttribute(name).Set(values, usd.TimeCode.Default() if once else frame)
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


def _arrays(snapshot: Snapshot, first: Snapshot, center: np.ndarray, pace: float) -> dict[str, np.ndarray]:
    """What a snapshot gives to the attributes of the mesh that `first` has; empty where the surface has vanished."""
    mesh, nothing = snapshot.mesh, np.empty((0, 3))
    points = nothing if mesh is None else mesh.vertices - center
    faces = np.empty((0, 3), np.int32) if mesh is None else mesh.faces.astype(np.int32)
    arrays = {
        "points": points,
        "normals": nothing if mesh is None else mesh.vertex_normals,
        "extent": np.zeros((2, 3)) if mesh is None else np.stack([points.min(0), points.max(0)]),
    }
    if first.velocities is not None:
        arrays["velocities"] = nothing if snapshot.velocities is None else snapshot.velocities * pace
    if first.colours is not None:
        colours = np.empty((0, 4)) if snapshot.colours is None else snapshot.colours / 255
        arrays |= {"primvars:displayColor": linear(colours[:, :3]), "primvars:displayOpacity": colours[:, 3]}
    if first.uv is not None:
        arrays["primvars:st"] = np.empty((0, 2)) if snapshot.uv is None else snapshot.uv.reshape(-1, 2)
    indices = {"faceVertexCounts": np.full(len(faces), 3, np.int32), "faceVertexIndices": faces.reshape(-1)}
    return {name: array.astype(np.float32) for name, array in arrays.items()} | indices


def _shares_faces(first: Snapshot, other: Snapshot) -> bool:
    return first.mesh is not None and other.mesh is not None and np.array_equal(first.mesh.faces, other.mesh.faces)
