"""What the documentation shows is run: every Python block, and every command as far as its options.

The Python blocks of one document run one after the other, as a reader would run them, in an empty folder. A block that
cannot run here says why, in the line before it: `<!-- not run: it needs a GPU -->`.
"""

from __future__ import annotations

import re
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest

from levelflow.cli import app

ROOT = Path(__file__).resolve().parent.parent
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
SHELLS = {"sh", "bash", "shell", "console"}


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, its first line (counted from 1), its text, and why it is not run."""

    language: str
    line: int
    text: str
    reason: str | None = None


def _blocks(text: str) -> list[Block]:
    found: list[Block] = []
    lines = iter(enumerate(text.splitlines(), start=1))
    before = ""
    for _, line in lines:
        if opening := re.fullmatch(r"( *)```(\w*).*", line):
            indent, inner, first = opening[1], [], 0
            for number, content in lines:
                if content.strip() == "```":
                    break
                first = first or number
                inner.append(content.removeprefix(indent))
            excuse = re.fullmatch(r"\s*<!-- not run: (.+?) -->\s*", before)
            found.append(Block(opening[2], first, "\n".join(inner) + "\n", excuse[1] if excuse else None))
        before = line if line.strip() else before
    return found


def _commands(text: str) -> list[list[str]]:
    """The arguments of every `levelflow` command in a shell block; what it is piped or redirected to is left out."""
    found = []
    for line in text.replace("\\\n", " ").splitlines():
        words = shlex.split(line.strip().removeprefix("$ "), comments=True)
        while "levelflow" in words:
            words = words[words.index("levelflow") + 1 :]
            ends = [i for i, word in enumerate(words) if word in {"|", "&&", "||", ";", ">", ">>", "&"}]
            end = ends[0] if ends else len(words)
            found.append(words[:end])
            words = words[end:]
    return found


def _refusal(arguments: list[str]) -> str | None:
    """What the command line has against these arguments. Nothing is carried out."""
    from typer.main import get_command

    group = get_command(app)
    for command in (group, *group.commands.values()):
        command.callback = lambda **_: None
    try:
        group.main([a for a in arguments if a != "--debug"], prog_name="levelflow", standalone_mode=False)
    except Exception as error:
        return str(getattr(error, "format_message", lambda: error)())
    return None


def _named(document: Path) -> str:
    return str(document.relative_to(ROOT))


def _read(document: Path, languages: set[str]) -> list[Block]:
    if not document.exists():
        pytest.skip(f"there is no {_named(document)}")
    blocks = [block for block in _blocks(document.read_text()) if block.language in languages]
    if not blocks:
        pytest.skip(f"{_named(document)} has no block in {' or '.join(sorted(languages))}")
    return blocks


@pytest.mark.parametrize("document", DOCUMENTS, ids=_named)
def test_every_python_block_runs(document: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = _read(document, {"python"})
    module = ModuleType("documentation")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.chdir(tmp_path)
    for block in blocks:
        padded = "\n" * (block.line - 1) + block.text  # so that a traceback shows the lines of the document
        code = compile(padded, str(document), "exec")
        if block.reason is None:
            exec(code, module.__dict__)


@pytest.mark.parametrize("document", DOCUMENTS, ids=_named)
def test_every_command_is_understood(document: Path) -> None:
    wrong = [
        f"{document}:{block.line}: levelflow {shlex.join(arguments)}: {refusal}"
        for block in _read(document, SHELLS)
        for arguments in _commands(block.text)
        if (refusal := _refusal(arguments))
    ]
    assert not wrong, "\n".join(wrong)


def test_blocks_and_commands_are_found() -> None:
    text = """
```python
x = 1
```

- In a list:
  ```sh
  $ pip install levelflow
  $ levelflow morph a.obj b.obj \\
      --output out | tee log  # a comment
  levelflow info out/field.safetensors && levelflow demo
  ```
"""
    first, second = _blocks(text)
    assert first == Block("python", 3, "x = 1\n")
    assert second.language == "sh"
    assert _commands(second.text)[1:] == [
        ["morph", "a.obj", "b.obj", "--output", "out"],
        ["info", "out/field.safetensors"],
        ["demo"],
    ]


def test_an_excuse_belongs_to_the_block_that_follows() -> None:
    text = "<!-- not run: no GPU -->\n```python\na\n```\n\n```python\nb\n```\n"
    assert [block.reason for block in _blocks(text)] == ["no GPU", None]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [("demo", None), ("--version", None), ("demo --bogus", "--bogus"), ("nonsense", "nonsense"), ("morph", "Missing")],
)
def test_the_command_line_refuses_what_it_does_not_know(arguments: str, message: str | None) -> None:
    refusal = _refusal(arguments.split())
    assert refusal is None if message is None else refusal is not None and message in refusal
