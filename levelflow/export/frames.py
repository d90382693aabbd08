"""The surfaces of a field at some times, as meshes and a contact sheet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from levelflow.extraction import EmptyLevelSet, extract
from levelflow.fields import Field
from levelflow.rendering.images import contact_sheet
from levelflow.shapes.mesh import Mesh


@dataclass(frozen=True)
class Frame:
    """The surface at one time.

    Attributes:
        time: When.
        mesh: The surface, in the units of the field; None when it has vanished.
        file: The name of its file, when it was written.
    """

    time: float
    mesh: Mesh | None
    file: str | None = None

    def report(self) -> dict[str, float | int | str | None]:
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
    times: Sequence[float],
    folder: Path,
    *,
    resolution: int = 128,
    title: str | None = None,
    on_frame: Callable[[Frame], None] | None = None,
) -> list[Frame]:
    """Writes `t=+0.100.ply`, ... for each time, and `frames.png`, a contact sheet of them.

    A time at which the surface has vanished has no file and an empty picture.

    Args:
        field: A field of space and one time.
        times: The times, in the interval of the field.
        folder: Where to; it must exist.
        resolution: Cells along the longest side of the box.
        title: A line above the contact sheet.
        on_frame: Called with each frame as soon as it is written.
    """
    frames = []
    for t in times:
        try:
            mesh = extract(field.at(t), resolution=resolution)
        except EmptyLevelSet:
            frame = Frame(t, None)
        else:
            frame = Frame(t, mesh, file_name(t))
            mesh.write(folder / file_name(t))
        frames.append(frame)
        if on_frame is not None:
            on_frame(frame)
    contact_sheet([frame.mesh for frame in frames], [f"t = {t:g}" for t in times], folder / "frames.png", title=title)
    return frames


def file_name(t: float) -> str:
    """`t=+0.100.ply`: the sign and at least three decimals, as many as the time needs to be told from others."""
    t = t + 0.0  # no file is called -0.000
    text = f"{t:+.3f}" if float(f"{t:.12g}") == round(t, 3) else f"{t:+.9g}"
    return f"t={text}.ply"
