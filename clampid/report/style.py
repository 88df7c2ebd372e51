"""How the report looks: figures, tables and colours that a colour-blind reader and a printer can follow."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go

__all__ = [
    "BLUE",
    "GREEN",
    "GREY",
    "INK",
    "LIGHT",
    "ORANGE",
    "Figure",
    "Section",
    "Selector",
    "Table",
    "Weak",
    "axes",
    "layout",
    "packed",
    "thin",
]

# Okabe and Ito's colours.
BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"
INK, GREY, LIGHT = "#222222", "#767676", "#d9d9d9"
FONT = "Inter, 'Helvetica Neue', Helvetica, Arial, sans-serif"


class Weak(str):
    """A cell whose number is not told from zero, set in grey."""


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
class Selector:
    """A variable against which the reader can plot a figure's points.

    Attributes
    ----------
    names
        What can be chosen.
    variables
        For each name what the page's script needs: axis title, packed x per channel, medians and bands.
    values
        For each panel its residuals, packed.
    ends
        Where the points that were fitted end, and those held out; the rest was rejected.
    """

    names: tuple[str, ...]
    variables: tuple[Mapping[str, Any], ...]
    values: tuple[Mapping[str, str], ...]
    ends: tuple[int, int]


@dataclass(frozen=True)
class Figure:
    """A plotly figure with a caption, and perhaps a variable to choose."""

    key: str
    plot: Any
    caption: str
    height: int = 420
    selector: Selector | None = None


@dataclass(frozen=True)
class Section:
    """One section of the page: paragraphs, then headings (text), tables and figures in order, then notes."""

    key: str
    title: str
    paragraphs: tuple[str, ...] = ()
    blocks: tuple[str | Table | Figure, ...] = ()
    notes: tuple[str, ...] = ()
    notes_title: str = ""


def axes(**extra: Any) -> dict[str, Any]:
    """An axis with a thin frame and a light grid."""
    line = {"showline": True, "linecolor": GREY, "linewidth": 1, "ticks": "outside", "ticklen": 4, "tickcolor": GREY}
    return {**line, "gridcolor": "#ececec", "zeroline": False, "automargin": True, **extra}


def layout(height: int, **extra: Any) -> dict[str, Any]:
    """A figure's layout: white, small type, legend above."""
    legend = {"orientation": "h", "x": 0.0, "xanchor": "left", "y": 1.0, "yanchor": "bottom", "yref": "container"}
    return {
        "template": go.layout.Template(),
        "height": height,
        "font": {"family": FONT, "size": 12, "color": INK},
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "margin": {"l": 64, "r": 16, "t": 44, "b": 52},
        "legend": {**legend, "y": 0.995, "yanchor": "top"},
        "hoverlabel": {"font": {"family": FONT}},
        **extra,
    }


def packed(values: Any) -> str:
    """Numbers as base64 of little-endian float32: the page's script unpacks them."""
    return base64.b64encode(np.asarray(values, dtype="<f4").tobytes()).decode("ascii")


def thin(count: int, limit: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """At most ``limit`` of ``count`` indices, evenly spread, ends included."""
    if count <= limit:
        return np.arange(count, dtype=np.int64)
    return np.unique(np.linspace(0, count - 1, limit).round().astype(np.int64))


def as_table(columns: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> Table:
    """A table from any sequences."""
    return Table(tuple(columns), tuple(tuple(row) for row in rows), caption)
