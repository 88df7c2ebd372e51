"""What verbs print: one screen on stdout, or nothing but JSON where that is asked for; progress and warnings on stderr.

Details (``say``, ``table``) are printed before the screen, of verbs that have ``--verbose`` only with it.
"""

from __future__ import annotations

import json as json_module
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clampid.display import MINUS
from clampid.plain_json import finite
from clampid.verbs.streams import write_result
from experiments.targets import Kind, check_output, is_stdout

__all__ = ["Output", "output_file"]

if TYPE_CHECKING:
    from rich.console import Console

    from clampid.screen import Screen


LINES_APART = 5.0  # seconds
WIDTH = 120  # of details that go to a file or a pipe, where neither a terminal nor COLUMNS says
_WIDTHS = re.compile("[1-9][0-9]{0,4}")
STYLES = {"good": "bold green", "open": "bold yellow", "bad": "bold red", "title": "bold", "quiet": "dim"}


class Output:
    """Where a verb's words, tables, progress and JSON go.

    Parameters
    ----------
    quiet
        No progress.
    json
        File for the JSON, ``-`` for stdout (which then carries nothing else), or None.
    verbose
        Whether details are printed.
    copied
        Whether people copy the printed numbers into programs and controllers, such as joint angles. Their minus sign is
        then a hyphen, because few programs read another one.
    """

    def __init__(
        self, quiet: bool = False, json: str | None = None, verbose: bool = True, *, copied: bool = False
    ) -> None:
        self.quiet, self.json = quiet, "-" if json is not None and is_stdout(json) else json
        self.copied = copied
        self.verbose, self.said = verbose, False
        if self.json is not None and self.json != "-":
            output_file(Path(self.json), "JSON")

    @cached_property
    def console(self) -> Console:
        """For people; silent where stdout is for programs."""
        return _console(stderr=False, silent=self.json == "-")

    @cached_property
    def errors(self) -> Console:
        """For progress and warnings."""
        return _console(stderr=True)

    def say(self, text: str = "") -> None:
        """A detail for people: whole words, on as many lines as it takes."""
        if self.verbose:
            self.said = True
            for line in _whole_words(text, self.console.width):
                self._line(line)

    def show(self, screen: Screen) -> None:
        """The screen that a verb ends in."""
        from clampid.screen import laid_out

        if self.said:
            self._line("")
        for line in laid_out(screen, self.console.width):
            self._line(line.text, STYLES.get(line.tone, ""))

    def _line(self, text: str, style: str = "") -> None:
        _print_line(self.console, text.replace(MINUS, "-") if self.copied else text, style)

    def warn(self, text: str) -> None:
        """A line on stderr that --quiet does not silence."""
        _print(self.errors, text)

    def step(self, text: str) -> None:
        """A plain line of progress."""
        if not self.quiet:
            _print(self.errors, text)

    @contextmanager
    def working(self, text: str) -> Iterator[None]:
        """Progress of one long step, with its parts and the time left: a bar on a terminal, else plain lines."""
        if self.quiet:
            yield
            return
        from clampid.progress import listen

        if self.errors.is_terminal:
            from clampid.verbs.progress_bar import ProgressBar

            with ProgressBar(self.errors, text) as bar, listen(bar.heard):
                yield
            return
        lines = _ProgressLines(self.step, text, self.errors.width)
        self.step(f"{text} …")
        with listen(lines.heard):
            yield
        self.step(f"{text}: {lines.elapsed:.1f} s")

    def table(self, title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> None:
        """A detail for people as a table; the first ``left`` columns are text, the others numbers."""
        if not self.verbose:
            return
        from clampid.text_table import table_lines

        self.said = True
        lines = table_lines(columns, [list(map(str, row)) for row in rows], left, self.console.width)
        for line in ["", *([title] if title else []), *lines, ""]:
            self._line(line)

    def result(self, data: Mapping[str, Any] | Sequence[Any]) -> None:
        """The result for programs, where it was asked for; numbers that are not finite become null."""
        if self.json is None:
            return
        text = json_module.dumps(finite(data), indent=1, allow_nan=False, ensure_ascii=False) + "\n"
        if self.json == "-":
            write_result(text)
        else:
            from experiments.outputs import write_text

            write_text(self.json, text)


class _ProgressLines:
    """Plain lines about the parts of a long step, at most one every :data:`LINES_APART` seconds."""

    def __init__(self, say: Callable[[str], None], text: str, width: int) -> None:
        from clampid.progress import Remaining

        self.say, self.text, self.width, self.remaining = say, text, width, Remaining()
        self.start = self.last = time.monotonic()

    @property
    def elapsed(self) -> float:
        """Seconds since the step began."""
        return time.monotonic() - self.start

    def heard(self, done: float, names: str) -> None:
        """A part begins."""
        from clampid.progress import innermost

        now = time.monotonic()
        left = self.remaining.words(done, now - self.start)
        if now - self.last >= LINES_APART:
            self.last = now
            times = f"; {now - self.start:.0f} s so far{left}"
            self.say(f"  {innermost(self.text, names, self.width - len(times) - 2)}{times}")


def output_file(path: Path, kind: Kind | None = None) -> Path:
    """The path, if a file of a kind can go there: said before the work, not after it.

    Raises
    ------
    OutputError
        It cannot; see :func:`experiments.targets.check_output`.
    """
    return check_output(path, kind)


def _print_line(console: Console, text: str, style: str = "") -> None:
    """Print a line as it is: no markup, no colours guessed."""
    from kinematics.escaping import for_terminal  # its package takes numpy with it, which help does without

    console.print(for_terminal(text), style=style or None, markup=False, highlight=False, soft_wrap=True)


def _print(console: Console, text: str) -> None:
    for line in _whole_words(text, console.width):
        _print_line(console, line)


def _whole_words(text: str, width: int) -> Iterator[str]:
    """Lines of whole words; what follows an indent is indented."""
    from clampid.screen import wrapped

    for line in text.split("\n"):
        indent = line[: len(line) - len(line.lstrip())]
        yield from wrapped(line, width, rest=f"{indent}  ") or [""]


def _console(stderr: bool, silent: bool = False) -> Console:
    """As wide as the terminal, or as COLUMNS says; colours on a terminal only, and not with NO_COLOR."""
    from rich.console import Console

    console, columns = Console(stderr=stderr, quiet=silent), os.environ.get("COLUMNS")
    known = console.is_terminal if columns is None else _WIDTHS.fullmatch(columns)  # rich would take 0 for a width
    if not known:
        console.width = WIDTH
    return console
