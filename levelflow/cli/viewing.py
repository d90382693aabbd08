"""The command that shows fields and meshes in a browser."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from levelflow.cli.names import key_named, place_in, times_in, walk_in
from levelflow.cli.running import folder_for

if TYPE_CHECKING:
    from levelflow.viewer.editing import Editing
    from levelflow.viewer.viewed import Viewed

# Cells of the surface that handles take hold of on the page: a second for an edit in eight steps.
_CELLS = 64


def view(
    fields: Annotated[
        list[str], typer.Argument(metavar="FIELD|MESH...", help="Fields (.safetensors) and meshes, side by side.")
    ],
    port: Annotated[int, typer.Option(help="The port of the page; 0 takes a free one.")] = 0,
    browse: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in the browser.")] = True,
    resolution: Annotated[
        int | None, typer.Option(help="Cells along the longest side of the box; 128, or 64 with --html.")
    ] = None,
    preview: Annotated[int, typer.Option(help="The same while a finer surface is on its way.")] = 64,
    html: Annotated[
        Path | None, typer.Option(help="Write the page with its frames to a file that needs no server instead.")
    ] = None,
    times: Annotated[str | None, typer.Option(help="With --html: 0,0.5,1 or first:last:number.")] = None,
    path: Annotated[
        str | None, typer.Option("--path", help="0,0:1,0:1,1, corners of a walk through the parameters of a field.")
    ] = None,
    handles: Annotated[
        Path | None,
        typer.Option(help="A JSON file of handles to be placed and dragged on the page, there already or not."),
    ] = None,
    time: Annotated[
        str | None, typer.Option("--time", help="With --handles: when, for a field that moves: 0.5, or 0.5,0.2.")
    ] = None,
) -> None:
    """Look at fields and meshes in the browser: each time or parameter on a slider, colours, cuts, distances.

    The page is served on this machine only, and nothing on it comes from elsewhere. Ctrl-C ends it. Keys on the page:
    space plays, arrows step, R resets the camera, M measures. With --handles a click on the surface places a handle for
    levelflow edit: G moves it, R turns it, S scales it, F holds it, Delete removes it, Ctrl-Z undoes, Ctrl-S saves.
    """
    if times is not None and html is None:
        raise ValueError(f"--times {times}: the page in the browser has a slider; name a file with --html as well.")
    if time is not None and handles is None:
        raise ValueError(f"--time {time}: the page in the browser has a slider; name a file with --handles as well.")
    if handles is not None and (len(fields) > 1 or path is not None):
        raise ValueError(f"view --handles {handles}: handles are placed on one surface; give one shape, and no --path.")
    viewed = [_viewed(text, path) for text in fields]
    editing = None
    if handles is not None:
        viewed, editing = _edited(fields[0], viewed[0], handles, time)
    if path is not None and not any(one.box.times for one in viewed):
        raise ValueError(f"view --path {path}: nothing of what is given moves; leave --path out.")
    if html is not None:
        _write(viewed, html, times, resolution=resolution if resolution is not None else 64, editing=editing)
    else:
        resolution = resolution if resolution is not None else 128
        _serve(viewed, port, resolution=resolution, preview=min(preview, resolution), browse=browse, editing=editing)


def _viewed(text: str, walk: str | None) -> Viewed:
    """The field or the mesh that an argument names; a field that moves may be walked through."""
    from levelflow.extraction import extract
    from levelflow.fields import Field
    from levelflow.saving import load
    from levelflow.shapes import Mesh, Solid
    from levelflow.viewer.viewed import ViewedField, ViewedMesh

    path = Path(text)
    key = load(path) if path.suffix.lower() == ".safetensors" else key_named(text)
    if isinstance(key, Field):
        name = path.parent.resolve().name if path.stem == "field" else path.name
        return ViewedField(walk_in(walk, key, f"view {text}") if walk and key.times else key, name=name)
    if not isinstance(key, Solid):
        raise ValueError(f"view {text}: a point cloud has no surface; fit a field first: levelflow fit {text} -o ...")
    if not isinstance(key, Mesh):
        key = extract(key.distance, box=key.box.expanded(0.05 * max(key.box.size)))
    return ViewedMesh(key, name=path.name)


def _edited(text: str, viewed: Viewed, file: Path, time: str | None) -> tuple[list[Viewed], Editing]:
    """What stands still of something that is viewed, and the handles on it."""
    import shlex

    from levelflow.extraction import extract
    from levelflow.viewer.editing import Editing
    from levelflow.viewer.viewed import ViewedField, ViewedMesh

    command = ["levelflow", "edit", text, "--handles", str(file)]
    if isinstance(viewed, ViewedField):
        place = place_in(time, viewed.field, f"view {text} --handles {file}")
        field = viewed.field.at(*place) if place else viewed.field
        viewed, surface = ViewedField(field, name=viewed.name), extract(field, resolution=_CELLS, refine=2)
        command += ["--time", time] if time is not None else []
    else:
        assert isinstance(viewed, ViewedMesh)
        if time is not None:
            raise ValueError(f"view {text} --time {time}: a mesh stands still; leave --time out.")
        surface = extract(viewed.mesh.distance, box=viewed.box, resolution=_CELLS)
    command += ["-o", str(folder_for([text], "edit"))]
    return [viewed], Editing(surface, file, command=shlex.join(command))


def _serve(
    viewed: Sequence[Viewed], port: int, *, resolution: int, preview: int, browse: bool, editing: Editing | None
) -> None:
    import os
    import webbrowser

    import torch

    from levelflow.viewer.server import Server

    if not 0 <= port <= 65535:
        raise ValueError(f"--port {port}: give a number from 0 to 65535; 0 takes a free port.")
    # Half of the machine is left to the browser and to the other surfaces; threads that wait for each other stutter.
    torch.set_num_threads(min(torch.get_num_threads(), max(1, (os.cpu_count() or 2) // 2)))
    server = Server(viewed, port=port, resolution=resolution, preview=preview, editing=editing)
    try:
        server.check_surface()
        typer.echo(f"{server.url} (Ctrl-C ends it)")
        if browse and not webbrowser.open(server.url):
            typer.echo("no browser was found; open the address above.", err=True)
        server.serve_forever()
    except KeyboardInterrupt:
        typer.echo("")
    finally:
        server.server_close()


def _write(
    viewed: Sequence[Viewed], path: Path, times: str | None, *, resolution: int, editing: Editing | None
) -> None:
    from levelflow.shapes.writing import replace_file
    from levelflow.viewer.page import sliders, standalone

    moving = [one for one in viewed if one.box.times]
    if times is not None and not moving:
        raise ValueError(f"--times {times}: nothing of what is given moves; leave --times out.")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"--html {path}: there is no folder {str(path.parent)!r}; make it first.")
    wanted = times_in(times) if times is not None else sliders(moving, steps=24)[0] if moving else []
    document = standalone(viewed, wanted, resolution=resolution, editing=editing).encode()
    replace_file(path, document)
    number = f"{len(wanted)} times" if moving else "no motion"
    typer.echo(f"{path}: {len(document) / 1e6:.1f} MB, {number}; it needs no server and no network")
