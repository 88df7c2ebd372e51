"""Draws a chart as SVG: frames and ticks, the marks of each panel, and one legend above them."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

from clampid.charts.draw import drawn, key_of
from clampid.charts.marks import Line, Mark, Panel, Points
from clampid.charts.scale import APART_X, APART_Y, Box, Scale, scales
from clampid.charts.style import STYLE

if TYPE_CHECKING:
    from clampid.charts.chart import Chart

__all__ = ["WIDTH", "boxes", "local", "over", "parts", "placed", "standalone", "svg", "x_frame"]

WIDTH = 1080.0
RIGHT, GAP = 18.0, 58.0  # pixels right of the last panel, and between panels for the ticks of the next
TITLE, TICKS, AXIS_TITLE, LEGEND = 22.0, 20.0, 20.0, 22.0  # heights of the lines of text about a panel
LETTER = 6.6  # mean width of one, pixels


def svg(chart: Chart, key: str = "", label: str = "") -> str:
    """Draw a chart.

    Parameters
    ----------
    key
        The ``id`` of the drawing in its page.
    label
        What it shows, for readers who do not see it.
    """
    return _drawing(chart, key, label, "")


def standalone(chart: Chart) -> str:
    """A drawing with its style sheet, to stand alone."""
    return _drawing(chart, "", "", f"<style>{STYLE}</style>")


def _drawing(chart: Chart, key: str, label: str, style: str) -> str:
    name = f' id="{escape(key)}"' if key else ""
    role = f' role="img" aria-label="{escape(label)}"' if label else ""
    size = f'viewBox="0 0 {WIDTH:g} {chart.height:g}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" class="chart"{name} {size}{role}>{style}'
    body = [_panel(panel, box) for panel, box in placed(chart) if panel.marks or panel.title]
    if chart.below:
        text = f'<text class="middle below" x="{chart.left + (WIDTH - chart.left) / 2:g}" y="{chart.height - 6:g}">'
        body.append(f"{text}{escape(chart.below)}</text>")
    return "\n".join([head, *_legend(chart), *body, "</svg>"])


def placed(chart: Chart) -> list[tuple[Panel, Box]]:
    """Each panel with its rectangle."""
    return list(zip(chart.panels, boxes(chart), strict=True))


def boxes(chart: Chart) -> list[Box]:
    """The rectangles of the panels, row by row."""
    across = chart.columns
    down = -(-len(chart.panels) // across)
    shared = _shares_y(chart)
    gap = 12.0 if shared else GAP
    wide = (WIDTH - chart.left - RIGHT - (across - 1) * gap) / across
    rows = [chart.panels[r * across : (r + 1) * across] for r in range(down)]
    above = [TITLE if any(p.title for p in row) else 8.0 for row in rows]
    below = [_below(row) for row in rows]
    room = chart.height - _legend_height(chart) - sum(above) - sum(below) - (AXIS_TITLE if chart.below else 0.0)
    shares = chart.heights or (1.0,) * down
    out, y = [], _legend_height(chart)
    for r, row in enumerate(rows):
        tall = room * shares[r] / sum(shares)
        y += above[r]
        out += [Box(chart.left + c * (wide + gap), y, wide, tall) for c in range(len(row))]
        y += tall + below[r]
    return out


def _below(row: Sequence[Panel]) -> float:
    """Room under a row of panels for ticks and titles of their x axes."""
    ticks = TICKS if any(p.x.ticks != () for p in row) else 4.0
    return ticks + (AXIS_TITLE if any(p.x.title for p in row) else 0.0)


def _shares_y(chart: Chart) -> bool:
    """Whether only the first panel of a row has ticks at its left."""
    return len(chart.panels) > 1 and all(p.y.ticks == () for k, p in enumerate(chart.panels) if k % chart.columns)


def _panel(panel: Panel, box: Box) -> str:
    """A panel: its frame, and clipped to it what lies under its first points, these points, and what lies over them."""
    size = f'width="{box.w:.1f}" height="{box.h:.1f}"'
    return (
        f'<g class="panel" transform="translate({box.x:.1f} {box.y:.1f})"><g class="across">{x_frame(panel, box)}</g>'
        f'{_y_frame(panel, box)}<svg {size}>{_drawn(panel, box, 0)}<g class="points">{_drawn(panel, box, 1)}</g>'
        f'<g class="over">{over(panel, box)}</g></svg></g>'
    )


def parts(panel: Panel) -> tuple[list[Mark], list[Mark], list[Mark]]:
    """The marks before the panel's first points, these points, and the marks that follow."""
    kinds = [isinstance(mark, Points) for mark in panel.marks]
    first = kinds.index(True) if True in kinds else len(kinds)
    last = next((k for k in range(first, len(kinds)) if not kinds[k]), len(kinds))
    marks = list(panel.marks)
    return marks[:first], marks[first:last], marks[last:]


