"""Every example runs on its own and ends in its picture."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted(path.name for path in (ROOT / "examples").glob("*.py"))


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_ends_in_a_picture(name, tmp_path):
    from PIL import Image

    done = subprocess.run(
        [sys.executable, str(ROOT / "examples" / name), "-o", "picture.png", "--steps", "60"],
        cwd=tmp_path, capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "picture.png" in done.stdout
    with Image.open(tmp_path / "picture.png") as picture:
        assert picture.width > 500


def test_there_are_examples():
    assert len(EXAMPLES) >= 3
