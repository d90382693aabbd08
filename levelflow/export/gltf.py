"""glTF in one binary file: a node for each frame, or one mesh with a morph target for each."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from levelflow._version import __version__
from levelflow.export.scene import Scene, Up, kept, origin
from levelflow.export.snapshots import Snapshot
from levelflow.rendering.colours import linear
from levelflow.rendering.shading import Clay
from levelflow.shapes.mesh import Mesh
from levelflow.shapes.writing import replace_file

_VERTICES, _INDICES = 34962, 34963
_FLOAT, _USHORT, _UINT = 5126, 5123, 5125


def write_glb(snapshots: Iterable[Snapshot], path: str | Path, *, scene: Scene = Scene()) -> None:  # noqa: B008
    """Writes surfaces of changing topology as GLB: a node for each, shown in its turn by an animation of its scale.

    A node stands at scale 0 until its time comes and again when it has gone, in steps; the last stays for one frame. A
    time at which the surface has vanished shows nothing. Programs that play no animation show the first surface. glTF
    is in metres with y up, so one node above all scales, turns and, if the origin is outside of the shapes, moves;
    below it the units are those of the field. The `extras` of each node hold its time.

    Args:
        snapshots: In the order of time.
        path: The file, which appears whole or not at all.
        scene: The axis that is up, the unit, and the frames per second.

    Raises:
        FileNotFoundError: If the folder does not exist.
        ValueError: If no snapshot holds a surface, or one is a curve in the plane.

    Reference:
        Khronos, glTF 2.0 specification, Sec. 3.5 and 3.11.
    """
    snapshots = list(snapshots)
    found = kept(snapshots, call="write_glb")
    buffer, center = _Buffer(), _hub(found)
    times = [snapshot.time for snapshot in snapshots]
    seconds = [frame / scene.fps for frame in scene.frames(times)]
    meshes: list[dict[str, Any]] = []
    nodes: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []
    for i, snapshot in enumerate(snapshots):
        if snapshot.mesh is None:
            continue
        name = f"t = {snapshot.time:g}"
        meshes.append({"name": name, "primitives": [_primitive(buffer, snapshot, snapshot.mesh, center)]})
        node = {"name": name, "mesh": len(meshes) - 1, "extras": {"time": snapshot.time}}
        if snapshot is not found[0]:
            node["scale"] = [0.0, 0.0, 0.0]
        nodes.append(node)
        if len(snapshots) < 2:
            continue
        keys = [(seconds[j], float(j == i)) for j in sorted({0, i, i + 1}) if j < len(snapshots)]
        if i == len(snapshots) - 1:
            keys.append((seconds[i] + 1 / scene.fps, 1.0))
        samplers.append(
            {
                "input": buffer.add(np.array([key for key, _ in keys]), "SCALAR", bounds=True),
                "output": buffer.add(np.repeat([[size] for _, size in keys], 3, axis=1), "VEC3"),
                "interpolation": "STEP",
            }
        )
        channels.append({"sampler": len(samplers) - 1, "target": {"node": len(nodes), "path": "scale"}})
    root = _root(scene, center, children=range(1, len(nodes) + 1))
    animations = [{"name": "evolution", "channels": channels, "samplers": samplers}] if channels else []
    painted = found[0].colours is not None
    _write(path, buffer, nodes=[root, *nodes], meshes=meshes, animations=animations, painted=painted)


def write_morph_glb(snapshots: Iterable[Snapshot], path: str | Path, *, scene: Scene = Scene()) -> None:  # noqa: B008
    """Writes one mesh carried along a flow as GLB, with a morph target for each time after the first.

    The animation goes from each time to the next on straight lines.

    Args:
        snapshots: In the order of time, all with the same faces: those of `track`.
        path: The file, which appears whole or not at all.
        scene: The axis that is up, the unit, and the frames per second.

    Raises:
        FileNotFoundError: If the folder does not exist.
        ValueError: If the snapshots have different faces, or no surface, or one is a curve in the plane.
    """
    snapshots = list(snapshots)
    found = kept(snapshots, call="write_morph_glb")
    first, rest = found[0], found[1:]
    assert first.mesh is not None
    if len(found) < len(snapshots) or not all(_has_faces_of(first.mesh, snapshot.mesh) for snapshot in rest):
        raise ValueError(
            "write_morph_glb: the faces of the snapshots differ, and morph targets share theirs; "
            "take the snapshots from `track`, or use `write_glb`."
        )
    buffer, center = _Buffer(), origin(found)
    _, copies = _split(first, first.mesh)
    primitive = _primitive(buffer, first, first.mesh, center)
    base_points, base_normals = _geometry(first.mesh, center)
    primitive["targets"] = []
    for snapshot in rest:
        assert snapshot.mesh is not None
        points, normals = _geometry(snapshot.mesh, center)
        primitive["targets"].append(
            {
                "POSITION": buffer.add((points - base_points)[copies], "VEC3", target=_VERTICES, bounds=True),
                "NORMAL": buffer.add((normals - base_normals)[copies], "VEC3", target=_VERTICES),
            }
        )
    times = [snapshot.time for snapshot in found]
    mesh: dict[str, Any] = {"name": "surface", "primitives": [primitive]}
    animations = []
    if rest:
        mesh["weights"] = [0.0] * len(rest)
        mesh["extras"] = {"targetNames": [f"t = {t:g}" for t in times[1:]]}
        seconds = np.array(scene.frames(times)) / scene.fps
        sampler = {
            "input": buffer.add(seconds, "SCALAR", bounds=True),
            "output": buffer.add(np.eye(len(times))[:, 1:].reshape(-1), "SCALAR"),
            "interpolation": "LINEAR",
        }
        channel = {"sampler": 0, "target": {"node": 1, "path": "weights"}}
        animations = [{"name": "evolution", "channels": [channel], "samplers": [sampler]}]
    else:
        del primitive["targets"]
    node = {"name": "surface", "mesh": 0, "extras": {"times": times}}
    root, painted = _root(scene, center, children=[1]), first.colours is not None
    _write(path, buffer, nodes=[root, node], meshes=[mesh], animations=animations, painted=painted)


class _Buffer:
    """The bytes of all arrays, and the accessors that say where they are and what."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(
        self, array: np.ndarray, kind: str, *, component: int = _FLOAT, target: int | None = None, bounds: bool = False
    ) -> int:
        """The number of the accessor of a new array: n numbers, or (n, c); with its range where glTF wants that."""
        array = array.astype({_FLOAT: "<f4", _USHORT: "<u2", _UINT: "<u4"}[component])
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes}
        self.views.append(view | ({"target": target} if target else {}))
        self.data += array.tobytes()
        self.data += bytes(-len(self.data) % 4)
        accessor = {
            "bufferView": len(self.views) - 1,
            "componentType": component,
            "count": len(array),
            "type": kind,
        }
        if component == _USHORT:
            accessor["normalized"] = True
        if bounds:
            rows = array.reshape(len(array), -1)
            accessor |= {"min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def _primitive(buffer: _Buffer, snapshot: Snapshot, mesh: Mesh, center: np.ndarray) -> dict[str, Any]:
    """Triangles with normals, and colours and texture coordinates where there are some."""
    corners, copies = _split(snapshot, mesh)
    points, normals = _geometry(mesh, center)
    attributes = {
        "POSITION": buffer.add(points[copies], "VEC3", target=_VERTICES, bounds=True),
        "NORMAL": buffer.add(normals[copies], "VEC3", target=_VERTICES),
    }
    if snapshot.colours is not None:
        light = snapshot.colours / 255
        light[:, :3] = linear(light[:, :3])
        colours = np.round(65535 * light)[copies]
        attributes["COLOR_0"] = buffer.add(colours, "VEC4", component=_USHORT, target=_VERTICES)
    if snapshot.uv is not None:
        uv = np.empty((len(copies), 2))
        uv[corners.reshape(-1)] = snapshot.uv.reshape(-1, 2)
        attributes["TEXCOORD_0"] = buffer.add(np.stack([uv[:, 0], 1 - uv[:, 1]], 1), "VEC2", target=_VERTICES)
    indices = buffer.add(corners.reshape(-1), "SCALAR", component=_UINT, target=_INDICES)
    return {"attributes": attributes, "indices": indices, "material": 0}


def _split(snapshot: Snapshot, mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Faces (m, 3) and, for each vertex that they name, the vertex of the mesh: one for each texture coordinate."""
    if snapshot.uv is None:
        return mesh.faces, np.arange(len(mesh.vertices))
    rows = np.concatenate([mesh.faces.reshape(-1, 1), snapshot.uv.reshape(-1, 2)], axis=1)
    kinds, corners = np.unique(rows, axis=0, return_inverse=True)
    return corners.reshape(mesh.faces.shape), kinds[:, 0].astype(np.int64)


def _geometry(mesh: Mesh, center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices around the center, and normals of length 1 whatever the mesh has."""
    normals = mesh.vertex_normals.astype(np.float32).astype(np.float64)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(length > 0.5, normals / length.clip(min=0.5), [0.0, 0.0, 1.0])
    return mesh.vertices - center, normals


def _hub(snapshots: Sequence[Snapshot]) -> np.ndarray:
    """Where nodes of scale zero are: at the origin if the shapes are around it, else in their middle.

    A program that frames what it shows would otherwise leave room up to the origin.
    """
    points = np.concatenate([snapshot.mesh.vertices for snapshot in snapshots if snapshot.mesh is not None])
    low, high = points.min(0), points.max(0)
    return np.zeros_like(low) if (low <= 0).all() and (high >= 0).all() else (low + high) / 2


def _has_faces_of(first: Mesh, other: Mesh | None) -> bool:
    return other is not None and np.array_equal(first.faces, other.faces)


def _root(scene: Scene, center: np.ndarray, *, children: Sequence[int]) -> dict[str, Any]:
    """The node that takes the units of the field to metres, and its up to y."""
    node: dict[str, Any] = {"name": "levelflow", "children": list(children)}
    placed = scene.metres_per_unit * center
    if scene.up is Up.Z:
        node["rotation"] = [-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]
        placed = placed[[0, 2, 1]] * [1, 1, -1]
    if scene.metres_per_unit != 1:
        node["scale"] = [scene.metres_per_unit] * 3
    if placed.any():
        node["translation"] = placed.tolist()
    return node


def _write(
    path: str | Path,
    buffer: _Buffer,
    *,
    nodes: list[dict[str, Any]],
    meshes: list[dict[str, Any]],
    animations: list[dict[str, Any]],
    painted: bool,
) -> None:
    colour = [1.0] * 3 if painted else linear(np.array(Clay().front)).round(6).tolist()
    matt = {"baseColorFactor": [*colour, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8}
    document = {
        "asset": {"version": "2.0", "generator": f"levelflow {__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "meshes": meshes,
        "materials": [{"name": "matt", "pbrMetallicRoughness": matt, "doubleSided": True}],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data)}],
    }
    if animations:
        document["animations"] = animations
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = [(b"JSON", text), (b"BIN\0", bytes(buffer.data))]
    size = 12 + sum(8 + len(data) for _, data in chunks)
    parts = [b"glTF", (2).to_bytes(4, "little"), size.to_bytes(4, "little")]
    for kind, data in chunks:
        parts += [len(data).to_bytes(4, "little"), kind, data]
    replace_file(Path(path), b"".join(parts))
