"""Writing simplices to files that are either whole or not there."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

FORMATS = (".ply", ".obj", ".off", ".stl")


def write_contents(
    path: str | Path,
    vertices: Float[np.ndarray, "n d"],
    faces: Int[np.ndarray, "m d"],
    normals: Float[np.ndarray, "n d"] | None,
    *,
    call: str,
) -> None:
    """Writes segments or triangles in the format of the file's extension.

    The bytes go to a temporary file in the same folder, which then takes the place of `path` in one step; when
    anything fails, the temporary file is removed and an older file of the same name is untouched.

    Raises:
        FileNotFoundError: If the folder does not exist.
        ValueError: If the extension is not known, or the format cannot hold a curve in the plane.
    """
    path = Path(path)
    extension = path.suffix.lower()
    if extension not in FORMATS:
        raise ValueError(f"{call}: cannot write {path.name!r}; known extensions are {', '.join(FORMATS)}.")
    if vertices.shape[1] == 2 and extension in (".stl", ".off"):
        raise ValueError(f"{call}: {extension[1:].upper()} holds no curves in the plane; write a .ply or .obj file.")
    data = {".ply": _ply, ".obj": _obj, ".off": _off, ".stl": _stl}[extension](vertices, faces, normals)
    replace_file(path, data)


def replace_file(path: Path, data: bytes) -> None:
    """Puts the bytes in a file in one step.

    Raises:
        FileNotFoundError: If there is no folder for it.
    """
    if not path.parent.is_dir():
        raise FileNotFoundError(f"there is no folder {str(path.parent)!r} to write {path.name!r} in.")
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(temporary, 0o666 & ~mask)
        os.replace(temporary, path)
    except BaseException as error:
        os.unlink(temporary)
        if isinstance(error, OSError) and error.errno is not None and error.filename is None:
            error.filename = str(path)
        raise


def _ply(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray | None) -> bytes:
    """Binary PLY; float64 coordinates where float32 would lose a millionth of the size of the shape."""
    d = vertices.shape[1]
    extent = float(np.ptp(vertices, axis=0).max())
    real, word = ("<f8", "double") if np.abs(vertices).max() > 16 * extent else ("<f4", "float")
    names = [*"xyz"[:d], *([f"n{axis}" for axis in "xyz"[:d]] if normals is not None else [])]
    header = ["ply", "format binary_little_endian 1.0", "comment written by levelflow"]
    header += [f"element vertex {len(vertices)}", *(f"property {word} {name}" for name in names)]
    if d == 3:
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        rows = np.empty(len(faces), np.dtype([("size", "u1"), ("corners", "<i4", 3)]))
        rows["size"], rows["corners"] = 3, faces
        polygons = rows.tobytes()
    else:
        header += [f"element edge {len(faces)}", "property int vertex1", "property int vertex2"]
        polygons = faces.astype("<i4").tobytes()
    table = vertices if normals is None else np.concatenate([vertices, normals], 1)
    return "\n".join([*header, "end_header\n"]).encode() + table.astype(real).tobytes() + polygons


def _obj(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray | None) -> bytes:
    lines = ["# written by levelflow", *(f"v {' '.join(map(repr, row))}" for row in vertices.tolist())]
    if vertices.shape[1] == 2:
        lines = [f"{line} 0" if line[0] == "v" else line for line in lines]
        lines += [f"l {a} {b}" for a, b in (faces + 1).tolist()]
    elif normals is not None:
        lines += [f"vn {' '.join(map(repr, row))}" for row in normals.tolist()]
        lines += [f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in (faces + 1).tolist()]
    else:
        lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    return ("\n".join(lines) + "\n").encode()


def _off(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray | None) -> bytes:
    lines = ["OFF", f"{len(vertices)} {len(faces)} 0", *(" ".join(map(repr, row)) for row in vertices.tolist())]
    lines += [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
    return ("\n".join(lines) + "\n").encode()


def _stl(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray | None) -> bytes:
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    rows = np.zeros(len(faces), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]))
    rows["normal"] = np.divide(cross, length, out=np.zeros_like(cross), where=length > 0)
    rows["corners"] = corners
    return b"written by levelflow".ljust(80) + len(faces).to_bytes(4, "little") + rows.tobytes()
