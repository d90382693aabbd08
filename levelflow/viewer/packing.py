"""Surfaces as bytes that the page reads without a parser: a header that says where the arrays are, and the arrays."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from levelflow.boxes import Frame
from levelflow.shapes import simplices
from levelflow.shapes.mesh import Mesh
from levelflow.viewer.viewed import Surface

MAGIC = b"LVF1"
# Half the width of the ribbon that stands for a curve in the plane, in units of half the box.
_HALF_WIDTH = 0.006
# The share of vertices beyond each end of the range of colours: a few spikes would otherwise take all of it.
_BEYOND = 0.02


def pack(surface: Surface, frame: Frame, *, compact: bool = False) -> bytes:
    """The bytes of a surface.

    They are `LVF1`, the length of the header as uint32, the header in JSON, and arrays, each at a multiple of four
    bytes, little-endian. The header has the `time`, the `note`, the `ranges` of the quantities, and for each of the
    `arrays` its `name`, `type`, `width` (numbers a row), `offset` from the end of the header and `count` (of rows).
    `position` is (x - center) / scale of the frame. `index` holds differences from the number before, which compress
    well.

    Args:
        surface: What to pack.
        frame: The similarity between the units of the shape and those of the page.
        compact: Whether positions have 16 bits, normals and quantities 8: value = lower + step * number. Positions
            are then within 1/131,070 of the size of the surface.
    """
    header: dict[str, Any] = {"time": list(surface.time), "note": surface.note, "ranges": {}, "arrays": []}
    blocks: list[bytes] = []

    def add(name: str, array: np.ndarray, **more: float) -> None:
        row = {"name": name, "type": array.dtype.name, "width": 1 if array.ndim == 1 else array.shape[1]}
        header["arrays"].append(row | {"offset": sum(map(len, blocks)), "count": len(array)} | more)
        data = array.astype(array.dtype.newbyteorder("<")).tobytes()
        blocks.append(data + bytes(-len(data) % 4))

    def add_real(name: str, array: np.ndarray, kind: type, lower: float, upper: float) -> None:
        if not compact:
            add(name, array.astype(np.float32))
            return
        step = (upper - lower) / np.iinfo(kind).max or 1.0
        add(name, np.round((array.clip(lower, upper) - lower) / step).astype(kind), lower=lower, step=step)

    if surface.mesh is not None:
        vertices, normals, faces, corners = _triangles(surface.mesh, frame)
        add_real("position", vertices, np.uint16, float(vertices.min()), float(vertices.max()))
        add_real("normal", normals, np.uint8, -1.0, 1.0)
        for name, values in surface.quantities.items():
            lower, upper = (float(v) for v in np.quantile(values, (_BEYOND, 1 - _BEYOND)))
            header["ranges"][name] = [lower, upper]
            add_real(name, values[corners], np.uint8, lower, upper)
        add("index", np.diff(faces.reshape(-1), prepend=0).astype(np.int32))
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    return b"".join([MAGIC, len(text).to_bytes(4, "little"), text, *blocks])


def unpack(data: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The header and the arrays of packed bytes, with numbers of few bits as values again and faces (m, 3).

    Raises:
        ValueError: If they are not bytes of `pack`, or cut off.
    """
    if data[:4] != MAGIC:
        raise ValueError(f"unpack: the bytes start with {data[:4]!r}, not with {MAGIC!r}; give those of `pack`.")
    start = 8 + int.from_bytes(data[4:8], "little")
    arrays = {}
    try:
        header = json.loads(data[8:start])
        for row in header["arrays"]:
            count = row["count"] * row["width"]
            array = np.frombuffer(data, np.dtype(row["type"]).newbyteorder("<"), count, start + row["offset"])
            if "step" in row:
                array = row["lower"] + row["step"] * array.astype(np.float64)
            arrays[row["name"]] = array if row["width"] == 1 else array.reshape(-1, row["width"])
    except ValueError as error:
        raise ValueError(f"unpack: the {len(data)} bytes are cut off ({error}); pack the surface again.") from None
    if "index" in arrays:
        arrays["index"] = np.cumsum(arrays["index"]).reshape(-1, 3)
    return header, arrays


def _triangles(mesh: Mesh, frame: Frame) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Vertices in the units of the page, normals, triangles, and for each vertex the vertex of the mesh."""
    vertices = (mesh.vertices - np.array(frame.center)) / frame.scale
    if mesh.vertices.shape[1] == 3:
        return vertices, mesh.vertex_normals, mesh.faces, np.arange(len(vertices))
    corners = mesh.faces.repeat(2, axis=1)
    across = simplices.unit(simplices.area_vectors(vertices, mesh.faces))[:, None] * _HALF_WIDTH
    sides = vertices[corners] + across * np.array([1, -1, 1, -1])[:, None]
    ribbon = np.pad(sides.reshape(-1, 2), ((0, 0), (0, 1)))
    faces = np.array([[0, 1, 2], [2, 1, 3]]) + 4 * np.arange(len(mesh.faces))[:, None, None]
    return ribbon, np.broadcast_to([0.0, 0.0, 1.0], ribbon.shape), faces.reshape(-1, 3), corners.reshape(-1)
