"""Progress of a run: a bar with the time left on a terminal, else a line now and then."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from clampid.progress import left_in_words
from clampid.verbs.output import LINES_APART, Output

if TYPE_CHECKING:
    from experiments.runs.runner import Asked

__all__ = ["progress_of"]


@contextmanager
def progress_of(asked: Asked, out: Output) -> Iterator[None]:
    """While it lasts, the run's progress is shown."""
    if out.quiet:
        yield
        return
    if out.errors.is_terminal:
        from clampid.verbs.progress_bar import ProgressBar

        with ProgressBar(out.errors, "running") as bar:
            asked.progress = bar.heard
            yield
        return
    lines = _Lines(out)
    asked.progress = lines.heard
    yield


class _Lines:
    """A line every few seconds; the time left is judged by what this session has done."""

    def __init__(self, out: Output) -> None:
        self._out, self._start, self._last = out, time.monotonic(), 0.0
        self._first: float | None = None

    def heard(self, done: float, text: str) -> None:
        """A part begins."""
        now = time.monotonic()
        if self._first is None:
            self._first = done
        if now - self._last < LINES_APART:
            return
        self._last = now
        share = (done - self._first) / max(1.0 - self._first, 1e-9)
        self._out.step(f"{done:4.0%} {text}{left_in_words(share, now - self._start)}")
