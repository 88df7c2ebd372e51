"""Residuals against a variable that the reader chooses: what the page's script needs to draw each of them."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from clampid.charts import Chart, Panel, Points
from clampid.charts.draw import shape
from clampid.charts.marks import Array
from clampid.charts.scale import Box, scales
from clampid.charts.svg import local, over, parts, placed, x_frame
from clampid.report.style import Selector

__all__ = ["NOT_DRAWN", "TENTHS", "selector"]

TENTHS = 10.0  # of a pixel are the packed numbers
NOT_DRAWN = 65535  # of a point that is not drawn


def selector(names: Sequence[str], charts: Sequence[Chart]) -> Selector:
    """A figure's choices from its charts, one for each name.

    The charts differ in their x axis alone. Each panel's first points are those fitted, held out and rejected.
    """
    first = placed(charts[0])
    kinds = _points(first[0][0])
    counts = np.cumsum([len(points.x) for points in kinds])
    outlines = [shape(points.symbol, points.size)[1] for points in kinds]
    return Selector(
        tuple(names),
        tuple(_choice(chart) for chart in charts),
        tuple(_packed(_pixels(panel, box)[1]) for panel, box in first),
        (int(counts[0]), int(counts[1])),
        (outlines[0], outlines[1], outlines[2]),
    )


def _points(panel: Panel) -> list[Points]:
    return [mark for mark in parts(panel)[1] if isinstance(mark, Points)]


def _pixels(panel: Panel, box: Box) -> tuple[Array, Array]:
    """Where a panel's points are drawn ``(N,)``, pixels from its upper left corner."""
    x, y = scales(panel, local(box))
    kinds = _points(panel)
    return np.concatenate([x(p.x) for p in kinds]), np.concatenate([y(p.y) for p in kinds])


def _choice(chart: Chart) -> Mapping[str, Any]:
    """One variable: packed x of the points, ticks, and what is drawn over the points; for each panel, or for all."""
    panels = placed(chart)
    return {
        "below": chart.below,
        "x": _once([_packed(_pixels(panel, box)[0]) for panel, box in panels]),
        "across": _once([x_frame(panel, box) for panel, box in panels]),
        "over": [over(panel, box) for panel, box in panels],
    }


def _once(each: list[str]) -> list[str]:
    """What all panels share."""
    return each[:1] if len(set(each)) == 1 else each


def _packed(pixels: Array) -> str:
    """Pixels as base64 of little-endian 16-bit tenths."""
    tenths = np.where(np.isfinite(pixels), np.clip(np.round(TENTHS * pixels), 0, NOT_DRAWN - 1), NOT_DRAWN)
    return base64.b64encode(tenths.astype("<u2").tobytes()).decode("ascii")
