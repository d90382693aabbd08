"""The command that takes the surfaces of a field to other programs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from levelflow.cli.names import motion_in_words, place_in, times_in, walk_example, walk_in

if TYPE_CHECKING:
    from levelflow.export.painting import Paint
    from levelflow.export.scene import Scene
    from levelflow.export.sequences import Entry
    from levelflow.export.snapshots import Snapshot
    from levelflow.fields import Field

_WHOLE = ("glb", "pvd", "usd", "usda", "usdc")
_NUMBERED = ("ply", "stl", "npz", "mhd", "vdb")
_COLOURLESS = ("stl", "npz", "mhd", "vdb")


def export(
    field: Annotated[Path, typer.Argument(metavar="FIELD", help="A field (.safetensors).")],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="A file; its extension says the format. Or a folder."),
    ],
    times: Annotated[str | None, typer.Option(help="0,0.5,1 or first:last:number; for a field that moves.")] = None,
    time: Annotated[
        str | None, typer.Option("--time", help="A single time, or one number for each parameter: 0.5,0.2.")
    ] = None,
    walk: Annotated[
        str | None, typer.Option("--path", help="0,0:1,0:1,1, corners of a walk through the parameters of a field.")
    ] = None,
    frames: Annotated[int, typer.Option(help="How many on the way, with --path.")] = 25,
    kind: Annotated[
        str | None, typer.Option("--format", help=f"For a folder: {', '.join([*_NUMBERED, *_WHOLE])}.")
    ] = None,
    track: Annotated[
        bool, typer.Option("--track", help="Carry one mesh along the motion: the frames share their vertices.")
    ] = False,
    resolution: Annotated[int, typer.Option(help="Cells along the longest side of the box.")] = 128,
    refine: Annotated[int, typer.Option(help="Steps that move each vertex onto the surface itself.")] = 3,
    up: Annotated[str, typer.Option(help="The axis that points up, y or z (GLB, USD).")] = "y",
    metres_per_unit: Annotated[
        float | None, typer.Option(help="The length of a unit, by default 1 (GLB, USD); STL is then in millimetres.")
    ] = None,
    fps: Annotated[float, typer.Option(help="Frames per second of film (GLB, USD).")] = 24.0,
    colours: Annotated[
        Path | None, typer.Option(help="A mesh whose colours and texture coordinates the surfaces take.")
    ] = None,
    colours_time: Annotated[
        float | None, typer.Option(help="When that mesh is the surface; colours are then carried along the motion.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but warnings and errors.")] = False,
) -> None:
    """Write the surfaces of a field for other programs: PLY, ParaView, GLB, USD, OpenVDB, raw volumes, STL.

    A folder gets numbered PLY files and the .pvd that tells ParaView their times. USD needs the package usd-core:
    pip install usd-core. OpenVDB needs an interpreter that has its module: on Debian, apt install python3-openvdb and
    set LEVELFLOW_OPENVDB_PYTHON=/usr/bin/python3.
    """
    from levelflow.export.painting import Paint
    from levelflow.export.scene import Scene, Up
    from levelflow.export.snapshots import snapshots
    from levelflow.export.tracking import track as tracked
    from levelflow.saving import load

    path, formats = _target(field, output, kind)
    if resolution < 2:
        raise ValueError(f"--resolution {resolution}: give at least 2 cells.")
    if colours is not None and formats[0] in _COLOURLESS:
        raise ValueError(f"--colours {colours}: a .{formats[0]} file has no place for colours; write ply, glb or usd.")
    if colours is None and colours_time is not None:
        raise ValueError(f"--colours-time {colours_time:g}: name the mesh with the colours: --colours MESH.")
    if track and formats[0] in ("npz", "mhd", "vdb"):
        raise ValueError(f"--track: a .{formats[0]} file holds a grid, no mesh to carry along; leave --track out.")
    taken, wanted = _taken(f"export {field}", load(field), times, time, walk, frames)
    if track and not taken.times:
        raise ValueError(f"export {field} --track: nothing moves; leave --track out, or say when with --times.")
    if up.upper() not in Up.__members__:
        raise ValueError(f"--up {up}: give y or z.")
    scene = Scene(Up[up.upper()], 1.0 if metres_per_unit is None else metres_per_unit, fps)
    path.parent.mkdir(parents=True, exist_ok=True)
    if formats[0] in ("npz", "mhd"):
        entries = _write_volumes(taken, wanted, path, resolution=resolution, quiet=quiet)
    else:
        shown = (tracked if track else snapshots)(taken, wanted, resolution=resolution, refine=refine)
        if colours is not None:
            shown = _painted(shown, Paint.read(colours), taken, colours_time, track=track, formats=formats)
        if formats[0] == "vdb":
            entries = _write_level_sets(taken, shown, path, len(wanted), resolution=resolution, quiet=quiet)
        elif formats[0] in _NUMBERED:
            millimetres = 1.0 if metres_per_unit is None else 1000 * metres_per_unit
            entries = _write_meshes(shown, path, formats, len(wanted), millimetres=millimetres, quiet=quiet)
        else:
            entries = _write_whole(shown, path, scene, track=track, quiet=quiet)
    if not quiet:
        there = sum(entry.file is not None for entry in entries)
        gone = f", {len(entries) - there} vanished" if there < len(entries) else ""
        name = path.parent if len(entries) > 1 and formats[0] in _NUMBERED else path
        typer.echo(f"{name}: {there} {'frame' if there == 1 else 'frames'}{gone}")


def _taken(
    call: str, field: Field, times: str | None, time: str | None, walk: str | None, frames: int
) -> tuple[Field, list[float]]:
    """The field of at most one time that is written, and the times."""
    if sum(text is not None for text in (times, time, walk)) > 1:
        raise ValueError(f"{call}: give one of --times, --time and --path; each says when.")
    if walk is not None:
        if frames < 2:
            raise ValueError(f"{call} --frames {frames}: a walk has at least two frames.")
        return walk_in(walk, field, call), times_in(f"0:1:{frames}")
    if time is not None:
        return field.at(*place_in(time, field, call)), []
    if field.times > 1:
        raise ValueError(
            f"{call}: {motion_in_words(field)}; say how to walk through them, corner after corner, such as --path "
            f"{walk_example(field)}, or give one number for each with --time."
        )
    if field.times and times is None:
        raise ValueError(f"{call}: {motion_in_words(field)}; say when with --times.")
    if not field.times and times is not None:
        raise ValueError(f"{call}: the field does not depend on time; leave --times out.")
    return field, times_in(times) if times is not None else []


def _target(field: Path, output: Path, kind: str | None) -> tuple[Path, tuple[str, ...]]:
    """The file to write, before numbers, and its formats: those of its extension, or of a folder."""
    known = ", ".join([*_NUMBERED, *_WHOLE])
    suffix = output.suffix.lower().removeprefix(".")
    if kind is not None and kind not in (*_NUMBERED, *_WHOLE):
        raise ValueError(f"--format {kind}: known are {known}.")
    if suffix and not output.is_dir():
        if suffix not in (*_NUMBERED, *_WHOLE):
            raise ValueError(f"export -o {output}: .{suffix} is not a known format; known are {known}.")
        if kind not in (None, suffix):
            raise ValueError(f"--format {kind}: the extension of {output.name} says {suffix}; leave --format out.")
        return output, (suffix,)
    if output.is_file():
        raise ValueError(f"export -o {output}: this is a file; name a folder, or a file with an extension: {known}.")
    return output / f"{field.stem}.{kind or 'ply'}", (kind,) if kind else ("ply", "pvd")


def _painted(
    frames: Iterable[Snapshot],
    paint: Paint,
    field: Field,
    time: float | None,
    *,
    track: bool,
    formats: tuple[str, ...],
) -> Iterator[Snapshot]:
    """Snapshots in the colours of a mesh: carried along the motion where it is known when the mesh is the surface."""
    from levelflow.export.painting import painted, painted_once

    if formats == ("pvd",) and paint.colours is None:
        raise ValueError(
            f"--colours {paint.name}: it has texture coordinates only, and a .pvd file no place for them; "
            "write ply, glb or usd."
        )
    paint_all = painted_once if track else painted
    return paint_all(frames, paint) if time is None else paint_all(frames, paint, along=field, time=time)


def _write_volumes(field: Field, times: list[float], path: Path, *, resolution: int, quiet: bool) -> list[Entry]:
    """Raw volumes: the values of the field themselves."""
    from levelflow.export.sequences import write_sequence
    from levelflow.export.volumes import volumes, write_mhd, write_npz

    write = write_npz if path.suffix.lower() == ".npz" else write_mhd
    grids = volumes(field, times, resolution=resolution)
    return write_sequence(grids, path, write, alone=len(times) < 2, on_entry=_voice(quiet))


def _write_level_sets(
    field: Field, frames: Iterable[Snapshot], path: Path, number: int, *, resolution: int, quiet: bool
) -> list[Entry]:
    """OpenVDB files: distances to the surfaces."""
    from levelflow.export.sequences import write_sequence
    from levelflow.export.vdb import level_sets, write_vdb

    bands = level_sets(field, frames, resolution=resolution)
    return write_sequence(bands, path, write_vdb, alone=number < 2, on_entry=_voice(quiet))


def _write_meshes(
    frames: Iterable[Snapshot],
    path: Path,
    formats: tuple[str, ...],
    number: int,
    *,
    millimetres: float,
    quiet: bool,
) -> list[Entry]:
    """PLY or STL files, with the list of their times; for a folder the collection of ParaView as well."""
    from levelflow.export.paraview import write_pvd
    from levelflow.export.ply import write_ply
    from levelflow.export.printing import write_stl
    from levelflow.export.sequences import write_sequence, write_series

    def write(snapshot: Snapshot, file: Path) -> None:
        if formats[0] == "ply":
            write_ply(snapshot, file)
        elif snapshot.mesh is not None:
            write_stl(snapshot.mesh, file, millimetres_per_unit=millimetres)

    if "pvd" in formats:
        frames = list(frames)
    entries = write_sequence(frames, path, write, alone=number < 2, on_entry=_voice(quiet))
    if number > 1:
        write_series(entries, path)
    if "pvd" in formats:
        write_pvd(frames, path.with_suffix(".pvd"))
    return entries


def _write_whole(frames: Iterable[Snapshot], path: Path, scene: Scene, *, track: bool, quiet: bool) -> list[Entry]:
    """One file that holds all times."""
    from levelflow.export.gltf import write_glb, write_morph_glb
    from levelflow.export.paraview import write_pvd
    from levelflow.export.sequences import Entry
    from levelflow.export.usd import write_usd

    if path.suffix.lower() == ".pvd":
        return write_pvd(frames, path, on_entry=_voice(quiet))
    entries: list[Entry] = []

    def heard() -> Iterator[Snapshot]:
        for snapshot in frames:
            entries.append(Entry(snapshot.time, None if snapshot.is_empty else path))
            if not quiet:
                what = "the surface has vanished" if snapshot.mesh is None else f"{len(snapshot.mesh.faces):,} faces"
                typer.echo(f"  t = {snapshot.time:g}: {what}")
            yield snapshot

    if path.suffix.lower() == ".glb":
        (write_morph_glb if track else write_glb)(heard(), path, scene=scene)
    else:
        write_usd(heard(), path, scene=scene)
    return entries


def _voice(quiet: bool) -> Callable[[Entry], None]:
    """Says each file as soon as it is there."""

    def say(entry: Entry) -> None:
        if not quiet:
            gone = f"t = {entry.time:g}: the surface has vanished"
            typer.echo(f"  {gone if entry.file is None else f'{entry.file.name}: t = {entry.time:g}'}")

    return say
