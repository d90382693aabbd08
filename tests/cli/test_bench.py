"""`levelflow bench` as a user meets it."""

from __future__ import annotations

from levelflow.suite import CASES


def test_its_help_names_every_case(run) -> None:
    words = run("bench", "--help")[1].replace(",", " ").replace(";", " ").split()
    assert not set(CASES) - set(words)


def test_rows_are_printed_and_a_miss_is_the_exit_code(run) -> None:
    code, out, _ = run("bench", "fit", "--steps", 3, "--mesh", "sphere")
    lines = [line for line in out.splitlines() if line.startswith("fit of")]
    assert code == 1 and len(lines) == 3 and all(line.endswith("missed") for line in lines)


def test_unknown_cases_are_refused_with_the_known_ones(run) -> None:
    code, _, err = run("bench", "spheres", "fit")
    assert code == 2 and "bench: there is no case spheres; known are sphere, sharpening" in err.replace("\n", " ")
