"""OpenVDB level sets, written by the OpenVDB module of this interpreter or of another one."""

from __future__ import annotations

import hashlib
import inspect
import os
import re
import subprocess
import sys
import tempfile
import uuid
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int32

from levelflow.export.snapshots import Snapshot
from levelflow.export.volumes import Grid, values_at
from levelflow.fields import Field
from levelflow.shapes.distance import TriangleDistance
from levelflow.shapes.writing import replace_file

HALF_WIDTH = 3
"""The half width of the narrow band in voxels, which is what OpenVDB's own tools expect."""
INTERPRETER = "LEVELFLOW_OPENVDB_PYTHON"
"""The environment variable that names a Python interpreter with an OpenVDB module."""


@dataclass(frozen=True, eq=False)
class LevelSet:
    """The signed distance to a surface at the points of a grid near it.

    Attributes:
        time: When.
        index: The grid indices of the band.
        values: The distances there, negative inside, all less than `HALF_WIDTH` spacings.
        grid: Where the points are.
    """

    time: float
    index: Int32[np.ndarray, "n 3"]
    values: Float32[np.ndarray, " n"]
    grid: Grid

    @property
    def is_empty(self) -> bool:
        """Whether the surface has vanished."""
        return not len(self.index)


def level_sets(field: Field, snapshots: Iterable[Snapshot], *, resolution: int = 128) -> Iterator[LevelSet]:
    """Narrow bands around the surfaces of a field: distances to the triangles with the sign of the field.

    The values of a field are no distances where |grad f| is not 1; a level set grid is to hold those.

    Args:
        field: The field that the snapshots are of, with a box.
        snapshots: Its surfaces.
        resolution: Voxels along the longest side of the box.

    Raises:
        ValueError: If the field has no box, or a surface is a curve in the plane or not watertight.
    """
    if field.box is None:
        raise ValueError("level_sets(f): the field has no box of its own, and nothing says where the grid is to be.")
    grid = Grid.over(field.box, resolution=resolution)
    for snapshot in snapshots:
        yield _band(field, snapshot, grid)


def write_vdb(level_set: LevelSet, path: str | Path, *, python: str | None = None) -> None:
    """Writes an OpenVDB file with one float grid of the class level set, named `surface`.

    The module of OpenVDB is seldom in the same environment as PyTorch: Debian's `python3-openvdb` belongs to
    `/usr/bin/python3` and to its older numpy. So another interpreter does the writing: it needs numpy and `openvdb`
    (or `pyopenvdb`), and nothing of levelflow. The same level set gives the same bytes.

    Args:
        level_set: The band.
        path: The file, which appears whole or not at all.
        python: The interpreter; by default that of the environment variable LEVELFLOW_OPENVDB_PYTHON, or this one.

    Raises:
        FileNotFoundError: If the folder does not exist.
        ModuleNotFoundError: If the interpreter has no OpenVDB, or is not there.
        RuntimeError: If OpenVDB fails.
        ValueError: If the level set is empty.
    """
    path = Path(path)
    if level_set.is_empty:
        raise ValueError(f"write_vdb: the surface has vanished at t = {level_set.time:g}; there is nothing to write.")
    python = python or os.environ.get(INTERPRETER) or sys.executable
    with tempfile.TemporaryDirectory() as folder:
        np.savez(
            Path(folder) / "band.npz",
            index=level_set.index,
            values=level_set.values,
            lower=np.array(level_set.grid.lower),
            spacing=np.array(level_set.grid.spacing),
            background=np.array(HALF_WIDTH * level_set.grid.spacing),
            time=np.array(level_set.time),
        )
        program = f"{inspect.getsource(_convert)}\n_convert()\n"
        try:
            done = subprocess.run([python, "-c", program], cwd=folder, capture_output=True, text=True, check=False)
        except OSError as error:
            raise ModuleNotFoundError(
                f"write_vdb: the interpreter {python!r} does not run ({error.strerror}); set {INTERPRETER} to one that "
                "has OpenVDB, such as /usr/bin/python3."
            ) from None
        if "ModuleNotFoundError" in done.stderr:
            raise ModuleNotFoundError(
                f"write_vdb: {python} has no module openvdb. Install one (on Debian: apt install python3-openvdb) and "
                f"name its interpreter: {INTERPRETER}=/usr/bin/python3. Raw volumes (.npz, .mhd) need none."
            )
        if done.returncode:
            last = (done.stderr.strip() or f"exit code {done.returncode}").splitlines()[-1]
            raise RuntimeError(f"write_vdb: OpenVDB in {python} failed: {last}")
        data = (Path(folder) / "band.vdb").read_bytes()
    replace_file(path, _renamed(data))


def _convert() -> None:
    """Makes `band.vdb` of `band.npz`, in the interpreter that has OpenVDB."""
    import numpy

    try:
        import openvdb
    except ModuleNotFoundError:
        import pyopenvdb as openvdb

    band = numpy.load("band.npz")
    grid = openvdb.FloatGrid(float(band["background"]))
    accessor = grid.getAccessor()
    for index, value in zip(band["index"].tolist(), band["values"].tolist(), strict=True):
        accessor.setValueOn(tuple(index), value)
    grid.signedFloodFill()
    grid.transform = openvdb.createLinearTransform(voxelSize=float(band["spacing"]))
    grid.transform.translate(tuple(band["lower"].tolist()))
    grid.gridClass = openvdb.GridClass.LEVEL_SET
    grid.name = "surface"
    grid["time"] = float(band["time"])
    openvdb.write("band.vdb", grids=[grid])


def _renamed(data: bytes) -> bytes:
    """The file under a name made of its content: OpenVDB gives each a random one."""
    name = re.search(rb"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}", data[:128])
    if name is None:
        return data
    head, rest = data[: name.start()], data[name.end() :]
    digest = hashlib.sha256(head + rest).digest()
    return head + str(uuid.UUID(bytes=digest[:16])).encode() + rest


def _band(field: Field, snapshot: Snapshot, grid: Grid) -> LevelSet:
    from scipy.ndimage import binary_dilation

    mesh = snapshot.mesh
    if mesh is None:
        return LevelSet(snapshot.time, np.empty((0, 3), np.int32), np.empty(0, np.float32), grid)
    if mesh.faces.shape[1] != 3 or not mesh.is_watertight:
        what = "is a curve in the plane" if mesh.faces.shape[1] != 3 else "is not watertight: it leaves the box"
        raise ValueError(
            f"level_sets: the surface at t = {snapshot.time:g} {what}, and has no level set grid; "
            "write raw volumes (.npz, .mhd)."
        )
    # Room for the band around a surface that comes near the box.
    room = HALF_WIDTH + 1
    near = np.zeros(np.array(grid.counts) + 2 * room, dtype=bool)
    cells = np.floor((mesh.vertices - grid.lower) / grid.spacing).astype(np.int64) + room
    near[tuple(cells.T)] = True
    cube = np.ones((3, 3, 3), dtype=bool)
    index = np.argwhere(binary_dilation(near, cube, iterations=room)) - room
    points = grid.points(index)
    distance = TriangleDistance(mesh.vertices, mesh.faces).closest(points).distance
    # Less than the background after rounding to float32 as well.
    inside_band = distance < (HALF_WIDTH - 1e-5) * grid.spacing
    sign = np.where(values_at(field, points[inside_band], snapshot.time) < 0, -1.0, 1.0)
    values = (sign * distance[inside_band]).astype(np.float32)
    return LevelSet(snapshot.time, index[inside_band].astype(np.int32), values, grid)
