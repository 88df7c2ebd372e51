"""How large the residuals are against what noise alone would give: histogram and normal quantiles."""

from __future__ import annotations

import numpy as np
from scipy import stats

from clampid.charts import Axis, Chart, Line, Mark, Panel, Points
from clampid.report.stage_data import StageData
from clampid.report.style import Figure

__all__ = ["sizes_figure"]


def sizes_figure(data: StageData) -> Figure:
    """Histogram and normal quantiles of the residual in units of noise."""
    white = data.residual / data.floor.sigma[: data.channels]
    parts = [("rows fitted", "blue", ~data.held_out), ("rows held out", "orange", data.held_out)]
    everything = white[data.good]
    reach = float(np.clip(np.quantile(np.abs(everything), 0.998), 4.0, 40.0)) if everything.size else 4.0
    edges = np.linspace(-reach, reach, 61)
    grid = np.linspace(-reach, reach, 201)
    histogram: list[Mark] = []
    quantiles: list[Mark] = []
    for name, color, rows in parts:
        values = np.sort(white[rows][data.good[rows]])
        if len(values) < 5:
            continue
        count, _ = np.histogram(values, edges)
        density = count / (len(values) * (edges[1] - edges[0]))
        histogram.append(Line(0.5 * (edges[1:] + edges[:-1]), density, name, color, 1.5, steps=True))
        share = (np.arange(len(values)) + 0.5) / len(values)
        pick = np.unique(np.clip(stats.norm.cdf(np.linspace(-4, 4, 200)) * len(values), 0, len(values) - 1).astype(int))
        quantiles.append(Points(stats.norm.ppf(share[pick]), values[pick], name, color))
    histogram.append(Line(grid, stats.norm.pdf(grid), "noise alone", "green", dash="6 4"))
    quantiles.append(Line(np.array([-4.0, 4.0]), np.array([-4.0, 4.0]), "noise alone", "green", dash="6 4"))
    up = Axis("quantile of the residual, σ", -reach, reach)
    panels = (
        Panel(tuple(histogram), Axis("residual, units of noise (σ)", -reach, reach), Axis("density, 1/σ", 0.0)),
        Panel(tuple(quantiles), Axis("quantile of a normal distribution, σ", -4.2, 4.2), up),
    )
    source = {
        "replicates": "returns to the same pose",
        "instrument": "what the instrument's maker states",
        "repeated_runs": "runs of the same motion",
        "regression": "a regression on rigid-body dynamics and friction",
    }
    origin = source.get(data.floor.source, "how the log scatters from row to row")
    what = "coordinates" if data.kind.points else "torques"
    caption = f"Single {what} of the residual in units of the noise, which is known from {origin}."
    return Figure(f"sizes-{data.stage}", Chart(panels, 340), caption)
