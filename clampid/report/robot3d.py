"""The robot drawn in its base frame, with the error vector at every measured point."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from clampid.charts import Axis, Chart, Line, Mark, Panel, Points, Segments, thin
from clampid.display import error_text
from clampid.report.stage_data import StageData
from clampid.report.style import Figure, Section
from clampid.role_slots import axis_of, has_role
from clampid.stages.rows import Array, Integers
from kinematics.description import RobotDescription
from kinematics.poe import joint_transforms
from kinematics.screws import cayley

__all__ = ["arm_points", "base_pose", "robot_section"]

MOST_VECTORS = 400  # more of them hide the arm
POSES_DRAWN = 3
VIEWS = (("from the side", 0, 2), ("from above", 0, 1))
"""Title, and the base frame's axes to the right and upwards."""
AXES = (Axis("x, m"), Axis("y, m"), Axis("z, m"))
CLASSES = 5  # of size, each a colour
DRAWN_ERROR = 0.08  # of the workspace: how long the 95th percentile of the errors is drawn


def arm_points(robot: RobotDescription, q: Array) -> Array:
    """Points along the arm at joint angles ``q`` ``(N, n)``: base, joints, flange ``(N, n + 2, 3)``, base frame, m."""
    G = joint_transforms(robot.screws, q @ np.asarray(robot.linkage).T)
    joints = np.array([joint.point for joint in robot.joints])
    at = np.einsum("nkij,kj->nki", G[:, :-1, :3, :3], joints) + G[:, :-1, :3, 3]
    flange = np.einsum("nij,j->ni", G[:, -1, :3, :3], robot.flange[:3, 3]) + G[:, -1, :3, 3]
    return np.concatenate([np.zeros((len(q), 1, 3)), at, flange[:, None]], axis=1)


def base_pose(data: StageData) -> tuple[Array, Array]:
    """Where the instrument sees the robot's base: rotation ``(3, 3)`` and position ``(3,)``."""
    reference = data.first.rows.pose.base_reference[0]
    twist = np.zeros(6)
    names = ("rx", "ry", "rz", "x", "y", "z")
    for slot, value in data.model.values().items():
        if has_role(slot, "base_frame"):
            twist[names.index(axis_of(slot))] = value
    R, p = reference[:3, :3], reference[:3, 3]
    return R @ np.asarray(cayley(twist[:3])), R @ twist[3:] + p


def robot_section(robot: RobotDescription, data: StageData, before: StageData | None) -> Section | None:
    """Section "The errors in space"; ``before`` is the same of the start model."""
    R, p = base_pose(data)
    good = data.good[:, 0]
    pick = np.flatnonzero(good)
    pick = pick[thin(len(pick), MOST_VECTORS)]
    if not len(pick):
        return None
    points = (data.stacked("position")[pick] - p) @ R  # R' (x - p), row by row
    after = data.residual[pick] @ R
    shown = [("robot", "now", after)]
    if before is not None:
        shown.append(("robot-before", "before anything was added", before.residual[pick] @ R))
    arms = _arms(robot, data.stacked("q")[pick])
    drawn = "" if len(pick) == good.sum() else f" {len(pick)} of {int(good.sum())} points are drawn."
    figures = []
    for key, when, vectors in shown:
        scale, marks = _vectors(points, vectors, _tips(data, pick, vectors) if key == "robot" else ())
        panels = [
            Panel((*_arm_lines(arms, r, u), *marks(r, u)), AXES[r], AXES[u], title, equal=True) for title, r, u in VIEWS
        ]
        caption = (
            f"Error vectors (measured less predicted) {when}, from the points measured (dots), drawn {scale:.0f} times "
            "longer than they are, in the robot base frame. Thick: the arm at the zero pose; thin: at poses of the "
            f"campaign, as straight lines between points on the joints' axes.{drawn}"
        )
        figures.append(Figure(key, Chart(tuple(panels), 560), caption))
    return Section("robot", "The errors in space", (), tuple(figures))


def _nice(value: float) -> float:
    """The next smaller of 1, 2, 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(m for m in (5.0, 2.0, 1.0) if m * power <= value * (1 + 1e-9)) * power


def _tips(data: StageData, pick: Integers, vectors: Array) -> list[str]:
    """Which row a point is, and how large its error."""
    columns = {name: data.column(name) for name in ("pose", "visit", "target")}
    tables = np.concatenate([p.rows.table for p in data.pieces])
    out = []
    for i, size in zip(pick.tolist(), np.linalg.norm(vectors, axis=1).tolist(), strict=True):
        words = [f"{name} {series.iloc[i]}" for name, series in columns.items() if series is not None]
        out.append(f"{tables[i]}: {', '.join([*words, error_text(size, 'm')])}")
    return out


def _vectors(points: Array, vectors: Array, tips: Sequence[str]) -> tuple[float, Callable[[int, int], list[Mark]]]:
    """How much longer the errors are drawn, and their marks in a view of two axes: a colour for each class of size."""
    size = np.linalg.norm(vectors, axis=1)
    extent = float(np.ptp(points, axis=0).max()) or 1.0
    scale = _nice(DRAWN_ERROR * extent / max(float(np.quantile(size, 0.95)), 1e-12))
    tip = points + scale * vectors
    edges = np.linspace(0.0, max(float(np.quantile(size, 0.98)), 1e-12), CLASSES + 1)[1:-1]
    group = np.searchsorted(edges, size)
    names = [f"error up to {error_text(float(e), 'm')}" for e in edges] + ["error larger"]

    def marks(right: int, up: int) -> list[Mark]:
        view = [right, up]
        out: list[Mark] = [
            Segments(points[group == k][:, view], tip[group == k][:, view], name, f"size{k + 1}")
            for k, name in enumerate(names)
            if np.any(group == k)
        ]
        return [*out, Points(points[:, right], points[:, up], "", "grey", 3.0, tips=tips)]

    return scale, marks


def _arms(robot: RobotDescription, q: Array) -> Array:
    """Arm points at the zero pose, and at poses of the campaign that are far from each other."""
    scale = np.ptp(q, axis=0) + 1e-9
    chosen = [int(np.argmin(np.linalg.norm((q - q.mean(axis=0)) / scale, axis=1)))]
    while len(chosen) < min(POSES_DRAWN, len(q)):
        gap = np.min([np.linalg.norm((q - q[k]) / scale, axis=1) for k in chosen], axis=0)
        chosen.append(int(np.argmax(gap)))
    return arm_points(robot, np.concatenate([np.zeros((1, robot.n)), q[chosen]]))


def _arm_lines(arms: Array, right: int, up: int) -> list[Mark]:
    """The arms in a view of two axes; the zero pose on top."""
    out: list[Mark] = []
    for k in reversed(range(len(arms))):
        name, color, width = ("zero pose", "ink", 5.0) if k == 0 else ("poses of the campaign", "faint", 3.0)
        out.append(Line(arms[k, :, right], arms[k, :, up], name, color, width, symbol="circle"))
    return out
