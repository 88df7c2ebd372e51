"""Torques: measured and predicted over a stretch of a program, friction against speed, and the clamped loops."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from clampid.effect import Stage
from clampid.report.friction import friction_figures
from clampid.report.loops import loops_figure
from clampid.report.stage_data import StageData
from clampid.report.style import BLUE, GREEN, GREY, Figure, Section, axes, layout, thin
from clampid.stages.rows import Array, Integers

__all__ = ["torque_section"]

STRETCH_S = 60.0
MOST_STRETCH = 700


def torque_section(stages: Mapping[Stage, StageData]) -> Section | None:
    """Section "Torques"; None without torque tables."""
    figures: list[Figure] = []
    free = stages.get("free_air")
    if free is not None and free.good.any():
        figures += [_stretch(free), *friction_figures(free)]
    clamped = stages.get("clamped")
    if clamped is not None and clamped.good.any():
        figures.append(loops_figure(clamped))
    return Section("torque", "Torques", (), tuple(figures)) if figures else None


def _best_stretch(data: StageData) -> Integers:
    """The minute of a run in which most motors move; rows held out are preferred, where there are any."""
    piece = data.first
    run, time = piece.rows.constants["run"], piece.rows.constants["time"]
    wanted = piece.held if piece.held.any() else np.ones(len(run), dtype=bool)
    best, most = np.arange(min(len(run), MOST_STRETCH)), -1.0
    for r in np.unique(run[wanted]):
        rows = np.flatnonzero((run == r) & wanted)
        starts = np.arange(time[rows[0]], time[rows[-1]] + 1e-9, STRETCH_S / 2)
        for start in starts:
            inside = rows[(time[rows] >= start) & (time[rows] < start + STRETCH_S)]
            score = float(piece.good[inside].sum()) if len(inside) else -1.0
            if score > most:
                best, most = inside, score
    return best[thin(len(best), MOST_STRETCH)]


def _stretch(data: StageData) -> Figure:
    """Torque and, below it, what the model leaves of it, motor by motor."""
    piece, motors = data.first, data.channels
    rows = _best_stretch(data)
    time = piece.rows.constants["time"][rows]
    across = min(motors, 3)
    down = int(np.ceil(motors / across))
    titles = [f"motor {k + 1}" for k in range(motors)]
    spread = [titles[across * r + c] if across * r + c < motors else "" for r in range(down) for c in range(across)]
    plot = make_subplots(
        rows=2 * down,
        cols=across,
        row_heights=[3.0, 1.4] * down,
        subplot_titles=[t for r in range(down) for t in (*spread[across * r : across * (r + 1)], *[""] * across)],
        shared_xaxes=True,
        horizontal_spacing=0.07,
        vertical_spacing=0.05,
    )
    measured, residual = piece.rows.measured[rows], piece.residual[rows]
    good = piece.good[rows]
    for k in range(motors):
        torque, below = (2 * (k // across) + 1, k % across + 1), (2 * (k // across) + 2, k % across + 1)
        dots = {"size": 3.5, "color": GREY}
        pale = {"color": BLUE, "width": 1.0, "dash": "dot"}
        predicted = measured[:, k] - residual[:, k]
        left = np.where(good[:, k], residual[:, k], np.nan)
        plot.add_trace(_trace(time, measured[:, k], "measured", k == 0, mode="markers", marker=dots), *torque)
        plot.add_trace(_trace(time, predicted, "model where rows do not count", k == 0, line=pale), *torque)
        solid = np.where(good[:, k], predicted, np.nan)
        plot.add_trace(_trace(time, solid, "model", k == 0, line={"color": BLUE, "width": 1.8}), *torque)
        small = {"size": 2.5, "color": GREY}
        plot.add_trace(_trace(time, left, "residual", k == 0, mode="markers", marker=small), *below)
        level = float(data.floor.sigma[k])
        for sign in (-1, 1):
            plot.add_hline(
                y=sign * level, line={"color": GREEN, "width": 1, "dash": "dash"}, row=below[0], col=below[1]
            )
        reach = max(4.0 * level, 1.1 * float(np.nanmax(np.abs(left))) if np.isfinite(left).any() else 0.0)
        plot.update_yaxes(range=[-reach, reach], row=below[0], col=below[1])
    plot.update_xaxes(axes())
    plot.update_yaxes(axes())
    for r in range(down):
        plot.update_yaxes(title="torque, Nm", row=2 * r + 1, col=1)
        plot.update_yaxes(title="residual, Nm", row=2 * r + 2, col=1)
        plot.update_yaxes(nticks=4, row=2 * r + 2)
    plot.update_xaxes(title="time, s", row=2 * down)
    height = 300 * down + 80
    plot.update_layout(layout(height, margin={"l": 64, "r": 16, "t": 74, "b": 52}))
    for note in plot.layout.annotations:
        note.font = {"size": 12}
    table, run = str(piece.rows.table[rows[0]]), int(piece.rows.constants["run"][rows[0]]) + 1
    kind = "held out" if piece.held[rows].all() else "fitted"
    caption = (
        f"Measured and predicted motor torques over {time[-1] - time[0]:.0f} s of the table {table} (run {run}, from "
        f"{time[0]:.0f} s; rows {kind}), and below them what the model leaves, with ± 1 σ of the noise (dashed). Where "
        "a motor rests, or accelerates harder than the model accounts for, rows do not count (dotted)."
    )
    return Figure("stretch", plot, caption, height)


def _trace(time: Array, values: Array, name: str, show: bool, **looks: Any) -> go.Scatter:
    style = {"mode": "lines", "connectgaps": False, **looks}
    x, y = (time - time[0]).astype(np.float32), values.astype(np.float32)
    return go.Scatter(x=x, y=y, name=name, legendgroup=name, showlegend=show, **style)
