"""ParaView and VTK: one `.vtp` for each time, and the `.pvd` that says when each of them is."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from levelflow.export.ply import precision
from levelflow.export.sequences import Entry, write_sequence
from levelflow.export.snapshots import Snapshot
from levelflow.shapes.writing import replace_file

_TYPES = {"f4": "Float32", "f8": "Float64", "i8": "Int64", "u1": "UInt8"}


def write_pvd(
    snapshots: Iterable[Snapshot], path: str | Path, *, on_entry: Callable[[Entry], None] | None = None
) -> list[Entry]:
    """Writes `wave.pvd` with the real times, and `wave/wave_0000.vtp`, ... for ParaView and VTK.

    A collection names VTK's own XML files only, so the surfaces are `.vtp`, not PLY. A time at which the surface has
    vanished is left out of the collection: ParaView then shows the time before.

    Args:
        snapshots: In the order of time; each is written before the next is asked for.
        path: The `.pvd` file; the folder beside it is made if it is not there.
        on_entry: Called with each entry as soon as it is written, or skipped.

    Raises:
        FileNotFoundError: If there is no folder for the `.pvd`.

    Reference:
        Kitware, VTK XML file formats, and the ParaView wiki on its data format.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise FileNotFoundError(f"write_pvd: there is no folder {str(path.parent)!r} to write {path.name!r} in.")
    folder = path.with_suffix("")

    def write(snapshot: Snapshot, file: Path) -> None:
        folder.mkdir(exist_ok=True)
        write_vtp(snapshot, file)

    entries = write_sequence(snapshots, folder / f"{path.stem}.vtp", write, on_entry=on_entry)
    rows = [
        f'    <DataSet timestep="{entry.time!r}" part="0" file={quoteattr(f"{folder.name}/{entry.file.name}")}/>'
        for entry in entries
        if entry.file is not None
    ]
    lines = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">']
    lines += ["  <Collection>", *rows, "  </Collection>", "</VTKFile>", ""]
    replace_file(path, "\n".join(lines).encode())
    return entries


def write_vtp(snapshot: Snapshot, path: str | Path) -> None:
    """Writes a snapshot as VTK's XML polygonal data, with its normals, velocities, colours and time.

    A curve in the plane lies in z = 0. Texture coordinates belong to vertices here, and are left out: at a seam a
    vertex has several.

    Raises:
        FileNotFoundError: If the folder does not exist.
        ValueError: If the snapshot is empty.
    """
    mesh = snapshot.mesh
    if mesh is None:
        raise ValueError(f"write_vtp: the surface has vanished at t = {snapshot.time:g}; there is nothing to write.")
    n, m, d = len(mesh.vertices), *mesh.faces.shape
    points = _in_space(mesh.vertices).astype(precision(mesh))
    attributes = {"Normals": _in_space(mesh.vertex_normals).astype("<f4")}
    if snapshot.velocities is not None:
        attributes["velocity"] = _in_space(snapshot.velocities).astype("<f4")
    if snapshot.colours is not None:
        attributes["colours"] = snapshot.colours
    polygons = {"connectivity": mesh.faces.reshape(-1), "offsets": d * np.arange(1, m + 1)}
    kind, lines, polys = ("Polys", 0, m) if d == 3 else ("Lines", m, 0)
    text = [
        '<?xml version="1.0"?>',
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
        "<PolyData>",
        "<FieldData>",
        *_arrays({"TimeValue": np.array([snapshot.time])}, tuples=True),
        "</FieldData>",
        f'<Piece NumberOfPoints="{n}" NumberOfVerts="0" NumberOfLines="{lines}" NumberOfStrips="0" '
        f'NumberOfPolys="{polys}">',
        '<PointData Normals="Normals">',
        *_arrays(attributes),
        "</PointData>",
        "<Points>",
        *_arrays({"Points": points}),
        "</Points>",
        f"<{kind}>",
        *_arrays(polygons),
        f"</{kind}>",
        "</Piece>",
        "</PolyData>",
        "</VTKFile>",
        "",
    ]
    replace_file(Path(path), "\n".join(text).encode())


def _arrays(arrays: Mapping[str, np.ndarray], *, tuples: bool = False) -> list[str]:
    """Arrays in base64, the number of their bytes in front."""
    lines = []
    for name, array in arrays.items():
        array = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
        data = array.tobytes()
        coded = base64.b64encode(len(data).to_bytes(8, "little") + data).decode()
        width = array.shape[1] if array.ndim > 1 else 1
        size = f'NumberOfTuples="{len(array)}"' if tuples else f'NumberOfComponents="{width}"'
        kind = _TYPES[array.dtype.str[1:]]
        lines.append(f'<DataArray type="{kind}" Name="{name}" {size} format="binary">{coded}</DataArray>')
    return lines


def _in_space(vectors: np.ndarray) -> np.ndarray:
    """Vectors of the plane with a third component of zero."""
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))
