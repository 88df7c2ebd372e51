"""What a chart holds: axes, panels, and the marks in them; values only, nothing is drawn here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = [
    "COLORS",
    "Axis",
    "Band",
    "Bars",
    "Cells",
    "Label",
    "Level",
    "Line",
    "Mark",
    "Panel",
    "Points",
    "Segments",
    "Span",
    "thin",
]


Array = npt.NDArray[np.float64]

COLORS = ("blue", "orange", "green", "purple", "yellow", "sky")
"""Okabe and Ito's colours as series take them; beside them there are ``ink``, ``grey`` and ``faint``."""


@dataclass(frozen=True)
class Axis:
    """An axis.

    Attributes
    ----------
    title
        Name and unit.
    low, high
        Its ends; None takes them from the marks.
    log, flipped
        Logarithmic; with its low end to the right or at the top.
    ticks
        Places and texts; None chooses round numbers.
    step
        Distance of the ticks where they are chosen; None leaves it to the room there is.
    """

    title: str = ""
    low: float | None = None
    high: float | None = None
    log: bool = False
    flipped: bool = False
    ticks: tuple[tuple[float, str], ...] | None = None
    step: float | None = None


@dataclass(frozen=True)
class Line:
    """A line through points ``(N,)``; not finite values part it. ``tips`` are shown at its points."""

    x: Array
    y: Array
    name: str = ""
    color: str = "blue"
    width: float = 1.8
    dash: str = ""
    steps: bool = False
    symbol: str = ""
    symbol_size: float = 8.0
    tips: Sequence[str] = ()


@dataclass(frozen=True)
class Points:
    """Points ``(N,)``; not finite ones are left out.

    Attributes
    ----------
    symbol
        ``circle``, ``square``, ``diamond``, ``ring`` or ``cross``.
    error
        Half the length of the error bars ``(N,)``; None draws none.
    tips
        What is shown where the mouse rests on a point: one for each, or one for all.
    """

    x: Array
    y: Array
    name: str = ""
    color: str = "blue"
    size: float = 4.0
    opacity: float = 1.0
    symbol: str = "circle"
    error: Array | None = None
    tips: Sequence[str] = ()


@dataclass(frozen=True)
class Band:
    """The area between two curves over ``x`` ``(N,)``; not finite values part it."""

    x: Array
    low: Array
    high: Array
    name: str = ""
    color: str = "blue"


@dataclass(frozen=True)
class Bars:
    """Horizontal bars at heights 0, 1, …; a colour for each; not finite lengths are left out."""

    lengths: Array
    colors: Sequence[str]
    name: str = ""
    tips: Sequence[str] = ()


@dataclass(frozen=True)
class Level:
    """A line across the panel at a value of ``x`` or ``y``."""

    at: float
    axis: str = "y"
    name: str = ""
    color: str = "green"
    dash: str = "6 4"


@dataclass(frozen=True)
class Span:
    """A stretch of the x axis, shaded."""

    low: float
    high: float
    color: str = "orange"


@dataclass(frozen=True)
class Label:
    """Text at a point, or at the panel's upper left corner where ``x`` and ``y`` are None."""

    lines: tuple[str, ...]
    x: float | None = None
    y: float | None = None
    color: str = "ink"
    anchor: str = "middle"


@dataclass(frozen=True)
class Cells:
    """A matrix: columns along x, rows along y; colours from −1 (orange) over 0 (none) to 1 (blue)."""

    values: Array
    texts: Sequence[Sequence[str]]
    tips: Sequence[Sequence[str]] = ()


@dataclass(frozen=True)
class Segments:
    """Lines from ``start`` to ``end`` ``(N, 2)``."""

    start: Array
    end: Array
    name: str = ""
    color: str = "blue"
    width: float = 1.6


Mark = Line | Points | Band | Bars | Level | Span | Label | Cells | Segments


@dataclass(frozen=True)
class Panel:
    """One panel; ``equal`` gives both axes the same scale."""

    marks: tuple[Mark, ...]
    x: Axis = Axis()
    y: Axis = Axis()
    title: str = ""
    equal: bool = False

    def named(self, name: str) -> list[Mark]:
        """The marks of a name."""
        return [m for m in self.marks if getattr(m, "name", None) == name]


def thin(count: int, limit: int) -> npt.NDArray[np.int64]:
    """At most ``limit`` of ``count`` indices, evenly spread, ends included."""
    if count <= limit:
        return np.arange(count, dtype=np.int64)
    return np.unique(np.linspace(0, count - 1, limit).round().astype(np.int64))
