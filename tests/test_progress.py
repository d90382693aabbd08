import re

from levelflow.minimising import Progress
from levelflow.progress import Bar, describe


def test_it_says_rate_errors_and_time_left_in_words():
    progress = Progress(step=120, spent=0.25, seconds=30.0, losses={"surface": 1e-6, "motion": 4e-4})
    assert describe(progress) == "4 steps/s, surface 0.1 %, motion 2 %, 1:30 left"
    assert describe(Progress()) == "0 steps/s, 0:00 left"


def test_it_is_quiet_in_a_pipe(capsys):
    with Bar("fitting") as bar:
        bar(Progress(step=1, spent=0.5, seconds=1.0))
    assert capsys.readouterr() == ("", "")


def test_it_shows_a_bar_on_a_terminal(capsys, monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setenv("FORCE_COLOR", "1")
    with Bar("fitting") as bar:
        bar(Progress(step=1, spent=0.5, seconds=1.0))
        bar(Progress(step=2, spent=1.0, seconds=2.0))
    shown = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", capsys.readouterr().err)
    assert "fitting" in shown and "1 steps/s" in shown and "100 %" in shown
