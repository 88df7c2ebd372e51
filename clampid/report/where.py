"""Where it fails: residuals against every recorded variable, and their size against what noise alone would give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from clampid.display import number
from clampid.effect import Stage
from clampid.report.sizes import sizes_figure
from clampid.report.stage_data import StageData, stage_title
from clampid.report.style import (
    BLUE,
    GREEN,
    INK,
    ORANGE,
    Figure,
    Section,
    Selector,
    as_table,
    axes,
    layout,
    packed,
)
from clampid.report.variables import Variable, explained, trend, variables_of
from clampid.stages.rows import Array, Integers

__all__ = ["where_section"]

MOST_POINTS = 1200  # of torque logs, per motor
MOST_ROWS = 3000
LISTED = 6
EDGE = 0.97  # of an axis


def where_section(stages: Mapping[Stage, StageData], seed: int) -> Section | None:
    """Section "Where it fails"."""
    blocks: list[Any] = []
    for stage, data in stages.items():
        variables = variables_of(data)
        if not variables or not data.good.any():
            continue
        shares, chance = explained(data, variables, seed)
        order = sorted(range(len(variables)), key=lambda k: -shares[k])
        rows = [(variables[k].title, _percent(shares[k]), _percent(chance)) for k in order[:LISTED]]
        blocks.append(stage_title(stage))
        blocks.append(
            as_table(
                ("Residual against", "Explained#", "Chance gives up to#"),
                rows,
                _beyond(shares, chance),
            )
        )
        blocks.append(_against(data, variables, order))
        blocks.append(sizes_figure(data))
    return Section("where", "Where it fails", (), tuple(blocks)) if blocks else None


def _beyond(shares: Sequence[float], chance: float) -> str:
    """What the shares say, and what a structure beyond chance amounts to."""
    beyond, largest = sum(s > chance for s in shares), max(shares)
    text = (
        "Share of the residual's variance that a running mean along one variable explains: the "
        f"{min(LISTED, len(shares))} largest of {len(shares)}, {beyond or 'none'} beyond what chance gives to the "
        "largest of them (95 %, signs flipped unit by unit)."
    )
    if beyond:
        text += (
            " Beyond chance need not be large: all that goes with the first is "
            f"{_percent(1.0 - np.sqrt(1.0 - largest))} of the RMS error. The verdict asks more: that a known effect or "
            "a curve over a variable, makes rows that no fit saw more predictable. Noise that goes on for a while, as "
            "in logs, does not. So it may be “adequate”."
        )
    return text


def _percent(share: float) -> str:
    return f"{number(100 * share, 2)} %"


def _chosen(data: StageData) -> list[Integers]:
    """Rows drawn: those fitted, held out and rejected; the first two thinned evenly where there are too many."""
    usable = data.good.any(axis=1)
    limit = MOST_ROWS if data.stage == "poses" else MOST_POINTS
    step = max(1, int(np.ceil(usable.sum() / limit)))
    kept = [np.flatnonzero(usable & (data.held == held))[::step] for held in (False, True)]
    return [*kept, np.flatnonzero(data.rejected.any(axis=1))]


def _panels(data: StageData) -> tuple[list[str], float, str]:
    if data.stage == "poses":
        return [f"{a} (instrument's frame)" for a in "xyz"], 1e6, "µm"
    return [f"motor {k + 1}" for k in range(data.channels)], 1.0, "Nm"


def _against(data: StageData, variables: Sequence[Variable], order: Sequence[int]) -> Figure:
    titles, factor, unit = _panels(data)
    across = 3
    down = int(np.ceil(len(titles) / across))
    plot = make_subplots(rows=down, cols=across, subplot_titles=titles, horizontal_spacing=0.07, vertical_spacing=0.16)
    kinds = _chosen(data)
    drawn, ends = np.concatenate(kinds), np.cumsum([len(rows) for rows in kinds])
    fitted, kept = int(ends[0]), int(ends[1])
    residual, good = data.residual * factor, data.good
    rejected = data.rejected[drawn]
    first = variables[order[0]]
    values: list[dict[str, str]] = []
    for c in range(len(titles)):
        row, column = c // across + 1, c % across + 1
        y = np.where(good[drawn, c] | rejected[:, c], residual[drawn, c], np.nan)
        level = float(data.floor.sigma[c]) * factor
        shown = y[:kept]
        spread = float(np.nanquantile(np.abs(shown), 0.995)) if np.isfinite(shown).any() else level
        limit = 1.15 * max(spread, 1.5 * level)
        y[kept:] = np.clip(y[kept:], -EDGE * limit, EDGE * limit)  # far off, they stand at the edge
        values.append({"y": packed(y)})
        line = trend(first.of(c), residual[:, c], good[:, c])
        around = line.band()
        band = go.Scatter(
            x=around[0],
            y=around[1],
            fill="toself",
            fillcolor="rgba(90,90,90,0.28)",
            line={"width": 0},
            mode="lines",
            name="middle half",
            hoverinfo="skip",
            showlegend=c == 0,
            legendgroup="band",
        )
        median = go.Scatter(
            x=line.x,
            y=line.median,
            mode="lines+markers",
            line={"color": INK, "width": 2},
            marker={"size": 4},
            name="running median",
            showlegend=c == 0,
            legendgroup="median",
            hoverinfo="skip",
        )
        x = first.of(c)[drawn]
        points = [
            _points(x[:fitted], y[:fitted], "rows fitted", BLUE, c == 0),
            _points(x[fitted:kept], y[fitted:kept], "rows held out", ORANGE, c == 0 and fitted < kept),
            _points(x[kept:], y[kept:], "rows rejected", INK, c == 0 and kept < len(drawn), "x"),
        ]
        for trace in (*points, band, median):
            plot.add_trace(trace, row, column)
        for sign in (-1, 1):
            line_style = {"color": GREEN, "width": 1, "dash": "dash"}
            plot.add_hline(y=sign * level, line=line_style, row=row, col=column)
        plot.update_yaxes(
            axes(range=[-limit, limit], title=f"residual, {unit}" if column == 1 else None), row=row, col=column
        )
    plot.update_xaxes(axes())
    for column in range(1, across + 1):
        plot.update_xaxes(title=first.title, row=down, col=column)
    height = 360 if down == 1 else 560
    plot.update_layout(layout(height, margin={"l": 64, "r": 16, "t": 74, "b": 52}))
    for note in plot.layout.annotations:
        note.font = {"size": 12}
    listed = [variables[k] for k in order]
    selector = Selector(
        tuple(v.title for v in listed),
        tuple(_choice(v, data, residual, drawn, len(titles)) for v in listed),
        tuple(values),
        (fitted, kept),
    )
    thinned = (
        f" {kept} of {int(good.any(axis=1).sum())} rows are drawn; medians are over all."
        if kept < good.any(axis=1).sum()
        else ""
    )
    crossed = len(drawn) - kept
    left_out = (
        f" Crosses: the {crossed} rows rejected as outliers; those beyond the axis stand at its edge. "
        "No line counts them."
        if crossed
        else ""
    )
    caption = (
        "Measured less predicted, against the variable chosen above the figure (sorted by what "
        f"it explains). Dashed: ± 1 σ of what noise alone leaves.{left_out}{thinned}"
    )
    return Figure(f"against-{data.stage}", plot, caption, height, selector)


def _points(x: Array, y: Array, name: str, color: str, show: bool, symbol: str = "circle") -> go.Scatter:
    wide = {"size": 7, "opacity": 0.9} if symbol != "circle" else {"size": 4, "opacity": 0.45}
    marker = {"color": color, "symbol": symbol, **wide}
    return go.Scatter(
        x=np.asarray(x, dtype=np.float32),
        y=np.asarray(y, dtype=np.float32),
        mode="markers",
        marker=marker,
        name=name,
        legendgroup=name,
        showlegend=show,
        hovertemplate="%{x:.4g}, %{y:.4g}<extra></extra>",
    )


def _choice(variable: Variable, data: StageData, residual: Array, drawn: Integers, channels: int) -> Mapping[str, Any]:
    """What the page's script needs to draw one variable."""
    several = variable.values.ndim == 2
    rng = np.random.default_rng(0)
    few = len(np.unique(variable.values[np.isfinite(variable.values)])) <= 8
    shake = rng.uniform(-0.12, 0.12, len(drawn)) if few else np.zeros(len(drawn))
    lines = [trend(variable.of(c), residual[:, c], data.good[:, c]) for c in range(channels)]
    return {
        "title": variable.title,
        "labels": list(variable.labels),
        "x": [packed(variable.of(c)[drawn] + shake) for c in range(channels if several else 1)],
        "trend": [
            {"x": packed(t.x), "y": packed(t.median), "around": [packed(side) for side in t.band()]} for t in lines
        ],
    }
