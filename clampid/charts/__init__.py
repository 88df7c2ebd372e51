"""Figures as SVG: panels of points, lines, bands, bars and cells, drawn without a plotting library.

A figure of the report is a :class:`Chart`. :func:`clampid.charts.svg.svg` draws it. Colours are names; the style sheet
:data:`clampid.charts.style.STYLE` gives each a value for light and for dark pages, so that a figure follows the page.
"""

from clampid.charts.chart import Chart
from clampid.charts.marks import Axis, Band, Bars, Cells, Label, Level, Line, Mark, Panel, Points, Segments, Span, thin

__all__ = [
    "Axis",
    "Band",
    "Bars",
    "Cells",
    "Chart",
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
