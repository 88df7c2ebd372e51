"""The robot drawn in its base frame, with the error vector at every measured point."""

from __future__ import annotations

import math

import numpy as np
import plotly.graph_objects as go

from clampid.display import error_text
from clampid.report.stage_data import StageData
from clampid.report.style import BLUE, GREY, INK, Figure, Section, layout, thin
from clampid.stages.rows import Array, Integers
from kinematics.description import RobotDescription
from kinematics.poe import joint_transforms
from kinematics.screws import cayley

__all__ = ["arm_points", "base_pose", "robot_section"]

MOST_VECTORS = 400  # more of them hide the arm
POSES_DRAWN = 3
REACH = 0.08  # of the workspace: how long the 95th percentile of the errors is drawn


def arm_points(robot: RobotDescription, q: Array) -> Array:
    """Points along the arm at joint angles ``q`` ``(N, n)``: base, joints, flange ``(N, n + 2, 3)``, base frame, m."""
    G = joint_transforms(robot.screws, q @ np.asarray(robot.linkage).T)
    joints = np.array([joint.point for joint in robot.joints])
    at = np.einsum("nkij,kj->nki", G[:, :-1, :3, :3], joints) + G[:, :-1, :3, 3]
    flange = np.einsum("nij,j->ni", G[:, -1, :3, :3], robot.flange[:3, 3]) + G[:, -1, :3, 3]
    return np.concatenate([np.zeros((len(q), 1, 3)), at, flange[:, None]], axis=1)


def base_pose(data: StageData) -> tuple[Array, Array]:
    """Where the instrument sees the robot's base: rotation ``(3, 3)`` and position ``(3,)``."""
    reference = data.first.rows.constants["base_reference"][0]
    twist = np.zeros(6)
    names = ("base_rx", "base_ry", "base_rz", "base_x", "base_y", "base_z")
    for slot, value in data.model.values().items():
        if slot.effect == "geometry" and slot.parameter in names:
            twist[names.index(slot.parameter)] = value
    R, p = reference[:3, :3], reference[:3, 3]
    return R @ np.asarray(cayley(twist[:3])), R @ twist[3:] + p


