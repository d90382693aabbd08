"""The command line: the only place where strings choose things."""

from __future__ import annotations

import sys
import warnings

import typer

from levelflow.cli.commands import app

__all__ = ["app", "main"]


def main() -> None:
    """Runs the command line. Exit codes: 0 done, 1 failed, 2 used wrongly, 130 interrupted."""
    arguments = [a for a in sys.argv[1:] if a != "--debug"]
    debug = len(arguments) < len(sys.argv) - 1
    warnings.showwarning = lambda message, *_, **__: typer.echo(f"warning: {message}", err=True)
    try:
        app(args=arguments)
    except Exception as error:
        if debug:
            raise
        wrong_use = isinstance(error, (ValueError, TypeError, FileNotFoundError, NotADirectoryError, IsADirectoryError))
        typer.echo(f"error: {error}", err=True)
        sys.exit(2 if wrong_use and not _is_failure(error) else 1)


def _is_failure(error: Exception) -> bool:
    """Whether a wrong value is the outcome of the work and not of the command."""
    return type(error).__name__ in ("EmptyLevelSet", "TopologyChange")
