"""One file for each time: numbered names, and the list by which ParaView knows the times of the numbers."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar, runtime_checkable

from levelflow.shapes.writing import replace_file


@runtime_checkable
class Timed(Protocol):
    """What is there at one time, or has vanished."""

    @property
    def time(self) -> float:
        """When."""

    @property
    def is_empty(self) -> bool:
        """Whether nothing is there."""


@dataclass(frozen=True)
class Entry:
    """What was written for one time.

    Attributes:
        time: When.
        file: The file; None when the surface had vanished, so that there was nothing to write.
    """

    time: float
    file: Path | None


T = TypeVar("T", bound=Timed)


def write_sequence(
    items: Iterable[T],
    path: str | Path,
    write: Callable[[T, Path], None],
    *,
    alone: bool = False,
    on_entry: Callable[[Entry], None] | None = None,
) -> list[Entry]:
    """Writes `wave_0000.ply`, `wave_0001.ply`, ... for `wave.ply`, and skips the numbers of what has vanished.

    Args:
        items: What to write, in the order of time; each is written before the next is asked for.
        path: The name without its number. The folder must exist.
        write: Writes one of them to a file of that kind.
        alone: Whether there is but one, whose file is then `wave.ply`.
        on_entry: Called with each entry as soon as it is written, or skipped.
    """
    entries = []
    for i, item in enumerate(items):
        file = None if item.is_empty else Path(path) if alone else numbered(path, i)
        if file is not None:
            write(item, file)
        entries.append(Entry(item.time, file))
        if on_entry is not None:
            on_entry(entries[-1])
    return entries


def numbered(path: str | Path, i: int) -> Path:
    """`wave_0003.ply` for `wave.ply` and 3."""
    path = Path(path)
    return path.with_name(f"{path.stem}_{i:04d}{path.suffix}")


def write_series(entries: Sequence[Entry], path: str | Path) -> Path:
    """Writes `wave.ply.series`, from which ParaView opens the numbered files at their times.

    Args:
        entries: What `write_sequence` returned.
        path: The name that was given to it.

    Returns:
        The file.

    Reference:
        ParaView User's Guide, JSON-based file series.
    """
    path = Path(path)
    files = [{"name": entry.file.name, "time": entry.time} for entry in entries if entry.file is not None]
    series = path.with_name(f"{path.name}.series")
    replace_file(series, json.dumps({"file-series-version": "1.0", "files": files}, indent=1).encode())
    return series
