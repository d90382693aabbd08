"""The surfaces of a field at some times or parameters, as meshes and a contact sheet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from levelflow.extraction import EmptyLevelSet, extract
from levelflow.fields import Field
from levelflow.rendering.images import contact_sheet
from levelflow.shapes.mesh import Mesh

Place = float | tuple[float, ...]
"""A time, or a number for each of several parameters."""


@dataclass(frozen=True)
class Frame:
    """The surface at one time.

    Attributes:
        time: When, or at which parameters.
        mesh: The surface, in the units of the field; None when it has vanished.
        file: The name of its file, when it was written.
    """

    time: Place
    mesh: Mesh | None
    file: str | None = None

    def report(self) -> dict[str, Place | int | str | None]:
        """Plain values for a report."""
        if self.mesh is None:
            return {"time": self.time, "file": None, "vanished": True}
        return {
            "time": self.time,
            "file": self.file,
            "vertices": len(self.mesh.vertices),
            "faces": len(self.mesh.faces),
            "area": self.mesh.area,
            "volume": self.mesh.volume,
            "components": self.mesh.components,
        }


def write_frames(
    field: Field,
    times: Sequence[Place],
    folder: Path,
    *,
    resolution: int = 128,
    title: str | None = None,
    columns: int | Sequence[int] | None = None,
    on_frame: Callable[[Frame], None] | None = None,
) -> list[Frame]:
    """Writes `t=+0.100.ply`, ... for each time, and `frames.png`, a contact sheet of them.

    A time at which the surface has vanished has no file and an empty picture. The surface at several parameters is
    `t=+0.100,+0.500.ply`.

    Args:
        field: A field of space and one time, or of several parameters.
        times: The times, in the interval of the field, or tuples of parameters.
        folder: Where to; it must exist.
        resolution: Cells along the longest side of the box.
        title: A line above the contact sheet.
        columns: Pictures in a row of it, or in each of its rows.
        on_frame: Called with each frame as soon as it is written.
    """
    frames = []
    for t in times:
        try:
            mesh = extract(field.at(*_numbers(t)), resolution=resolution)
        except EmptyLevelSet:
            frame = Frame(t, None)
        else:
            frame = Frame(t, mesh, file_name(t))
            mesh.write(folder / file_name(t))
        frames.append(frame)
        if on_frame is not None:
            on_frame(frame)
    labels = [f"t = {t:g}" if isinstance(t, int | float) else ", ".join(f"{value:.3g}" for value in t) for t in times]
    contact_sheet([frame.mesh for frame in frames], labels, folder / "frames.png", title=title, columns=columns)
    return frames


def file_name(t: Place) -> str:
    """`t=+0.100.ply`: the sign and at least three decimals, as many as the time needs to be told from others."""
    # No file is called -0.000.
    numbers = [value + 0.0 for value in _numbers(t)]
    words = [f"{v:+.3f}" if float(f"{v:.12g}") == round(v, 3) else f"{v:+.9g}" for v in numbers]
    return f"t={','.join(words)}.ply"


def _numbers(t: Place) -> tuple[float, ...]:
    return t if isinstance(t, tuple) else (t,)
