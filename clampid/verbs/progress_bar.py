"""Progress on a terminal: a bar with what is being done, the time so far and about the time left."""

from __future__ import annotations

import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

from clampid.progress import Remaining, innermost

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["ProgressBar"]

SHORTEST_WORK = 5.0  # seconds; of shorter work no time left is said
BAR_WIDTH = 10  # columns
TIMES_WIDTH = 7 + len("a few seconds left") + 3  # columns: the time so far, the time left, and what is between columns


class ProgressBar:
    """A bar that moves to and fro until it is known how far the work has come; it goes when the work is done."""

    def __init__(self, console: Console, text: str) -> None:
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
        from rich.table import Column

        self._room = max(console.width - BAR_WIDTH - TIMES_WIDTH, 1)
        said = TextColumn("{task.description}", table_column=Column(width=self._room, no_wrap=True), markup=False)
        columns = said, BarColumn(BAR_WIDTH), TimeElapsedColumn(), TextColumn("{task.fields[left]}")
        self._bar = Progress(*columns, console=console, transient=True)
        self._text, self._start, self._remaining = text, time.monotonic(), Remaining()
        self._task = self._bar.add_task(text, total=None, left="")

    def heard(self, done: float, names: str) -> None:
        """A part begins."""
        elapsed = time.monotonic() - self._start
        words = self._remaining.words(done, elapsed).removeprefix(", ")
        left = words if elapsed >= SHORTEST_WORK else ""
        total = 1.0 if done > 0 else None
        said = innermost(self._text, names, self._room)
        self._bar.update(self._task, description=said, total=total, completed=done, left=left)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()
