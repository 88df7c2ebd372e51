"""Draws single marks as SVG elements, and their signs in a legend."""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch
from html import escape

import numpy as np
import numpy.typing as npt

from clampid.charts.marks import Array, Band, Bars, Cells, Label, Level, Line, Mark, Points, Segments, Span
from clampid.charts.scale import MINUS, Box, Scale

__all__ = ["drawn", "key_of", "pieces", "shape"]

Bools = npt.NDArray[np.bool_]

LINE_HEIGHT = 15.0  # pixels
THICKNESS = 0.6  # of a bar, of the distance of two


def pieces(x: Array, *ys: Array) -> list[npt.NDArray[np.int64]]:
    """Runs of neighbouring indices at which all are finite."""
    good = np.flatnonzero(np.isfinite(x) & np.all([np.isfinite(y) for y in ys], axis=0))
    return [run for run in np.split(good, np.flatnonzero(np.diff(good) > 1) + 1) if len(run)]


def _n(value: float) -> str:
    """A coordinate: a tenth of a pixel."""
    return f"{value:.1f}".removesuffix(".0")


def _polyline(x: Array, y: Array) -> str:
    return "M" + "L".join(f"{_n(a)} {_n(b)}" for a, b in zip(x.tolist(), y.tolist(), strict=True))


@singledispatch
def drawn(mark: Mark, x: Scale, y: Scale, box: Box) -> str:
    """One mark as SVG elements."""
    raise TypeError(f"no mark: {type(mark).__name__}")


@singledispatch
def key_of(mark: Mark) -> str:
    """A mark's sign in a legend, from (0, 0) to (28, 0)."""
    return ""


@drawn.register
def _(mark: Line, x: Scale, y: Scale, box: Box) -> str:
    px, py = x(mark.x), y(mark.y)
    out = []
    if mark.width > 0:
        paths = [_path(px[run], py[run], mark.steps) for run in pieces(px, py)]
        out.append(f'<path {_stroke(mark)} d="{"".join(paths)}"/>')
    if mark.symbol:
        good = np.isfinite(px) & np.isfinite(py)
        tips = _of_shown(mark.tips, good)
        out.append(_symbols(px[good], py[good], mark.symbol, mark.symbol_size, mark.color, tips))
    return "".join(out)


def _path(x: Array, y: Array, steps: bool) -> str:
    if steps:
        edge = np.r_[x[0], 0.5 * (x[1:] + x[:-1]), x[-1]]
        x, y = np.repeat(edge, 2)[1:-1], np.repeat(y, 2)
    return _polyline(x, y)


def _stroke(mark: Line) -> str:
    dash = f' stroke-dasharray="{mark.dash}"' if mark.dash else ""
    return f'class="l {mark.color}" stroke-width="{mark.width:g}"{dash}'


@key_of.register
def _(mark: Line) -> str:
    line = f'<path {_stroke(mark)} d="M0 0H28"/>' if mark.width > 0 else ""
    return line + (
        _symbols(np.array([14.0]), np.zeros(1), mark.symbol, mark.symbol_size, mark.color) if mark.symbol else ""
    )


@drawn.register
def _(mark: Points, x: Scale, y: Scale, box: Box) -> str:
    px, py = x(mark.x), y(mark.y)
    good = np.isfinite(px) & np.isfinite(py)
    bars = ""
    if mark.error is not None:
        low, high = y(np.asarray(mark.y) - mark.error)[good], y(np.asarray(mark.y) + mark.error)[good]
        d = "".join(
            f"M{_n(a)} {_n(b)}V{_n(c)}m-3 0h6M{_n(a - 3)} {_n(b)}h6"
            for a, b, c in zip(px[good].tolist(), low.tolist(), high.tolist(), strict=True)
        )
        bars = f'<path class="l {mark.color}" stroke-width="1" d="{d}"/>'
    tips = _of_shown(mark.tips, good)
    return bars + _symbols(px[good], py[good], mark.symbol, mark.size, mark.color, tips, mark.opacity)


@key_of.register
def _(mark: Points) -> str:
    return _symbols(np.array([14.0]), np.zeros(1), mark.symbol, max(mark.size, 5.0), mark.color)


def _of_shown(tips: Sequence[str], shown: Bools) -> Sequence[str]:
    """The tips of the points that are shown; one for all stays one."""
    return [t for t, ok in zip(tips, shown, strict=True) if ok] if len(tips) > 1 else tips


def _symbols(
    x: Array, y: Array, symbol: str, size: float, color: str, tips: Sequence[str] = (), opacity: float = 1.0
) -> str:
    """Points: one path for all, or an element for each where each has a tip."""
    kind, outline = shape(symbol, size)
    faint = f' stroke-opacity="{opacity:g}"' if opacity < 1.0 else ""
    looks = kind.format(color) + faint
    places = [f"M{_n(a)} {_n(b)}{outline}" for a, b in zip(x.tolist(), y.tolist(), strict=True)]
    if len(tips) > 1:
        return "".join(_path_with(looks, place, tip) for place, tip in zip(places, tips, strict=True))
    return _path_with(looks, "".join(places), tips[0] if tips else "")


def _path_with(looks: str, d: str, tip: str) -> str:
    return f'<path {looks} d="{d}">{f"<title>{escape(tip)}</title>" if tip else ""}</path>'


