"""A grid of panels, one for each motor or joint."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from clampid.report.style import axes, layout

__all__ = ["finish", "grid", "place_of"]


def grid(panels: int, titles: list[str]) -> go.Figure:
    """An empty figure of at most three panels a row."""
    across = 3 if panels > 2 else panels
    down = int(np.ceil(panels / across))
    return make_subplots(rows=down, cols=across, subplot_titles=titles, horizontal_spacing=0.07, vertical_spacing=0.13)


def finish(plot: go.Figure, panels: int, height: int, x: str, y: str) -> go.Figure:
    """Axes, with one title below all panels and one at the left of each row, and layout."""
    across = 3 if panels > 2 else panels
    plot.update_xaxes(axes())
    plot.update_yaxes(axes())
    for k in range(panels):
        row, column = k // across + 1, k % across + 1
        if column == 1:
            plot.update_yaxes(title=y, row=row, col=column)
    plot.update_layout(layout(height, margin={"l": 64, "r": 16, "t": 74, "b": 52}))
    for note in plot.layout.annotations[:panels]:
        note.font = {"size": 12}
    below = {"xref": "paper", "yref": "paper", "x": 0.5, "y": 0.0, "xanchor": "center", "yanchor": "top", "yshift": -24}
    looks = {"showarrow": False, "font": {"size": 14}}
    plot.add_annotation(text=x, **looks, **below)  # panels are narrower than what their axis says
    return plot


def place_of(k: int, panels: int) -> tuple[int, int]:
    """Row and column, from 1, of panel ``k``."""
    across = 3 if panels > 2 else panels
    return k // across + 1, k % across + 1
