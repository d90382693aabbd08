"""Handles that are placed and dragged on the page: the file that they are in, and what they do to the surface."""

from __future__ import annotations

import json
import threading
import warnings
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, final

import numpy as np

from levelflow.flows import AsRigidAsPossible, BlendedMotions, Edit, ThinShell
from levelflow.flows.densifying import Densify
from levelflow.handles import Handle, HandleWarning, PaintedRegion, handles_from, handles_in, selected
from levelflow.shapes.mesh import Mesh
from levelflow.shapes.writing import replace_file
from levelflow.viewer.frames import Superseded
from levelflow.viewer.viewed import Surface

WAYS: Mapping[str, Densify] = MappingProxyType(
    {"blended": BlendedMotions(), "arap": AsRigidAsPossible(), "shell": ThinShell()}
)
"""What happens between the handles, by the name that `levelflow edit --rigid` gives it; the first is the default."""

STEPS = 8
"""In how many steps a surface is deformed, as by `levelflow edit`."""


@final
class Editing:
    """The handles of one surface, in a file that the page reads and writes.

    Args:
        surface: The surface before the edit. Its mesh is what handles take hold of and what is deformed.
        file: The JSON file of the handles; it need not be there yet.
        command: The command that makes the edit of the field.

    Raises:
        FileNotFoundError: If there is no folder for the file, or a file of paint is missing.
        ValueError: If there is such a file and it holds no handles, or handles of another space.
    """

    def __init__(self, surface: Mesh, file: str | Path, *, command: str) -> None:
        self.surface, self.file, self.command = surface, Path(file), command
        self._lock, self._asked = threading.Lock(), dict[str, int]()
        if not self.file.parent.is_dir():
            raise FileNotFoundError(f"--handles {file}: there is no folder {str(self.file.parent)!r}; make it first.")
        space = surface.vertices.shape[1]
        if wrong := [handle for handle in self._handles() if len(handle.region.pivot) != space]:
            raise ValueError(
                f"--handles {file}: there is a region in R^{len(wrong[0].region.pivot)}, and the surface lies in "
                f"R^{space}; name another file."
            )

    def description(self) -> dict[str, Any]:
        """What the page has to know: the handles as they are in the file now, and the middles of what is painted."""
        handles = self._handles()
        document = json.loads(self.file.read_text("utf-8-sig")) if handles else {"handles": []}
        return {
            "file": self.file.name,
            "command": self.command,
            "ways": list(WAYS),
            "handles": document["handles"],
            "middles": [
                list(handle.region.pivot) if isinstance(handle.region, PaintedRegion) else None for handle in handles
            ],
        }

    def save(self, text: str) -> None:
        """Puts handles in the file, one a line, in one step.

        Raises:
            OSError: If the file cannot be written.
            ValueError: If the text holds no handles; see `handles_in`.
        """
        handles_in(text, folder=self.file.parent)
        rows = ",\n".join(f"    {json.dumps(row, ensure_ascii=False)}" for row in json.loads(text)["handles"])
        replace_file(self.file, f'{{\n  "handles": [\n{rows}\n  ]\n}}\n'.encode())

    def deformed(self, text: str, *, way: str = "blended", steps: int = STEPS, page: str = "") -> Surface:
        """The surface after the edit of some handles, with all of it between them.

        What a page has asked for is given up when it asks for something else.

        Its quantities say, for each vertex, where it was before (`x`, `y` and in space `z`), and the number of the
        handle that holds it, from 1, or 0 (`held`). Its note is what there is to be warned of.

        Raises:
            Superseded: If it was given up.
            ValueError: If the text holds no handles, they miss the surface or contradict each other, or there is no
                such way.
        """
        if way not in WAYS:
            raise ValueError(f"deformed: there is no way {way!r}; known are {', '.join(WAYS)}.")
        handles = handles_in(text, folder=self.file.parent)
        mine = self._asked[page] = self._asked.get(page, 0) + 1

        def check(_: Mesh) -> None:
            if self._asked[page] > mine:
                raise Superseded(f"edit {mine} is over")

        # Warnings are caught for the whole process: one edit at a time.
        with self._lock, warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", HandleWarning)
            edit = Edit(self.surface, handles, densify=WAYS[way])
            mesh = edit.deformed(steps=steps, on_step=check)
            said = [str(warning.message) for warning in caught if issubclass(warning.category, HandleWarning)]
            held = np.zeros(len(mesh.vertices))
            for number, vertices in enumerate(selected(handles, self.surface.vertices), 1):
                held[vertices] = number
        before = dict(zip("xyz", self.surface.vertices.T, strict=False))
        return Surface((), mesh, before | {"held": held}, " ".join(dict.fromkeys(said)))

    def _handles(self) -> tuple[Handle, ...]:
        return handles_from(self.file) if self.file.exists() else ()
