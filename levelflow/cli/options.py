"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ShapeArgument = Annotated[str, typer.Argument(metavar="SHAPE", help="A mesh, a point cloud, a field, or a built-in.")]
Folder = Annotated[
    Path | None, typer.Option("--output", "-o", help="The folder for the results; by default SHAPE-VERB.")
]
Steps = Annotated[
    int | None,
    typer.Option(help="Training steps. By default 1200, or, where there is --seconds, as many as it allows."),
]
Seconds = Annotated[float | None, typer.Option(help="Training time; takes the place of the default number of steps.")]
Seed = Annotated[int, typer.Option(help="Of every random choice.")]
Device = Annotated[str, typer.Option(help="cpu, cuda, cuda:1, ...")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but warnings and errors.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on with the interrupted run in the output folder.")]
Width = Annotated[int, typer.Option(help="Neurons of a layer.")]
Depth = Annotated[int, typer.Option(help="Hidden layers.")]
Resolution = Annotated[int, typer.Option(help="Marching-cubes cells along the longest side.")]
Times = Annotated[str | None, typer.Option(help="0,0.5,1 or first:last:number.")]
Relative = Annotated[
    bool, typer.Option("--relative", help="Rates, lengths and positions in units of half the box of the shape.")
]
