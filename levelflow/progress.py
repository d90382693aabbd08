"""Progress of long work, on a terminal."""

from __future__ import annotations

import math
import sys
from types import TracebackType

from levelflow.minimising import Progress

_WORDS = {
    "surface": "surface",
    "distance": "distance",
    "blend": "first guess",
    "guess": "first guess",
    "carried": "carried shape",
    "motion": "motion",
}


class Bar:
    """A line that shows how far a minimisation is, its rate, how far off it is, and the time left.

    Errors are root mean squares in percent of half the box: `distance 0.12 %` says that the field misses the given
    distances by about a thousandth of that. On anything but a terminal nothing is shown. Use it as a context:

        with Bar("solving") as bar:
            f = solve(..., on_step=bar)

    Args:
        title: What the line begins with.
        quiet: Show nothing even on a terminal.
    """

    def __init__(self, title: str, *, quiet: bool = False) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn

        self._live = not quiet and sys.stderr.isatty()
        self._bar = Progress(
            TextColumn(title),
            BarColumn(bar_width=24),
            TextColumn("{task.percentage:>3.0f} %"),
            TextColumn("{task.description}"),
            console=Console(stderr=True),
            disable=not self._live,
            transient=True,
        )
        self._task = self._bar.add_task("", total=1.0)

    def __enter__(self) -> Bar:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def __call__(self, progress: Progress) -> None:
        if self._live:
            self._bar.update(self._task, completed=progress.spent, description=describe(progress))


def describe(progress: Progress) -> str:
    """Rate, errors and time left in words: `41 steps/s, surface 0.31 %, motion 0.80 %, 0:12 left`."""
    rate = progress.step / progress.seconds if progress.seconds else 0.0
    errors = (
        f"{_WORDS.get(name, name)} {100 * math.sqrt(max(loss, 0.0)):.2g} %" for name, loss in progress.losses.items()
    )
    left = round(progress.remaining) if math.isfinite(progress.remaining) else 0
    return ", ".join((f"{rate:.0f} steps/s", *errors, f"{left // 60}:{left % 60:02d} left"))
