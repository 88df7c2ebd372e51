"""From values to pixels, and the round values at which an axis has its ticks."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import singledispatch

import numpy as np
import numpy.typing as npt

from clampid.charts.marks import Array, Axis, Band, Bars, Cells, Label, Level, Line, Mark, Panel, Points, Segments, Span

__all__ = ["MINUS", "Box", "Scale", "number", "scales"]

ROOM = 0.04  # of an axis beyond its outermost mark
APART_X, APART_Y = 60.0, 32.0  # pixels between ticks
MINUS = "−"


@dataclass(frozen=True)
class Box:
    """A rectangle of the page: its upper left corner, width and height."""

    x: float
    y: float
    w: float
    h: float


@dataclass(frozen=True)
class Scale:
    """One axis of a panel: ``start`` and ``end`` are the pixels of ``low`` and ``high``."""

    low: float
    high: float
    start: float
    end: float
    axis: Axis

    def __call__(self, value: npt.ArrayLike) -> Array:
        """Pixels of values; not finite where a value is not, or not positive on a logarithmic axis."""
        v = np.asarray(value, dtype=float)
        low, high = self.low, self.high
        if self.axis.log:
            v = np.log(np.where(v > 0, v, np.nan))
            low, high = math.log(low), math.log(high)
        return np.asarray(self.start + (v - low) / (high - low) * (self.end - self.start))

    def ticks(self, apart: float) -> list[tuple[float, str]]:
        """Values and texts of the ticks."""
        if self.axis.ticks is not None:
            return list(self.axis.ticks)
        most = max(2, int(abs(self.end - self.start) / apart))
        if self.axis.log:
            return [(v, number(v)) for v in _decades(self.low, self.high, most)]
        step = self.axis.step or self._finest(most)
        first, last = self._multiples(step)
        return [(k * step, number(k * step, step)) for k in range(first, last + 1)]

    def _multiples(self, step: float) -> tuple[int, int]:
        """The first and the last multiple of a step within the axis."""
        return math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)

    def _finest(self, most: int) -> float:
        """The smallest of 1, 2, 5 times a power of ten that gives at most so many ticks."""
        power = 10.0 ** math.floor(math.log10((self.high - self.low) / (most + 1)))
        steps = [m * power for m in (1.0, 2.0, 5.0, 10.0, 20.0)]
        counts = [last - first + 1 for first, last in map(self._multiples, steps)]
        return next(step for step, count in zip(steps, counts, strict=True) if count <= most)


def number(value: float, step: float | None = None) -> str:
    """A tick's text, with as many digits as its step asks for."""
    if step is None or abs(value) >= 1e5 or 0 < abs(step) < 1e-4:
        text = f"{value:.4g}"
    else:
        text = f"{value:.{max(0, -math.floor(math.log10(step) + 1e-9))}f}"
    return text.replace("-", MINUS) if float(text) else "0"


def _decades(low: float, high: float, most: int) -> list[float]:
    """Round values of a logarithmic axis: 1, 2, 5 where there is room, then decades, then some of these."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    for mantissas in ((1, 2, 5), (1, 3), (1,)):
        found = [m * 10.0**e for e in range(first, last + 1) for m in mantissas]
        found = [v for v in found if low * (1 - 1e-9) <= v <= high * (1 + 1e-9)]
        if len(found) <= most:
            return found
    return found[:: math.ceil(len(found) / most)]


def scales(panel: Panel, box: Box) -> tuple[Scale, Scale]:
    """The two axes of a panel in its rectangle."""
    extents = [_extent(mark) for mark in panel.marks]
    x = _ends(panel.x, (e[0] for e in extents))
    y = _ends(panel.y, (e[1] for e in extents))
    if panel.equal:
        unit = max((x[1] - x[0]) / box.w, (y[1] - y[0]) / box.h)
        x, y = _wider(x, unit * box.w), _wider(y, unit * box.h)
    right, top = (box.x, box.x + box.w), (box.y + box.h, box.y)
    return (
        Scale(*x, *(right[::-1] if panel.x.flipped else right), panel.x),
        Scale(*y, *(top[::-1] if panel.y.flipped else top), panel.y),
    )


def _wider(ends: tuple[float, float], width: float) -> tuple[float, float]:
    middle = 0.5 * (ends[0] + ends[1])
    return middle - width / 2, middle + width / 2


def _ends(axis: Axis, values: Iterable[Array]) -> tuple[float, float]:
    """The ends of an axis: as stated, or of the marks with some room."""
    own = np.concatenate([np.ravel(v) for v in values] or [np.zeros(0)])
    own = own[np.isfinite(own)]
    if axis.log:
        logs = np.log(own[own > 0])
        ends = _with_room(replace(axis, low=_log(axis.low), high=_log(axis.high)), logs)
        return math.exp(ends[0]), math.exp(ends[1])
    return _with_room(axis, own)


def _log(value: float | None) -> float | None:
    return None if value is None else math.log(value)


def _with_room(axis: Axis, own: Array) -> tuple[float, float]:
    low = float(own.min()) if axis.low is None and own.size else axis.low or 0.0
    high = float(own.max()) if axis.high is None and own.size else axis.high if axis.high is not None else low + 1.0
    width = high - low
    if width <= 1e-12 * max(abs(low), abs(high), 1e-300):
        half = 0.5 * abs(low) or 1.0
        return low - half, high + half
    return (low - ROOM * width if axis.low is None else low), (high + ROOM * width if axis.high is None else high)


NO_VALUES: Array = np.zeros(0)


@singledispatch
def _extent(mark: Mark) -> tuple[Array, Array]:
    """The values of a mark that both axes have to hold."""
    raise TypeError(f"no mark: {type(mark).__name__}")


@_extent.register
def _(mark: Line) -> tuple[Array, Array]:
    return np.asarray(mark.x, float), np.asarray(mark.y, float)


@_extent.register
def _(mark: Points) -> tuple[Array, Array]:
    y = np.asarray(mark.y, float)
    return np.asarray(mark.x, float), y if mark.error is None else np.r_[y - mark.error, y + mark.error]


@_extent.register
def _(mark: Band) -> tuple[Array, Array]:
    return np.asarray(mark.x, float), np.r_[mark.low, mark.high]


@_extent.register
def _(mark: Bars) -> tuple[Array, Array]:
    return np.asarray(mark.lengths, float), np.array([-0.5, len(mark.lengths) - 0.5])


@_extent.register
def _(mark: Level) -> tuple[Array, Array]:
    return (np.array([mark.at]), NO_VALUES) if mark.axis == "x" else (NO_VALUES, np.array([mark.at]))


@_extent.register
def _(mark: Span) -> tuple[Array, Array]:
    return np.array([mark.low, mark.high]), NO_VALUES


@_extent.register
def _(mark: Label) -> tuple[Array, Array]:
    if mark.x is None or mark.y is None:
        return NO_VALUES, NO_VALUES
    return np.array([mark.x]), np.array([mark.y])


@_extent.register
def _(mark: Cells) -> tuple[Array, Array]:
    rows, columns = np.shape(mark.values)
    return np.array([-0.5, columns - 0.5]), np.array([-0.5, rows - 0.5])


@_extent.register
def _(mark: Segments) -> tuple[Array, Array]:
    both = np.concatenate([mark.start, mark.end])
    return both[:, 0], both[:, 1]