def robot_section(robot: RobotDescription, data: StageData, before: StageData | None) -> Section | None:
    """Section "The errors in space"; ``before`` is the same of the first model."""
    R, p = base_pose(data)
    good = data.good[:, 0]
    pick = np.flatnonzero(good)
    pick = pick[thin(len(pick), MOST_VECTORS)]
    if not len(pick):
        return None
    points = (data.stacked("position")[pick] - p) @ R  # R' (x - p), row by row
    after = data.residual[pick] @ R
    shown = [("now", after)] if before is None else [("before", before.residual[pick] @ R), ("now", after)]
    extent = float(np.ptp(points, axis=0).max()) or 1.0
    plot = go.Figure()
    hover = _hover(data, pick)
    longer = []
    for k, (name, vectors) in enumerate(shown):
        visible = k == len(shown) - 1
        size = np.linalg.norm(vectors, axis=1)
        longer.append(_nice(REACH * extent / max(float(np.quantile(size, 0.95)), 1e-12)))
        for trace in _vectors(points, vectors, longer[-1], hover, name):
            trace.visible = visible
            plot.add_trace(trace)
    for trace in _arms(robot, data.stacked("q")[pick]):
        plot.add_trace(trace)
    axis = {"backgroundcolor": "white", "gridcolor": "#e4e4e4", "zerolinecolor": GREY, "showbackground": False}
    scene = {f"{a}axis": {**axis, "title": f"{a}, m"} for a in "xyz"}
    eye = {"x": 1.3, "y": -1.3, "z": 0.7}
    menu = []
    if len(shown) > 1:
        arms = len(plot.data) - 4
        buttons = [
            {
                "label": f"Errors {name} (×{longer[k]:.0f})",
                "method": "restyle",
                "args": [{"visible": [j // 2 == k for j in range(4)] + [True] * arms}],
            }
            for k, (name, _) in enumerate(shown)
        ]
        menu = [
            {
                "type": "buttons",
                "direction": "right",
                "buttons": buttons,
                "active": 1,
                "x": 0,
                "y": 1.06,
                "xanchor": "left",
            }
        ]
    plot.update_layout(
        layout(
            640,
            scene={**scene, "aspectmode": "data", "camera": {"eye": eye, "center": {"x": 0, "y": 0, "z": -0.22}}},
            updatemenus=menu,
            showlegend=False,
        ),
        margin={"l": 0, "r": 0, "t": 40, "b": 0},
    )
    drawn = "" if len(pick) == good.sum() else f" {len(pick)} of {int(good.sum())} points are drawn."
    caption = (
        f"Error vectors (measured less predicted) from the points measured (dots), drawn {longer[-1]:.0f} times longer "
        "than they are, in the robot base frame. Black: the arm at the zero pose; grey: at poses of the campaign, as "
        f"straight lines between points on the joints' axes.{drawn}"
        + (
            " The buttons change between the errors before anything was added and now; length and colour have a scale "
            "of their own in each."
            if len(shown) > 1
            else ""
        )
    )
    return Section("robot", "The errors in space", (), (Figure("robot", plot, caption, 640),))


def _nice(value: float) -> float:
    """The next smaller of 1, 2, 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(m for m in (5.0, 2.0, 1.0) if m * power <= value * (1 + 1e-9)) * power


def _hover(data: StageData, pick: Integers) -> list[str]:
    columns = {name: data.column(name) for name in ("pose", "visit", "target")}
    tables = np.concatenate([p.rows.table for p in data.pieces])
    out = []
    for i in pick.tolist():
        words = [f"{name} {series.iloc[i]}" for name, series in columns.items() if series is not None]
        out.append(f"{tables[i]}: {', '.join(words)}")
    return out


def _vectors(
    points: Array, vectors: Array, scale: float, hover: list[str], name: str
) -> tuple[go.Scatter3d, go.Scatter3d]:
    size = 1e6 * np.linalg.norm(vectors, axis=1)
    tip = points + scale * vectors
    gap = np.full(len(points), np.nan)
    lines = [np.c_[points[:, k], tip[:, k], gap].ravel().astype(np.float32) for k in range(3)]
    color = np.repeat(size, 3).astype(np.float32)
    bar = {"title": {"text": f"error {name}, µm"}, "thickness": 14, "len": 0.6, "x": 1.0}
    colors = {"colorscale": "Viridis", "reversescale": True, "cmin": 0, "cmax": float(np.quantile(size, 0.98))}
    strokes = go.Scatter3d(
        x=lines[0],
        y=lines[1],
        z=lines[2],
        mode="lines",
        hoverinfo="skip",
        line={"color": color, "width": 5, "showscale": True, "colorbar": bar, **colors},
    )
    dots = go.Scatter3d(
        x=points[:, 0].astype(np.float32),
        y=points[:, 1].astype(np.float32),
        z=points[:, 2].astype(np.float32),
        mode="markers",
        name=name,
        text=[f"{h}<br>{error_text(1e-6 * s, 'm')}" for h, s in zip(hover, size, strict=True)],
        hovertemplate="%{text}<extra></extra>",
        marker={"size": 1.6, "color": GREY},
    )
    return strokes, dots


def _arms(robot: RobotDescription, q: Array) -> list[go.Scatter3d]:
    """The zero pose, and poses of the campaign that are far from each other."""
    scale = np.ptp(q, axis=0) + 1e-9
    chosen = [int(np.argmin(np.linalg.norm((q - q.mean(axis=0)) / scale, axis=1)))]
    while len(chosen) < min(POSES_DRAWN, len(q)):
        gap = np.min([np.linalg.norm((q - q[k]) / scale, axis=1) for k in chosen], axis=0)
        chosen.append(int(np.argmax(gap)))
    out = []
    for k, arm in enumerate(arm_points(robot, np.concatenate([np.zeros((1, robot.n)), q[chosen]]))):
        zero = k == 0
        color = INK if zero else "#a8a8a8"
        out.append(
            go.Scatter3d(
                x=arm[:, 0],
                y=arm[:, 1],
                z=arm[:, 2],
                mode="lines+markers",
                line={"color": color, "width": 10 if zero else 5},
                marker={"size": 4 if zero else 2.5, "color": BLUE if zero else color},
                hovertemplate=("zero pose" if zero else "a pose of the campaign") + "<extra></extra>",
            )
        )
    return out