def shape(symbol: str, size: float) -> tuple[str, str]:
    """A symbol's attributes, with ``{}`` for the colour, and its outline from its middle."""
    h = size / 2
    if symbol == "circle":
        return f'class="p {{}}" stroke-width="{size:g}"', "h0"
    if symbol == "cross":
        return 'class="p {}" stroke-width="1.5"', f"m{-h:g} {-h:g}l{size:g} {size:g}m0 {-size:g}l{-size:g} {size:g}"
    if symbol == "square":
        return 'class="f {}"', f"m{-h:g} {-h:g}h{size:g}v{size:g}h{-size:g}z"
    if symbol == "diamond":
        return 'class="o {}"', f"m0 {-h:g}l{h:g} {h:g}l{-h:g} {h:g}l{-h:g} {-h:g}z"
    if symbol == "ring":
        return 'class="o {}"', f"m{-h:g} 0a{h:g} {h:g} 0 1 0 {size:g} 0a{h:g} {h:g} 0 1 0 {-size:g} 0z"
    raise ValueError(f"symbol {symbol!r}: expected circle, cross, square, diamond or ring")


@drawn.register
def _(mark: Band, x: Scale, y: Scale, box: Box) -> str:
    px, low, high = x(mark.x), y(mark.low), y(mark.high)
    d = [
        _polyline(np.r_[px[run], px[run][::-1]], np.r_[high[run], low[run][::-1]]) + "z"
        for run in pieces(px, low, high)
    ]
    return f'<path class="band {mark.color}" d="{"".join(d)}"/>'


@key_of.register
def _(mark: Band) -> str:
    return f'<path class="band {mark.color}" d="M0 -6H28V6H0z"/>'


@drawn.register
def _(mark: Bars, x: Scale, y: Scale, box: Box) -> str:
    out = []
    for k, (length, color) in enumerate(zip(np.asarray(mark.lengths).tolist(), mark.colors, strict=True)):
        if not np.isfinite(length):
            continue
        top, foot = sorted(y([k - THICKNESS / 2, k + THICKNESS / 2]).tolist())
        tip = f"<title>{escape(mark.tips[k])}</title>" if mark.tips else ""
        left = box.x if x.axis.log else float(x(0.0))
        out.append(
            f'<path class="f {color}" fill-opacity=".8" d="M{_n(left)} {_n(top)}H{_n(float(x(length)))}V{_n(foot)}'
            f'H{_n(left)}z">{tip}</path>'
        )
    return "".join(out)


@key_of.register
def _(mark: Bars) -> str:
    return f'<path class="f {mark.colors[0]}" fill-opacity=".8" d="M0 -5H28V5H0z"/>' if mark.colors else ""


@drawn.register
def _(mark: Level, x: Scale, y: Scale, box: Box) -> str:
    d = f"M{_n(float(x(mark.at)))} {_n(box.y)}v{_n(box.h)}" if mark.axis == "x" else ""
    d = d or f"M{_n(box.x)} {_n(float(y(mark.at)))}h{_n(box.w)}"
    return f'<path class="l {mark.color}" stroke-width="1.4" stroke-dasharray="{mark.dash}" d="{d}"/>'


@key_of.register
def _(mark: Level) -> str:
    return f'<path class="l {mark.color}" stroke-width="1.4" stroke-dasharray="{mark.dash}" d="M0 0H28"/>'


@drawn.register
def _(mark: Span, x: Scale, y: Scale, box: Box) -> str:
    a, b = sorted(x([mark.low, mark.high]).tolist())
    return f'<path class="band {mark.color}" d="M{_n(a)} {_n(box.y)}H{_n(b)}v{_n(box.h)}H{_n(a)}z"/>'


@drawn.register
def _(mark: Label, x: Scale, y: Scale, box: Box) -> str:
    anchor = {"middle": " middle", "end": " end"}.get(mark.anchor, "")
    left, top = box.x + 8, box.y + 15
    if mark.x is not None and mark.y is not None:
        left, top = float(x(mark.x)), float(y(mark.y)) + 4
    else:
        anchor = ""
    return "".join(
        f'<text class="halo tick{anchor} {mark.color}" style="fill: var(--c)" x="{_n(left)}" '
        f'y="{_n(top + LINE_HEIGHT * k)}">{escape(text)}</text>'
        for k, text in enumerate(mark.lines)
    )


@drawn.register
def _(mark: Cells, x: Scale, y: Scale, box: Box) -> str:
    out = []
    for r, row in enumerate(np.asarray(mark.values).tolist()):
        for c, value in enumerate(row):
            px, py = x([c - 0.5, c + 0.5]), y([r - 0.5, r + 0.5])
            left, right, top, foot = *sorted(px.tolist()), *sorted(py.tolist())
            color = "blue" if value > 0 else "orange"
            tip = f"<title>{escape(mark.tips[r][c])}</title>" if mark.tips else ""
            out.append(
                f'<path class="f {color}" fill-opacity="{min(abs(value), 1.0) * 0.75:.2f}" d="M{_n(left + 1)} '
                f'{_n(top + 1)}H{_n(right - 1)}V{_n(foot - 1)}H{_n(left + 1)}z">{tip}</path><text class="middle" '
                f'pointer-events="none" x="{_n((left + right) / 2)}" y="{_n((top + foot) / 2 + 4)}">'
                f"{escape(mark.texts[r][c].replace('-', MINUS))}</text>"
            )
    return "".join(out)


@drawn.register
def _(mark: Segments, x: Scale, y: Scale, box: Box) -> str:
    a, b = np.c_[x(mark.start[:, 0]), y(mark.start[:, 1])], np.c_[x(mark.end[:, 0]), y(mark.end[:, 1])]
    d = "".join(f"M{_n(p[0])} {_n(p[1])}L{_n(q[0])} {_n(q[1])}" for p, q in zip(a.tolist(), b.tolist(), strict=True))
    return f'<path class="l {mark.color}" stroke-width="{mark.width:g}" d="{d}"/>'


@key_of.register
def _(mark: Segments) -> str:
    return f'<path class="l {mark.color}" stroke-width="3" d="M0 0H28"/>'
