"""What the files of meshes and points say, before anything is done to it: one reader per format."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Contents(NamedTuple):
    """The geometry in a file.

    Attributes:
        vertices: Positions as stored, one row each.
        corners: The vertex numbers of all polygons (or segments), one polygon after another.
        sizes: The number of corners of each polygon; 2 for a segment.
        normals: One normal per vertex where the file has them.
    """

    vertices: Float[np.ndarray, "n d"]
    corners: Int[np.ndarray, " c"]
    sizes: Int[np.ndarray, " p"]
    normals: Float[np.ndarray, "n d"] | None = None


def read_contents(path: str | Path, *, call: str, formats: tuple[str, ...]) -> Contents:
    """Reads the geometry of a file, chosen by its extension.

    Args:
        path: The file.
        call: The public call that asks, for messages: `Mesh.read`.
        formats: The extensions which that call accepts, in lower case with the dot.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is a folder, has another extension, or does not hold what its extension says.
    """
    path, data = _checked(path, call, formats)
    extension = path.suffix.lower()
    try:
        return _gltf(path) if extension in (".glb", ".gltf") else _READERS[extension](data)
    except _Malformed as error:
        raise ValueError(f"{call}: {path.name!r} is not a valid {extension[1:].upper()} file: {error}") from None


def read_ply(path: str | Path, *, call: str) -> dict[str, dict[str, np.ndarray]]:
    """Everything in a PLY file: its elements by name, each with its properties by name, such as `["vertex"]["red"]`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is a folder, has another extension, or is not a valid PLY file.
    """
    path, data = _checked(path, call, (".ply",))
    try:
        return _ply_columns(data)
    except _Malformed as error:
        raise ValueError(f"{call}: {path.name!r} is not a valid PLY file: {error}") from None


def read_vertex_properties(path: str | Path, *, call: str) -> tuple[Float[np.ndarray, "n d"], dict[str, np.ndarray]]:
    """The positions of the vertices of a PLY file, and every other property that they have, in its own type.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is a folder, has another extension, or is not a valid PLY file.
    """
    vertex = read_ply(path, call=call).get("vertex", {})
    try:
        axes = _axes(vertex)
    except _Malformed as error:
        raise ValueError(f"{call}: {Path(path).name!r} is not a valid PLY file: {error}") from None
    positions = np.stack([vertex[axis] for axis in axes], axis=1).astype(np.float64)
    return positions, {name: values for name, values in vertex.items() if name not in axes}


def _checked(path: str | Path, call: str, formats: tuple[str, ...]) -> tuple[Path, bytes]:
    """The contents of a file that is there, has one of the extensions and is not empty."""
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{call}: there is no file {str(path)!r} (looked in {Path.cwd()}).")
    if path.is_dir():
        raise ValueError(f"{call}: {str(path)!r} is a folder; give the path of a file in it.")
    if path.suffix.lower() not in formats:
        raise ValueError(
            f"{call}: {path.name!r} has the extension {path.suffix!r}; known are {', '.join(formats)}. "
            "Convert the file, or rename it if the extension is wrong."
        )
    data = path.read_bytes()
    if not data:
        raise ValueError(f"{call}: {path.name!r} is empty (0 bytes).")
    return path, data


class _Malformed(Exception):
    """A file does not hold what its extension says; the message completes `... is not a valid OBJ file:`."""


def _text(data: bytes) -> str:
    if b"\0" in data[:4096]:
        raise _Malformed("it holds binary data, not text.")
    return data.decode("utf-8", errors="replace")


def _numbers(rows: list[list[str]], what: str) -> Float[np.ndarray, "n c"]:
    """Equally long rows of words as numbers, or a complaint about the first row that is not."""
    width = len(rows[0])
    try:
        return np.array(rows, dtype=np.float64).reshape(len(rows), width)
    except ValueError:
        bad = next(i for i, row in enumerate(rows) if len(row) != width or not all(map(_is_number, row)))
        raise _Malformed(f"{what} {bad + 1} reads {' '.join(rows[bad])[:60]!r} where {width} numbers belong.") from None


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _polygons(rows: list[list[int]]) -> tuple[np.ndarray, np.ndarray]:
    sizes = np.fromiter(map(len, rows), dtype=np.int64, count=len(rows))
    return np.fromiter((i for row in rows for i in row), dtype=np.int64, count=int(sizes.sum())), sizes


def _obj(data: bytes) -> Contents:
    """Wavefront OBJ: positions, polygons and lines; texture coordinates, normals and materials are passed over."""
    positions: list[list[str]] = []
    faces: list[list[int]] = []
    lines: list[list[int]] = []
    for number, line in enumerate(_text(data).replace("\\\n", " ").splitlines(), 1):
        words = line.split()
        if not words:
            continue
        if words[0] == "v":
            positions.append(words[1:4])
        elif words[0] in ("f", "l"):
            try:
                row = [int(word.partition("/")[0]) for word in words[1:]]
            except ValueError:
                raise _Malformed(f"line {number} reads {line.strip()[:60]!r}, which names no vertices.") from None
            row = [i - 1 if i > 0 else i + len(positions) for i in row]
            if words[0] == "f":
                faces.append(row)
            else:
                lines.extend([a, b] for a, b in pairwise(row))
    if not positions:
        raise _Malformed("no line starts with 'v', so there is no vertex in it.")
    vertices = _numbers(positions, "vertex")
    if vertices.shape[1] < 2:
        raise _Malformed("its vertices have fewer than two coordinates.")
    return Contents(vertices, *_polygons(faces or lines))


def _off(data: bytes) -> Contents:
    """Object File Format in text, with or without colours, normals and texture coordinates."""
    lines = [words for line in _text(data).splitlines() if (words := line.partition("#")[0].split())]
    if not lines or not re.fullmatch(r"(ST)?C?N?4?OFF", lines[0][0]):
        raise _Malformed("the first line does not say OFF.")
    if lines[0][0].endswith("4OFF"):
        raise _Malformed("its vertices have four coordinates (4OFF).")
    lines[0] = lines[0][1:]
    lines = lines if lines[0] else lines[1:]
    try:
        n, m = int(lines[0][0]), int(lines[0][1])
    except (ValueError, IndexError):
        raise _Malformed("the numbers of vertices and faces are missing after OFF.") from None
    rows = lines[1 : 1 + n + m]
    if len(rows) < n + m:
        raise _Malformed(f"it announces {n} vertices and {m} faces and has {len(rows)} lines for them.")
    try:
        faces = [[int(word) for word in row[1 : 1 + int(row[0])]] for row in rows[n:]]
    except ValueError:
        raise _Malformed("a face names its vertices by something that is not a number.") from None
    vertices = _numbers([row[:3] for row in rows[:n]], "vertex") if n else np.empty((0, 3))
    return Contents(vertices, *_polygons(faces))


def _stl(data: bytes) -> Contents:
    """STL, binary or text: a soup of triangles."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else -1
    if count >= 0 and len(data) >= 84 + count * record.itemsize and (count or not data.startswith(b"solid")):
        soup = np.frombuffer(data, record, count, 84)["corners"].reshape(-1, 3)
    elif data.lstrip().startswith(b"solid"):
        rows = [line.split()[1:4] for line in _text(data).splitlines() if line.split()[:1] == ["vertex"]]
        soup = _numbers(rows, "vertex") if rows else np.empty((0, 3))
        if len(soup) % 3:
            raise _Malformed(f"it has {len(soup)} corners, not three per triangle; the file may be cut off.")
    else:
        raise _Malformed(
            f"it announces {max(count, 0)} triangles, {84 + max(count, 0) * record.itemsize} bytes, and "
            f"has {len(data)}."
        )
    vertices = soup.astype(np.float64)
    return Contents(vertices, np.arange(len(vertices)), np.full(len(vertices) // 3, 3))


_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


class _Property(NamedTuple):
    name: str
    kind: str
    length: str | None  # the type of the number in front of a list; None for a single value


def _ply(data: bytes) -> Contents:
    """Stanford PLY in text or binary; polygons of any size, segments as `edge`, normals as `nx ny nz`."""
    columns = _ply_columns(data)
    vertex = columns.get("vertex", {})
    axes = _axes(vertex)
    stack = [
        np.stack([vertex[prefix + axis] for axis in axes], 1).astype(np.float64)
        for prefix in ("", "n")
        if all(prefix + axis in vertex for axis in axes)
    ]
    corners, sizes = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    face, edge = columns.get("face", {}), columns.get("edge", {})
    key = next((k for k in ("vertex_indices", "vertex_index") if k in face), None)
    if key:
        corners, sizes = face[key].astype(np.int64), face[key + " sizes"].astype(np.int64)
    elif "vertex1" in edge and "vertex2" in edge:
        corners = np.stack([edge["vertex1"], edge["vertex2"]], 1).astype(np.int64).reshape(-1)
        sizes = np.full(len(corners) // 2, 2)
    return Contents(stack[0], corners, sizes, stack[1] if len(stack) > 1 else None)


def _axes(vertex: Mapping[str, np.ndarray]) -> list[str]:
    """The coordinates that the vertices of a PLY have."""
    axes = [axis for axis in "xyz" if axis in vertex]
    if len(axes) < 2:
        raise _Malformed("its header names no vertices with x, y and z.")
    return axes


def _ply_columns(data: bytes) -> dict[str, dict[str, np.ndarray]]:
    """The properties of each element of a PLY."""
    head, mark, body = data.partition(b"end_header")
    if not data.startswith(b"ply") or not mark:
        raise _Malformed("it has no header from 'ply' to 'end_header'.")
    body = body.partition(b"\n")[2]
    order, elements = _ply_header(head.decode("ascii", errors="replace"))
    words = body.split() if order is None else []
    columns: dict[str, dict[str, np.ndarray]] = {}
    at = 0
    for name, count, properties in elements:
        try:
            if order is None:
                columns[name], at = _ply_text(words, at, count, properties)
            else:
                columns[name], at = _ply_binary(body, at, count, properties, order)
        except (ValueError, IndexError):
            raise _Malformed(f"it ends, or goes wrong, within the {count} records of {name!r}.") from None
    return columns


def _ply_header(head: str) -> tuple[str | None, list[tuple[str, int, list[_Property]]]]:
    order: str | None = None
    elements: list[tuple[str, int, list[_Property]]] = []
    for line in head.splitlines():
        match line.split():
            case ["format", encoding, *_]:
                if encoding not in ("ascii", "binary_little_endian", "binary_big_endian"):
                    raise _Malformed(f"its format {encoding!r} is not known.")
                order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(encoding)
            case ["element", name, count] if count.isdigit():
                elements.append((name, int(count), []))
            case ["property", "list", length, kind, name] if elements and {length, kind} <= _PLY_TYPES.keys():
                elements[-1][2].append(_Property(name, _PLY_TYPES[kind], _PLY_TYPES[length]))
            case ["property", kind, name] if elements and kind in _PLY_TYPES:
                elements[-1][2].append(_Property(name, _PLY_TYPES[kind], None))
            case ["element" | "property", *_]:
                raise _Malformed(f"its header has the line {line.strip()[:60]!r}.")
    return order, elements


def _ply_text(words: list[bytes], at: int, count: int, properties: list[_Property]) -> tuple[dict, int]:
    if not any(p.length for p in properties):
        table = np.array(words[at : at + count * len(properties)], dtype=np.float64).reshape(count, len(properties))
        return {p.name: table[:, i] for i, p in enumerate(properties)}, at + count * len(properties)
    values: dict[str, list[float]] = {p.name + end: [] for p in properties for end in ("", " sizes")}
    for _ in range(count):
        for p in properties:
            length = int(words[at]) if p.length else 1
            at += 1 if p.length else 0
            values[p.name].extend(map(float, words[at : at + length]))
            values[p.name + " sizes"].append(length)
            if at + length > len(words):
                raise IndexError
            at += length
    return {name: np.array(column) for name, column in values.items()}, at


def _ply_binary(data: bytes, at: int, count: int, properties: list[_Property], order: str) -> tuple[dict, int]:
    """All records at once if their lists are as long as those of the first, else one by one."""

    def record(start: int) -> tuple[np.dtype, list[int]]:
        fields: list[tuple] = []
        lengths, end = [], start
        for i, p in enumerate(properties):
            length = 1
            if p.length:
                length = int(np.frombuffer(data, order + p.length, 1, end)[0])
                fields.append((f"{i} size", order + p.length))
            fields.append((f"{i}", order + p.kind, (length,)))
            end = start + np.dtype(fields).itemsize
            lengths.append(length)
        return np.dtype(fields), lengths

    if not count:
        return {p.name + end: np.empty(0) for p in properties for end in ("", " sizes")}, at
    kind, lengths = record(at)
    fits = len(data) >= at + count * kind.itemsize
    table = np.frombuffer(data, kind, count if fits else 1, at)
    if fits and all((table[f"{i} size"] == n).all() for i, n in enumerate(lengths) if properties[i].length):
        pieces, at = [table], at + count * kind.itemsize
    else:
        pieces = []
        for _ in range(count):
            kind, _lengths = record(at)
            pieces.append(np.frombuffer(data, kind, 1, at))
            at += kind.itemsize
    columns = {}
    for i, p in enumerate(properties):
        columns[p.name] = np.concatenate([piece[f"{i}"].reshape(-1) for piece in pieces])
        if p.length:
            columns[p.name + " sizes"] = np.concatenate([piece[f"{i} size"] for piece in pieces])
    return columns, at


def _gltf(path: Path) -> Contents:
    """glTF, binary or text: all meshes of the scene where their nodes put them; points and lines are passed over."""
    import trimesh

    try:
        scene = trimesh.load_scene(path, process=False)
    except Exception as error:
        raise _Malformed(f"the loader says {type(error).__name__}: {error}.") from None
    vertices, faces, n = [np.empty((0, 3))], [np.empty((0, 3), dtype=np.int64)], 0
    for node in scene.graph.nodes_geometry:
        matrix, geometry = scene.graph[node]
        body = scene.geometry[geometry]
        points = np.asarray(body.vertices, dtype=np.float64)
        vertices.append(points @ matrix[:3, :3].T + matrix[:3, 3])
        if isinstance(body, trimesh.Trimesh):
            mirrored = np.linalg.det(matrix[:3, :3]) < 0
            faces.append(np.asarray(body.faces, dtype=np.int64)[:, :: -1 if mirrored else 1] + n)
        n += len(points)
    triangles = np.concatenate(faces)
    return Contents(np.concatenate(vertices), triangles.reshape(-1), np.full(len(triangles), 3))


def _table(data: bytes) -> Contents:
    """Numbers in columns, separated by blanks, commas or semicolons, with at most one line of titles."""
    lines = [line.partition("#")[0] for line in _text(data).splitlines()]
    rows = [words for line in lines if (words := re.split(r"[\s,;]+", line.strip(" ,;\t"))) != [""]]
    if rows and not any(map(_is_number, rows[0])):
        rows = rows[1:]
    if not rows:
        raise _Malformed("there are no numbers in it.")
    return _columns(_numbers(rows, "row"))


def _npy(data: bytes) -> Contents:
    """A numpy array of points, one row each, with or without normals."""
    import io

    try:
        table = np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, EOFError) as error:
        raise _Malformed(f"{error}") from None
    if not isinstance(table, np.ndarray) or table.ndim != 2 or table.dtype.kind not in "fiu":
        shape = getattr(table, "shape", "of several arrays")
        raise _Malformed(f"an array of numbers of shape (n, 3) or (n, 6) is wanted, this one is {shape}.")
    return _columns(table.astype(np.float64))


def _columns(table: Float[np.ndarray, "n c"]) -> Contents:
    width = table.shape[1]
    if width not in (2, 3, 4, 6):
        raise _Malformed(
            f"its rows have {width} numbers; wanted are 3 (x y z) or 6 (with normals), in the plane 2 or 4."
        )
    d = width if width < 4 else width // 2
    nothing = np.empty(0, dtype=np.int64)
    return Contents(table[:, :d], nothing, nothing, table[:, d:] if width > 3 else None)


_READERS: dict[str, Callable[[bytes], Contents]] = {
    ".obj": _obj,
    ".off": _off,
    ".ply": _ply,
    ".stl": _stl,
    ".xyz": _table,
    ".txt": _table,
    ".csv": _table,
    ".npy": _npy,
}
