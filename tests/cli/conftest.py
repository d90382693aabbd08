"""Commands run in this process."""

import sys

import pytest

from levelflow.cli import main


@pytest.fixture
def run(capsys, monkeypatch):
    """Runs a command in this process; returns exit code, standard output and standard error."""

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["levelflow", *map(str, arguments)])
        try:
            main()
            code = 0
        except SystemExit as stop:
            code = stop.code or 0
        return (code, *capsys.readouterr())

    return call