def over(panel: Panel, box: Box) -> str:
    """The marks that follow the panel's first points, from the panel's upper left corner."""
    return _drawn(panel, box, 2)


def local(box: Box) -> Box:
    """A panel's rectangle as the panel itself sees it."""
    return Box(0.0, 0.0, box.w, box.h)


def _drawn(panel: Panel, box: Box, part: int) -> str:
    own = local(box)
    x, y = scales(panel, own)
    return "".join(drawn(mark, x, y, own) for mark in parts(panel)[part])


def x_frame(panel: Panel, box: Box) -> str:
    """Grid, ticks and title of the x axis, from the panel's upper left corner."""
    x, _ = scales(panel, local(box))
    places = [(float(x(value)), text) for value, text in _inside(x, x.ticks(APART_X))]
    texts = [_text(at, box.h + 16, text, "tick middle") for at, text in places]
    if panel.x.title:
        texts.append(_text(box.w / 2, box.h + 34, panel.x.title, "middle"))
    grid, marks = (
        "".join(f"M{at:.1f} 0v{box.h:.1f}" for at, _ in places),
        "".join(f"M{at:.1f} {box.h:.1f}v4" for at, _ in places),
    )
    return f'<path class="grid" d="{grid}"/><path class="axis" d="{marks}"/>{"".join(texts)}'


def _y_frame(panel: Panel, box: Box) -> str:
    """Grid, ticks and title of the y axis, the panel's title, and the two axes."""
    _, y = scales(panel, local(box))
    places = [(float(y(value)), text) for value, text in _inside(y, y.ticks(APART_Y))]
    texts = [_text(-8, at + 4, text, "tick end") for at, text in places]
    if panel.title:
        texts.append(_text(box.w / 2, -7, panel.title, "middle"))
    if panel.y.title:
        turned = f'transform="translate(-48 {box.h / 2:.1f}) rotate(-90)"'
        texts.append(f'<text class="middle" {turned}>{escape(panel.y.title)}</text>')
    grid, marks = (
        "".join(f"M0 {at:.1f}h{box.w:.1f}" for at, _ in places),
        "".join(f"M0 {at:.1f}h-4" for at, _ in places),
    )
    corner = f"M0 0V{box.h:.1f}H{box.w:.1f}"
    return f'<path class="grid" d="{grid}"/><path class="axis" d="{marks}{corner}"/>{"".join(texts)}'


def _inside(scale: Scale, ticks: Sequence[tuple[float, str]]) -> list[tuple[float, str]]:
    slack = 1e-6 * abs(scale.high - scale.low)
    return [(v, t) for v, t in ticks if scale.low - slack <= v <= scale.high + slack]


def _text(x: float, y: float, text: str, kind: str) -> str:
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}">{escape(text)}</text>'


def _keys(chart: Chart) -> list[tuple[str, str]]:
    """Name and sign of each series, once each; a line and points of one name share their sign."""
    found: dict[str, str] = {}
    for panel in chart.panels:
        for mark in panel.marks:
            name = getattr(mark, "name", "")
            if not name or (isinstance(mark, Points | Line) and not len(mark.x)):
                continue
            found.setdefault(name, key_of(mark))
    return list(found.items())


def _legend_rows(chart: Chart) -> list[list[tuple[float, str, str]]]:
    """The legend's entries in lines of the chart's width: place, name, sign."""
    rows: list[list[tuple[float, str, str]]] = [[]]
    at = chart.left
    for name, sign in _keys(chart):
        wide = 34 + LETTER * len(name) + 18
        if at + wide > WIDTH and rows[-1]:
            rows.append([])
            at = chart.left
        rows[-1].append((at, name, sign))
        at += wide
    return rows if rows[0] else []


def _legend_height(chart: Chart) -> float:
    return LEGEND * len(_legend_rows(chart))


def _legend(chart: Chart) -> list[str]:
    return [
        f'<g transform="translate({at:.1f} {LEGEND * k + 10:g})">{sign}{_text(34, 4, name, "key")}</g>'
        for k, row in enumerate(_legend_rows(chart))
        for at, name, sign in row
    ]
