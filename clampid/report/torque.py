"""Torques: measured and predicted over a stretch of a program, friction against speed, and the clamped loops."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from clampid.charts import Axis, Chart, Level, Line, Panel, Points, thin
from clampid.effect import Stage
from clampid.report.friction import friction_figures
from clampid.report.loops import loops_figure
from clampid.report.stage_data import StageData
from clampid.report.style import Figure, Section
from clampid.stages.rows import Integers

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
    run, time = piece.rows.series.run, piece.rows.constants.time
    wanted = piece.held_out if piece.held_out.any() else np.ones(len(run), dtype=bool)
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
    time = piece.rows.constants.time[rows]
    across = min(motors, 3)
    down = int(np.ceil(motors / across))
    measured, residual = piece.rows.measured[rows], piece.residual[rows]
    good, seconds = piece.good[rows], time - time[0]
    panels = []
    for r in range(down):
        row = range(across * r, min(across * (r + 1), motors))
        for k in row:
            predicted = measured[:, k] - residual[:, k]
            marks = (
                Points(seconds, measured[:, k], "measured", "grey", 3.5),
                Line(seconds, predicted, "model where rows do not count", "blue", 1.0, dash="2 3"),
                Line(seconds, np.where(good[:, k], predicted, np.nan), "model", "blue"),
            )
            up = Axis("torque, Nm" if k == row[0] else "")
            panels.append(Panel(marks, Axis(ticks=()), up, f"motor {k + 1}"))
        panels += [Panel(())] * (across - len(row))
        for k in row:
            left, level = np.where(good[:, k], residual[:, k], np.nan), float(data.floor.sigma[k])
            reach = max(4.0 * level, 1.1 * float(np.nanmax(np.abs(left))) if np.isfinite(left).any() else 0.0)
            below = (
                Points(seconds, left, "residual", "grey", 2.5),
                Level(-level, name="± 1 σ of the noise"),
                Level(level, name="± 1 σ of the noise"),
            )
            up = Axis("residual, Nm" if k == row[0] else "", -reach, reach)
            panels.append(Panel(below, Axis(), up))
        panels += [Panel(())] * (across - len(row)) if r < down - 1 else []
    plot = Chart(tuple(panels), 310 * down + 40, across, (3.0, 1.4) * down, below="time, s")
    table, run = str(piece.rows.table[rows[0]]), int(piece.rows.series.run[rows[0]]) + 1
    kind = "held out" if piece.held_out[rows].all() else "fitted"
    caption = (
        f"Measured and predicted motor torques over {time[-1] - time[0]:.0f} s of the table {table} (run {run}, from "
        f"{time[0]:.0f} s; rows {kind}), and below them what the model leaves, with ± 1 σ of the noise (dashed). Where "
        "a motor rests, or accelerates harder than the model accounts for, rows do not count (dotted)."
    )
    return Figure("stretch", plot, caption)
