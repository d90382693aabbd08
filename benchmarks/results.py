"""What was measured beside what was published: records of experiments, their pictures, and the document of all.

An experiment leaves NAME.json and NAME.png in a folder; the document is put together from the records that lie there,
so that experiments can be run one at a time.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from levelflow.shapes.writing import replace_file

LARGEST = 150_000
"""Bytes of a picture."""

COLUMNS = ("on-surface mean", "on-surface max", "off-surface mean", "off-surface max", "equation mean", "equation max")
"""Of Tables 1 and 2."""

Cell = str | float | None


@dataclass
class Record:
    """One experiment as it was run.

    Attributes:
        name: What the command calls it.
        title: What it shows.
        source: Where in the papers it is.
        setting: The network, the samples and the steps of this run, in words.
        published: The same of the paper.
        claim: What the paper says or shows of it, in words.
        seconds: Wall-clock time of everything, pictures included.
        processor: Processor seconds of the same.
        threads: Of the run.
        date: Of the run, year-month-day.
        version: Of PyTorch.
        header: Of the table of what was measured.
        lines: Its lines.
        columns: The six columns of Table 1 or 2 by the way in which the field was made.
        table: Which of these tables, and the row's published numbers under `published_columns`.
        notes: What a reader has to know.
    """

    name: str
    title: str
    source: str
    setting: str
    published: str
    claim: str
    seconds: float = 0.0
    processor: float = 0.0
    threads: int = 1
    date: str = ""
    version: str = ""
    header: list[str] = field(default_factory=lambda: ["measured", "found", "published"])
    lines: list[list[Cell]] = field(default_factory=list)
    columns: dict[str, list[float]] = field(default_factory=dict)
    table: int | None = None
    published_columns: list[float] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def write(self, folder: Path) -> None:
        """NAME.json in a folder, all of it or nothing."""
        folder.mkdir(parents=True, exist_ok=True)
        replace_file(folder / f"{self.name}.json", (json.dumps(asdict(self), indent=1) + "\n").encode())

    @classmethod
    def read(cls, path: Path) -> Record:
        return cls(**json.loads(path.read_text()))

    def missed(self, way: str) -> list[str]:
        """Which columns of a table are greater than the published ones."""
        pairs = zip(COLUMNS, self.columns[way], self.published_columns, strict=True)
        return [name for name, found, published in pairs if not found <= published]


def keep(picture: UInt8[np.ndarray, "h w 3"], path: Path) -> None:
    """Writes a picture with few colours, and smaller where that is not enough."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.fromarray(picture)
    while (data := _encoded(image)).tell() > LARGEST:
        share = 0.95 * (LARGEST / data.tell()) ** 0.5
        image = image.resize((round(image.width * share), round(image.height * share)), Image.Resampling.LANCZOS)
    replace_file(path, data.getvalue())


def _encoded(image: Image.Image) -> io.BytesIO:
    data = io.BytesIO()
    image.quantize(96, dither=0).save(data, format="PNG", optimize=True)
    return data


def document(folder: Path, order: Sequence[str], tables: Mapping[int, tuple[str, str]]) -> str:
    """The document of the records in a folder.

    Args:
        folder: Where records and pictures lie.
        order: Names in the order of the document; others come after them.
        tables: What the tables of columns show, and what there is to say of them, by their numbers.
    """
    records = {path.stem: Record.read(path) for path in sorted(folder.glob("*.json"))}
    names = [name for name in order if name in records] + sorted(set(records) - set(order))
    found = [records[name] for name in names]
    parts = [HEAD]
    for number, (title, remark) in tables.items():
        rows = [record for record in found if record.table == number]
        if rows:
            parts += [_columns(number, title, rows), *([remark] if remark else [])]
    if missing := [name for name in order if name not in records]:
        parts.append(f"Not run yet: {', '.join(missing)}.")
    parts += [_section(record, folder) for record in found]
    return "\n\n".join(parts) + "\n"


HEAD = """# The papers' experiments

Made by `python benchmarks/papers.py`; do not edit. Every experiment is named as the command names it, and can be run
again alone; `--published` takes the network, the frequency, the samples and the steps of the paper instead. What the
settings, columns and shapes stand for is in [benchmarks](../../benchmarks/README.md). "Found" is what this run measured
and "published" what the paper prints; where it prints no number, what it says or shows."""


def _columns(number: int, title: str, rows: Sequence[Record]) -> str:
    lines = [f"## Table {number}: {title}", "", _line(["field", *COLUMNS, "missed"]), _rule(8)]
    for record in rows:
        lines.append(_line([f"**{record.name}**, published", *record.published_columns, ""]))
        for way, values in record.columns.items():
            missed = record.missed(way)
            lines.append(
                _line([way, *values, ", ".join(missed) or "none" if len(missed) < 4 else f"{len(missed)} of 6"])
            )
    return "\n".join(lines)


def _section(record: Record, folder: Path) -> str:
    lines = [f"## {record.name}", "", f"{record.title} ({record.source})."]
    if (folder / f"{record.name}.png").exists():
        lines += ["", f"![{record.title}]({record.name}.png)"]
    lines += [
        "",
        f"- Run: {record.setting}; {record.seconds:.0f} s, of which {record.processor:.0f} s of processor time, on "
        f"{record.threads} thread{'s' * (record.threads != 1)}, {record.date}, PyTorch {record.version}.",
        f"- Published: {record.published}. {record.claim}",
        *(f"- {note}" for note in record.notes),
    ]
    if record.lines:
        lines += ["", _line(record.header), _rule(len(record.header)), *map(_line, record.lines)]
    return "\n".join(lines)


def _line(cells: Sequence[Cell]) -> str:
    return "| " + " | ".join(map(_text, cells)) + " |"


def _rule(n: int) -> str:
    return "|" + "---|" * n


def _text(cell: Cell) -> str:
    if cell is None:
        return ""
    if isinstance(cell, str):
        return cell
    return f"{cell:.2g}" if abs(cell) < 1 else f"{cell:.3g}"
