"""The clamped sweeps: motor torque against motor angle, with the model's loop."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from clampid.report.panels import finish, grid, place_of
from clampid.report.stage_data import StageData
from clampid.report.style import BLUE, GREEN, GREY, INK, ORANGE, Figure

__all__ = ["loops_figure"]


def loops_figure(data: StageData) -> Figure:
    """Motor torque against motor angle, driven joint by driven joint."""
    piece = data.first
    driven, sweep = piece.rows.constants["driven"], piece.rows.constants["run"]
    joints = np.unique(driven).tolist()
    plot = grid(len(joints), [f"joint {j + 1} driven" for j in joints])
    for k, j in enumerate(joints):
        place = place_of(k, len(joints))
        for index, s in enumerate(np.unique(sweep[driven == j]).tolist()):
            show = k == 0 and index == 0
            rows = np.flatnonzero(sweep == s)
            angle = piece.rows.signals["motor"][rows, j]
            angle = np.degrees(angle - angle.mean())
            measured = piece.rows.measured[rows, j]
            model = measured - piece.residual[rows, j]
            held = bool(piece.held[rows].all())
            own = piece.good[rows, j]
            dots = {"size": 3.5, "color": np.where(own, ORANGE if held else GREY, "#dddddd").tolist()}
            plot.add_trace(
                go.Scatter(
                    x=angle.astype(np.float32),
                    y=measured.astype(np.float32),
                    mode="markers",
                    marker=dots,
                    legendgroup="m",
                    name="measured",
                    showlegend=show,
                    text=[f"sweep {s + 1}"] * len(rows),
                    hovertemplate="%{text}: %{x:.3g}°, %{y:.4g} Nm<extra></extra>",
                ),
                *place,
            )
            line = {"color": BLUE if not held else GREEN, "width": 1.6}
            plot.add_trace(
                go.Scatter(
                    x=angle.astype(np.float32),
                    y=np.where(own, model, np.nan).astype(np.float32),
                    mode="lines",
                    line=line,
                    legendgroup="p",
                    name="model",
                    showlegend=show,
                    hoverinfo="skip",
                ),
                *place,
            )
    finish(plot, len(joints), 560, "angle of the motor from the sweep's mean, deg", "torque at the motor, Nm")
    plot.update_yaxes(zeroline=True, zerolinecolor=INK, zerolinewidth=0.5)
    caption = (
        "Clamped: torque against angle of the motor driven, all sweeps of a joint. The slope is the drive's stiffness, "
        "the height of the loop twice its friction, the flat stretch in the middle its clearance. Rows right after a "
        "reversal (light) are not used."
    )
    return Figure("loops", plot, caption, 560)
