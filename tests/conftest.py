"""Type checks on every call of levelflow, and fixtures shared by all tests."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from jaxtyping import config, install_import_hook

import tests.typechecking  # noqa: F401

install_import_hook("levelflow", "tests.typechecking.checked")


@pytest.fixture
def generator() -> torch.Generator:
    """A source of randomness that starts the same in every test."""
    return torch.Generator().manual_seed(0)


@pytest.fixture
def unchecked() -> Iterator[None]:
    """No type checks: a user's session has none, and its wrong shapes and types meet the errors of the library."""
    before = config.jaxtyping_disable
    config.update("jaxtyping_disable", True)
    yield
    config.update("jaxtyping_disable", before)


@pytest.fixture(scope="session")
def meshes() -> Path:
    """The folder of test meshes: `$LEVELFLOW_MESHES`, or `../shared/meshes` beside the repository."""
    root = Path(__file__).resolve().parent.parent
    folder = Path(os.environ.get("LEVELFLOW_MESHES", root.parent / "shared" / "meshes"))
    if not folder.is_dir():
        pytest.skip(f"no test meshes at {folder}; set LEVELFLOW_MESHES")
    return folder
