"""What verbs print: results on stdout (nothing but JSON where that is asked for), progress and warnings on stderr."""

from __future__ import annotations

import json as json_module
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clampid.verbs.streams import write_result
from experiments.targets import Kind, check_output, is_stdout
from kinematics.escaping import for_terminal

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["Output", "finite", "output_file"]

WIDTH = 120  # of tables that go to a file or a pipe, where no terminal says


class Output:
    """Where a verb's words, tables, progress and JSON go.

    Parameters
    ----------
    quiet
        No progress.
    json
        File for the JSON, ``-`` for stdout (which then carries nothing else), or None.
    """

    def __init__(self, quiet: bool = False, json: str | None = None) -> None:
        self.quiet, self.json = quiet, "-" if json is not None and is_stdout(json) else json
        if self.json is not None and self.json != "-":
            output_file(Path(self.json), "json")

    @cached_property
    def console(self) -> Console:
        """For people; silent where stdout is for programs."""
        return _console(stderr=False, silent=self.json == "-")

    @cached_property
    def errors(self) -> Console:
        """For progress and warnings."""
        return _console(stderr=True)

    def say(self, text: str = "") -> None:
        """A line for people, as it is: no markup, no colours guessed."""
        self.console.print(for_terminal(text), markup=False, highlight=False, soft_wrap=True)

    def warn(self, text: str) -> None:
        """A line on stderr that --quiet does not silence."""
        self.errors.print(for_terminal(text), markup=False, highlight=False, soft_wrap=True)

    def step(self, text: str) -> None:
        """A plain line of progress."""
        if not self.quiet:
            self.errors.print(for_terminal(text), markup=False, highlight=False, soft_wrap=True)

    @contextmanager
    def working(self, text: str) -> Iterator[None]:
        """Progress of one long step: a moving bar with the time on a terminal, else plain lines."""
        if self.quiet:
            yield
            return
        start = time.monotonic()
        if self.errors.is_terminal:
            from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

            columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
            with Progress(*columns, console=self.errors, transient=True) as progress:
                progress.add_task(text, total=None)  # how long a fit takes nobody knows before: the bar only moves
                yield
        else:
            self.step(f"{text} …")
            yield
        self.step(f"{text}: {time.monotonic() - start:.1f} s")

    def table(self, title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> None:
        """A table for people; the first ``left`` columns are text, the others numbers."""
        from rich import box
        from rich.table import Table

        table = Table(title=title or None, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
        for k, name in enumerate(columns):
            table.add_column(name, justify="left" if k < left else "right", overflow="fold")
        for row in rows:
            table.add_row(*(_plain(cell) for cell in row))
        self.console.print(table, highlight=False)

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


def finite(data: Any) -> Any:
    """The same data for JSON: tuples as lists, numpy scalars as numbers, what is not finite as None."""
    match data:
        case Mapping():
            return {str(key): finite(value) for key, value in data.items()}
        case str() | bool() | int() | None:
            return data
        case float():
            return data if math.isfinite(data) else None
        case Iterable():
            return [finite(value) for value in data]
        case _ if hasattr(data, "item"):
            return finite(data.item())
        case _:
            raise TypeError(f"cannot write {type(data).__name__} as JSON")


def output_file(path: Path, kind: Kind | None = None) -> Path:
    """The path, if a file of a kind can go there: said before the work, not after it.

    Raises
    ------
    OutputError
        It cannot; see :func:`experiments.targets.check_output`.
    """
    return check_output(path, kind)


def _plain(cell: str) -> Any:
    from rich.text import Text

    return Text(for_terminal(cell))


def _console(stderr: bool, silent: bool = False) -> Console:
    from rich.console import Console

    console = Console(stderr=stderr, quiet=silent)
    return console if console.is_terminal else Console(stderr=stderr, quiet=silent, width=WIDTH)
