"""How large the residuals are against what noise alone would give: histogram and normal quantiles."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots
from scipy import stats

from clampid.report.stage_data import StageData
from clampid.report.style import BLUE, GREEN, GREY, ORANGE, Figure, axes, layout

__all__ = ["sizes_figure"]


def sizes_figure(data: StageData) -> Figure:
    """Histogram and normal quantiles of the residual in units of noise."""
    white = data.residual / data.floor.sigma[: data.channels]
    plot = make_subplots(rows=1, cols=2, horizontal_spacing=0.1, subplot_titles=["Histogram", "Quantiles"])
    parts = [("rows fitted", BLUE, ~data.held), ("rows held out", ORANGE, data.held)]
    everything = white[data.good]
    reach = float(np.clip(np.quantile(np.abs(everything), 0.998), 4.0, 40.0)) if everything.size else 4.0
    edges = np.linspace(-reach, reach, 61)
    for name, color, rows in parts:
        values = np.sort(white[rows][data.good[rows]])
        if len(values) < 5:
            continue
        count, _ = np.histogram(values, edges)
        density = count / (len(values) * (edges[1] - edges[0]))
        plot.add_trace(
            go.Scatter(
                x=0.5 * (edges[1:] + edges[:-1]),
                y=density,
                mode="lines",
                line={"color": color, "shape": "hvh", "width": 1.5},
                name=name,
                legendgroup=name,
            ),
            1,
            1,
        )
        share = (np.arange(len(values)) + 0.5) / len(values)
        pick = np.unique(np.clip(stats.norm.cdf(np.linspace(-4, 4, 200)) * len(values), 0, len(values) - 1).astype(int))
        plot.add_trace(
            go.Scatter(
                x=stats.norm.ppf(share[pick]),
                y=values[pick],
                mode="markers",
                marker={"color": color, "size": 4},
                name=name,
                legendgroup=name,
                showlegend=False,
                hovertemplate="noise alone %{x:.2f}, found %{y:.2f}<extra></extra>",
            ),
            1,
            2,
        )
    grid = np.linspace(-reach, reach, 201)
    dashed = {"color": GREEN, "dash": "dash", "width": 1.5}
    plot.add_trace(go.Scatter(x=grid, y=stats.norm.pdf(grid), mode="lines", line=dashed, name="noise alone"), 1, 1)
    plot.add_trace(
        go.Scatter(x=[-4, 4], y=[-4, 4], mode="lines", line=dashed, showlegend=False, hoverinfo="skip"), 1, 2
    )
    plot.update_xaxes(axes(title="residual, units of noise (σ)"), row=1, col=1)
    plot.update_yaxes(axes(title="density"), row=1, col=1)
    plot.update_xaxes(axes(title="quantile of a normal distribution"), row=1, col=2)
    plot.update_yaxes(axes(title="quantile of the residual, σ", range=[-reach, reach]), row=1, col=2)
    plot.update_layout(layout(340, margin={"l": 64, "r": 16, "t": 70, "b": 52}))
    for note in plot.layout.annotations:
        note.font = {"size": 12, "color": GREY}
    source = {"replicates": "returns to the same pose", "instrument": "what the instrument's maker states"}
    origin = source.get(data.floor.source, "how the log scatters from row to row")
    what = "coordinates" if data.stage == "poses" else "torques"
    caption = f"Single {what} of the residual in units of the noise, which is known from {origin}."
    return Figure(f"sizes-{data.stage}", plot, caption, 340)
