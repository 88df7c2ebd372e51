"""Errors of the joints' angles over a turn, with their band: where angles were visited, and where nobody was."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from clampid.display import Scale, with_std
from clampid.effect import Effect
from clampid.models.curves import AngleErrors, SharedCurve, angle_errors, shared_curve
from clampid.models.model import Model
from clampid.report.panels import finish, grid, place_of
from clampid.report.stage_data import StageData
from clampid.report.style import BLUE, GREY, Figure, Section, Table, as_table, axes, layout
from clampid.stages.poses import evaluate, predict
from clampid.stages.rows import Array
from kinematics.description import RobotDescription

__all__ = ["angle_curves_section"]

STEPS = 720
FEW = 3  # poses in a degree, of which a mean is drawn
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
DEGREES = Scale(1.0, "°")
BAND = "rgba(0,114,178,0.25)"


def angle_curves_section(
    model: Model,
    effects: Mapping[str, Effect],
    robot: RobotDescription,
    poses: StageData | None = None,
    diagnosis: Mapping[str, Any] | None = None,
) -> Section | None:
    """Section "Errors of the joints' angles"; None where the model has none that depend on the joint's own angle.

    Parameters
    ----------
    poses
        The campaign's poses, whose residuals are drawn on the curve that joints share.
    diagnosis
        INTERFACE's JSON of ``diagnose``: it says whether curves of single joints are one.
    """
    if "poses" not in model.stages:
        return None
    stage = model.stages["poses"]
    angle = np.linspace(-np.pi, np.pi, STEPS + 1)
    q = np.tile(angle[:, None], (1, robot.n))
    found = angle_errors(stage, effects, model.layout, robot, q)
    if not found.active.any():
        return None
    joints = np.flatnonzero(found.active).tolist()
    plot = grid(len(joints), [f"joint {j + 1}" for j in joints])
    for k, j in enumerate(joints):
        for trace in _traces(found, np.degrees(angle), j, first=k == 0):
            plot.add_trace(trace, *place_of(k, len(joints)))
    height = 240 * (-(-len(joints) // 3)) + 90
    plot = finish(plot, len(joints), height, "joint angle, degrees", "arm less controller, µrad")
    plot.update_xaxes(range=[-180, 180], dtick=90)
    caption = (
        "Error of each joint's angle over one turn, with a band of two standard errors. Where no pose came near, the "
        "curve is drawn grey: there nothing is known but the error's usual size, and the model takes it for zero."
    )
    blocks: list[str | Table | Figure] = [Figure("angles", plot, caption, height)]
    one = shared_curve(stage, effects, np.linspace(0.0, 2 * np.pi, STEPS + 1))
    if one is not None:
        blocks = [_turns(one), _one_curve(one, points_on(one, poses)), *blocks]
    far = [f"joint {j + 1}: {100 * np.mean(found.extrapolated[:, j]):.0f} % of a turn" for j in joints]
    notes = [f"Not visited by any pose: {'; '.join(far)}."] if found.extrapolated.any() else []
    if one is not None and notes:
        notes.append("On the curve that joints share, a pose of any of them counts for all.")
    offered = () if diagnosis is None else diagnosis.get("stages", {}).get("poses", {}).get("simpler", ())
    notes += [
        f"Diagnosis: {c['summary']}. To fit it: clampid add {c['name']} MODEL CAMPAIGN -o MENDED." for c in offered
    ]
    return Section("angles", "Errors of the joints' angles", (), tuple(blocks), tuple(notes))


def _turns(one: SharedCurve) -> Table:
    """How each joint stands on the shared curve."""
    rows = []
    for k, j in enumerate(one.joints):
        phase, std = np.degrees(one.phase[k]) % 360, np.degrees(one.phase_std[k])
        mounted = "mirrored" if one.sense[k] < 0 else "as it is"
        rows.append((f"joint {j + 1}", mounted, with_std(phase, std, DEGREES) if k else "0 (the others count from it)"))
    caption = (
        "Joints whose angle errors are one curve g: an error is s g(s q - phase), s = -1 where mirrored, and what the "
        f"joint has of its own: once and twice per turn, and {1e6 * one.deviation:.0f} µrad rms beside."
    )
    return as_table(("Joint", "Mounted", "Phase#"), rows, caption)


def points_on(one: SharedCurve, poses: StageData | None) -> list[tuple[int, Array, Array]]:
    """Per joint what the poses say of the shared curve: angle on it and g there, rad, means over a degree.

    A pose's residual is given to one joint at a time: what the others leave scatters it, and averages out.
    """
    if poses is None:
        return []
    piece = poses.first
    chain, rows = piece.experiment.chain, piece.rows
    deviations = evaluate(rows, chain, poses.model.theta)
    _, _, sensitivity = predict(rows, deviations)
    width = piece.residual.shape[1]
    first, on = chain.offsets["joint_angle"].start, one.on_curve(rows.signals["q"])
    out = []
    for k, j in enumerate(one.joints):
        lever = np.where(piece.good, sensitivity[:, :width, first + j] / rows.sigma, 0.0)
        weight = np.sum(lever**2, axis=1)
        left = np.sum(lever * piece.residual / rows.sigma, axis=1)
        degree = np.floor(np.degrees(on[:, k])).astype(int) % 360
        total = np.bincount(degree, weight, 360)
        seen = np.flatnonzero(np.bincount(degree[weight > 0], minlength=360) >= FEW)
        angle = np.radians(seen + 0.5)
        curve = np.interp(angle, one.angle, one.error)
        out.append(
            (j, angle, curve + one.sense[k] * (np.bincount(degree, left, 360) / np.maximum(total, 1e-300))[seen])
        )
    return out


def _one_curve(one: SharedCurve, points: list[tuple[int, Array, Array]]) -> Figure:
    """The shared curve with its band, and each joint's poses on it."""
    plot = go.Figure()
    degrees, error, two = np.degrees(one.angle).astype(np.float32), 1e6 * one.error, 2e6 * one.std
    for j, angle, value in points:
        plot.add_trace(
            go.Scatter(
                x=np.degrees(angle).astype(np.float32), y=(1e6 * value).astype(np.float32), mode="markers",
                marker={"size": 4, "color": COLOURS[j % len(COLOURS)]}, name=f"joint {j + 1}",
            )
        )  # fmt: skip
    edge = {"x": np.r_[degrees, degrees[::-1]], "y": np.r_[error + two, (error - two)[::-1]].astype(np.float32)}
    plot.add_trace(
        go.Scatter(**edge, fill="toself", fillcolor=BAND, line={"width": 0}, mode="lines", name="two standard errors",
                   hoverinfo="skip")
    )  # fmt: skip
    for name, y, color in (
        ("the curve", np.where(one.extrapolated, np.nan, error), "black"),
        ("no pose near", np.where(one.extrapolated, error, np.nan), GREY),
    ):
        line = {"color": color, "width": 1.8}
        plot.add_trace(go.Scatter(x=degrees, y=y.astype(np.float32), mode="lines", line=line, name=name))
    plot.update_xaxes(axes(title="angle on the curve, s q - phase, degrees", range=[0, 360], dtick=30))
    plot.update_yaxes(axes(title="arm less controller, µrad"))
    plot.update_layout(layout(420, margin={"l": 64, "r": 16, "t": 40, "b": 52}))
    caption = (
        "The one curve of all these joints, with a band of two standard errors, and what the fitted poses say of it at "
        "each joint, means over a degree."
    )
    return Figure("one_curve", plot, caption, 420)


def _traces(found: AngleErrors, degrees: np.ndarray, j: int, first: bool) -> list[go.Scatter]:
    """The band, the curve, and the part of it that is not known, in µrad."""
    error, two = 1e6 * found.error[:, j], 2e6 * found.std[:, j]
    far = found.extrapolated[:, j]
    x = degrees.astype(np.float32)

    def line(y: np.ndarray, name: str, color: str) -> go.Scatter:
        style = {"color": color, "width": 1.8}
        return go.Scatter(
            x=x, y=y.astype(np.float32), mode="lines", line=style, name=name, legendgroup=name, showlegend=first
        )

    edge = {"x": np.r_[x, x[::-1]], "y": np.r_[error + two, (error - two)[::-1]].astype(np.float32)}
    band = go.Scatter(
        **edge, fill="toself", fillcolor=BAND, line={"width": 0}, mode="lines", name="two standard errors",
        legendgroup="band", showlegend=first, hoverinfo="skip",
    )  # fmt: skip
    return [
        band,
        line(np.where(far, np.nan, error), "measured", BLUE),
        line(np.where(far, error, np.nan), "no pose near", GREY),
    ]
