"""What a report's sections hold: text, tables and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from clampid.charts import Chart

__all__ = ["Command", "Figure", "Section", "Selector", "Table", "Weak", "as_table"]


class Weak(str):
    """A cell whose number does not differ significantly from zero, set in grey."""


@dataclass(frozen=True)
class Table:
    """A table of text.

    Attributes
    ----------
    columns
        Heads; one that ends in ``#`` holds numbers, which are set flush right.
    folded
        Whether the page shows its caption only, until it is opened; long tables with a caption are in any case.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    folded: bool = False


@dataclass(frozen=True)
class Command:
    """A shell command on lines that a reader can copy as a whole, with what it does."""

    lines: tuple[str, ...]
    caption: str


@dataclass(frozen=True)
class Selector:
    """A variable against which the reader can plot a figure's points.

    Attributes
    ----------
    names
        What can be chosen; the first is drawn.
    choices
        For each name what the page's script puts into the drawing, as :mod:`clampid.report.choices` packs it.
    values
        For each panel the heights of its points, packed.
    ends
        Where the points that were fitted end, and those held out; the rest was rejected.
    outlines
        The outline of a point of each of these three.
    """

    names: tuple[str, ...]
    choices: tuple[Mapping[str, Any], ...]
    values: tuple[str, ...]
    ends: tuple[int, int]
    outlines: tuple[str, str, str]


@dataclass(frozen=True)
class Figure:
    """A chart with a caption, and perhaps a variable to choose."""

    key: str
    plot: Chart
    caption: str
    selector: Selector | None = None


@dataclass(frozen=True)
class Section:
    """One section of the page: paragraphs, then headings (text), tables, figures and commands in order, then notes.

    Attributes
    ----------
    title
        Its topic.
    finding
        What it shows, in one sentence: the heading, where there is one.
    in_full
        Paragraphs that the page shows once they are opened.
    """

    key: str
    title: str
    paragraphs: tuple[str, ...] = ()
    blocks: tuple[str | Table | Figure | Command, ...] = ()
    notes: tuple[str, ...] = ()
    notes_title: str = ""
    finding: str = ""
    in_full: tuple[str, ...] = ()


def as_table(columns: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> Table:
    """A table from any sequences."""
    return Table(tuple(columns), tuple(tuple(row) for row in rows), caption)
