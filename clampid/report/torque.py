"""Torques: measured and predicted over a stretch of a program, friction against speed, and the clamped loops."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go

from clampid.effect import Stage
from clampid.report.loops import loops_figure
from clampid.report.panels import finish, grid, place_of
from clampid.report.stage_data import StageData
from clampid.report.style import BLUE, GREY, Figure, Section, thin
from clampid.stages.rows import Integers

__all__ = ["torque_section"]

STRETCH_S = 60.0
MOST_STRETCH = 700
MOST_POINTS = 900
FRICTION = (
    "coulomb_friction",
    "viscous_friction",
    "stribeck_friction",
    "asymmetric_friction",
    "load_dependent_friction",
    "temperature_dependent_friction",
)
"""Friction that acts at the motor; what reaches it through the wrist's coupling depends on other speeds too."""


def torque_section(stages: Mapping[Stage, StageData]) -> Section | None:
    """Section "Torques"; None without torque tables."""
    figures: list[Figure] = []
    free = stages.get("free_air")
    if free is not None and free.good.any():
        figures += [_stretch(free), _friction(free)]
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
    piece, motors = data.first, data.channels
    rows = _best_stretch(data)
    time = piece.rows.constants["time"][rows]
    plot = grid(motors, [f"motor {k + 1}" for k in range(motors)])
    measured = piece.rows.measured[rows]
    model = np.where(piece.good[rows], measured - piece.residual[rows], np.nan)
    for k in range(motors):
        place = place_of(k, motors)
        dots = {"size": 3.5, "color": GREY}
        plot.add_trace(
            go.Scatter(
                x=time - time[0],
                y=measured[:, k].astype(np.float32),
                mode="markers",
                marker=dots,
                name="measured",
                legendgroup="m",
                showlegend=k == 0,
            ),
            *place,
        )
        line = {"color": BLUE, "width": 1.8}
        plot.add_trace(
            go.Scatter(
                x=time - time[0],
                y=model[:, k].astype(np.float32),
                mode="lines",
                line=line,
                name="model",
                legendgroup="p",
                showlegend=k == 0,
                connectgaps=False,
            ),
            *place,
        )
    finish(plot, motors, 520, "time, s", "torque at the motor, Nm")
    table, run = str(piece.rows.table[rows[0]]), int(piece.rows.constants["run"][rows[0]]) + 1
    kind = "held out" if piece.held[rows].all() else "fitted"
    caption = (
        f"Measured and predicted motor torques over {time[-1] - time[0]:.0f} s of the table {table} (run {run}, from "
        f"{time[0]:.0f} s; rows {kind}). Where a motor rests, or accelerates "
        "hard, its torque is not predicted: the line has a gap."
    )
    return Figure("stretch", plot, caption, 520)


def _friction(data: StageData) -> Figure:
    piece, motors = data.first, data.channels
    theta = data.model.theta.copy()
    for k, slot in enumerate(data.model.slots):
        if slot.effect in FRICTION:
            theta[k] = 0.0
    usable = np.flatnonzero(piece.good.any(axis=1))
    rows = usable[thin(len(usable), 6 * MOST_POINTS)]
    part = piece.rows.take(rows)
    trial = piece.experiment.with_rows(part)
    runs = np.zeros(trial.offsets)
    model = trial.residual(np.r_[theta, runs])[0] - trial.residual(np.r_[data.model.theta, runs])[0]
    measured = model + piece.residual[rows]
    speed, good = part.signals["motor_speed"], piece.good[rows]
    plot = grid(motors, [f"motor {k + 1}" for k in range(motors)])
    for k in range(motors):
        place = place_of(k, motors)
        own = np.flatnonzero(good[:, k])
        own = own[thin(len(own), MOST_POINTS)]
        x, y, m = (v[own, k].astype(np.float32) for v in (speed, measured, model))
        dots = {"size": 3.5, "color": GREY, "opacity": 0.5}
        plot.add_trace(
            go.Scatter(
                x=x,
                y=y,
                mode="markers",
                marker=dots,
                name="measured less all else in the model",
                legendgroup="m",
                showlegend=k == 0,
            ),
            *place,
        )
        dots = {"size": 3.5, "color": BLUE}
        plot.add_trace(
            go.Scatter(
                x=x, y=m, mode="markers", marker=dots, name="friction of the model", legendgroup="p", showlegend=k == 0
            ),
            *place,
        )
        reach = float(np.nanquantile(np.abs(y), 0.998)) * 1.15 if len(y) else 1.0
        plot.update_yaxes(range=[-reach, reach], row=place[0], col=place[1])
    finish(plot, motors, 520, "speed of the motor, rad/s", "friction at the motor, Nm")
    caption = (
        "Friction against speed: what is left of the measured torque when everything else in the model is taken off, "
        "and what the model's friction at the motor says. A systematic difference is friction that the model "
        "has not got."
    )
    return Figure("friction", plot, caption, 520)
