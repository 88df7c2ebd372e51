"""The clamped sweeps: motor torque against motor angle, with the model's loop."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from clampid.display import Scale, with_error, with_std
from clampid.models.drives import Drives, drives_of
from clampid.report.panels import finish, grid, place_of
from clampid.report.stage_data import StageData
from clampid.report.style import BLUE, GREEN, GREY, INK, ORANGE, Figure
from clampid.stages.rows import Integers

__all__ = ["loops_figure"]

DEGREES = Scale(180.0 / np.pi, "deg")


def loops_figure(data: StageData) -> Figure:
    """Motor torque against motor angle, driven joint by driven joint."""
    piece = data.first
    driven, sweep = piece.rows.constants["driven"], piece.rows.constants["run"]
    joints = np.unique(driven).tolist()
    springs = any(s.effect == "joint_compliance" for s in data.model.slots)
    drives = drives_of(data.model, piece.rows.robot) if springs else None
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
            if index == 0 and drives is not None:
                _mark(plot, place, data, drives, j, rows, show)
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
        "the height of the loop twice its friction, the flat stretch in the middle its clearance (band; numbers at the "
        "motor, ± one standard error). Dashed: spring and clearance as identified, without friction, of the first "
        "sweep; where the clamp yields, loops are flatter. Light rows, right after a reversal, are not used."
    )
    return Figure("loops", plot, caption, 560)


def _mark(
    plot: go.Figure, place: tuple[int, int], data: StageData, drives: Drives, joint: int, rows: Integers, show: bool
) -> None:
    """Draw the spring's line, broken by the clearance, of one sweep, and its numbers.

    A joint that is driven alone against the clamp winds its own motor's spring only, also in a coupled wrist: with
    C = Tᵀ diag(1/k) T, T C⁻¹ e = diag(k) T⁻ᵀ e, so that torque over angle is k.
    """
    piece = data.first
    k, gap, friction = drives.stiffness[joint], drives.gap[joint], drives.friction[joint]
    gap = max(float(np.nan_to_num(gap)) / abs(float(piece.rows.robot.transmission[joint][joint])), 0.0)
    used = rows[piece.good[rows, joint]]
    if not np.isfinite(k) or len(used) < 2:
        return
    angle = piece.rows.signals["motor"][:, joint]
    model = piece.rows.measured[used, joint] - piece.residual[used, joint]
    bare = model - float(np.nan_to_num(friction)) * piece.rows.signals["motor_motion"][used, joint]
    middle = float(np.median(angle[used] - bare / k - 0.5 * gap * np.sign(bare)) - angle[rows].mean())
    reach = np.array([min(bare.min(), 0.0), 0.0, 0.0, max(bare.max(), 0.0)])
    x = np.degrees(middle + reach / k + 0.5 * gap * np.array([-1.0, -1.0, 1.0, 1.0]))
    line = {"color": INK, "width": 1.4, "dash": "dash"}
    plot.add_trace(
        go.Scatter(
            x=x, y=reach, mode="lines", line=line, legendgroup="k", name="spring and clearance", showlegend=show
        ),
        *place,
    )
    plot.add_vrect(x0=x[1], x1=x[2], fillcolor=ORANGE, opacity=0.15, line_width=0, row=place[0], col=place[1])
    text = f"k = {with_error(float(k), float(drives.stiffness_std[joint]), 'Nm/rad')}"
    if np.isfinite(drives.gap[joint]):
        spread = float(drives.gap_std[joint]) / abs(float(piece.rows.robot.transmission[joint][joint]))
        text += f"<br>clearance {with_std(gap, spread, DEGREES)}"
        text += "" if drives.told[joint] else "<br>(not significant)"
    where = {"xref": "x domain", "yref": "y domain", "x": 0.02, "y": 0.98, "xanchor": "left", "yanchor": "top"}
    looks = {"showarrow": False, "align": "left", "font": {"size": 11}, "bgcolor": "rgba(255,255,255,0.7)"}
    plot.add_annotation(text=text, row=place[0], col=place[1], **looks, **where)
