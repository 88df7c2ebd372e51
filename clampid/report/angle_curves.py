"""Errors of the joints' angles over a turn, with their band, and which angles the poses do not cover."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from clampid.charts import Axis, Band, Chart, Line, Mark, Panel, Points
from clampid.charts.marks import COLORS
from clampid.display import Scale, number, with_std
from clampid.effect import Effect
from clampid.models.curves import AngleErrors, SharedCurve, angle_errors, shared_curve
from clampid.models.model import Model
from clampid.report.stage_data import StageData
from clampid.report.style import Figure, Section, Table, as_table
from clampid.stages.poses import evaluate, predict
from clampid.stages.rows import Array
from clampid.stages.stage_kind import known_of
from kinematics.description import RobotDescription

__all__ = ["angle_curves_section"]

CURVE_POINTS = 720
FEWEST_POSES_PER_DEGREE = 3  # poses in a degree, of which a mean is drawn
DEGREES = Scale(1.0, "°")


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
        JSON of ``diagnose``: it says whether the joints share one curve.
    """
    stage = known_of(model.stages, "points")
    if stage is None:
        return None
    angle = np.linspace(-np.pi, np.pi, CURVE_POINTS + 1)
    q = np.tile(angle[:, None], (1, robot.n))
    found = angle_errors(stage, effects, model.layout, robot, q)
    if not found.active.any():
        return None
    joints = np.flatnonzero(found.active).tolist()
    up = "arm less controller, µrad"
    turn = Axis("", -180.0, 180.0, step=90.0)
    panels = [
        Panel(
            _marks(found, np.degrees(angle), j),
            turn,
            Axis("" if k % 3 else up),
            f"joint {j + 1}",
        )
        for k, j in enumerate(joints)
    ]
    height = 240 * (-(-len(joints) // 3)) + 90
    plot = Chart(tuple(panels), height, below="joint angle, degrees")
    caption = (
        "Error of each joint's angle over one turn, with a band of two standard errors. Where no pose came near, the "
        "curve is grey: the error is not identified there, and the model takes it as zero."
    )
    blocks: list[str | Table | Figure] = [Figure("angles", plot, caption)]
    one = shared_curve(stage, effects, np.linspace(0.0, 2 * np.pi, CURVE_POINTS + 1))
    if one is not None:
        blocks = [_turns(one), _one_curve(one, points_on(one, poses)), *blocks]
    notes = _not_visited(found, joints)
    if one is not None and notes:
        notes.append("On a shared curve a pose of any of its joints counts for all of them.")
    offered = () if diagnosis is None else diagnosis.get("stages", {}).get("poses", {}).get("simpler", ())
    fitted = {slot.effect for slot in stage.slots}
    notes += [
        f"Diagnosis: {c['summary']}."
        + ("" if c["name"] in fitted else f" To fit it: clampid add {c['name']} MODEL CAMPAIGN -o MENDED.")
        for c in offered
    ]
    sizes = np.sqrt(np.mean(found.error[:, joints] ** 2, axis=0))
    worst = int(np.argmax(sizes))
    finding = (
        f"Largest error of a joint's angle: joint {joints[worst] + 1}, {number(1e6 * float(sizes[worst]))} µrad rms."
    )
    return Section("angles", "Errors of the joints' angles", (), tuple(blocks), tuple(notes), finding=finding)


def _not_visited(found: AngleErrors, joints: Sequence[int]) -> list[str]:
    """The joints with angles that no pose came near, and how much of a turn that is; nothing where there are none."""
    shares = {j: round(100 * float(np.mean(found.extrapolated[:, j]))) for j in joints}
    far = [f"joint {j + 1}: {share} % of a turn" for j, share in shares.items() if share > 0]
    return [f"Not visited by any pose: {'; '.join(far)}."] if far else []


def _turns(one: SharedCurve) -> Table:
    """Phase, sign and remainder of each joint on the shared curve."""
    rows = []
    for k, j in enumerate(one.joints):
        phase, std = np.degrees(one.phase[k]) % 360, np.degrees(one.phase_std[k])
        mounted = "mirrored" if one.sense[k] < 0 else "as it is"
        rows.append((f"joint {j + 1}", mounted, with_std(phase, std, DEGREES) if k else "0 (the others count from it)"))
    caption = (
        "Joints whose angle errors share one curve g. The error of joint angle q is s g(s q − phase), with s = −1 "
        "where mirrored, plus the joint's own part: harmonics once and twice per turn, and a remainder of "
        f"{1e6 * one.deviation:.0f} µrad rms."
    )
    return as_table(("Joint", "Mounted", "Phase#"), rows, caption)


def points_on(one: SharedCurve, poses: StageData | None) -> list[tuple[int, Array, Array]]:
    """For each joint the shared curve as its poses show it: angle and g, rad, means over a degree.

    A pose's residual is given to one joint at a time: what the others leave scatters it, and averages out.
    """
    if poses is None:
        return []
    piece = poses.first
    chain, rows = piece.problem.chain, piece.rows
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
        seen = np.flatnonzero(np.bincount(degree[weight > 0], minlength=360) >= FEWEST_POSES_PER_DEGREE)
        angle = np.radians(seen + 0.5)
        curve = np.interp(angle, one.angle, one.error)
        out.append(
            (j, angle, curve + one.sense[k] * (np.bincount(degree, left, 360) / np.maximum(total, 1e-300))[seen])
        )
    return out


def _one_curve(one: SharedCurve, points: list[tuple[int, Array, Array]]) -> Figure:
    """The shared curve with its band, and each joint's poses on it."""
    degrees, error, two = np.degrees(one.angle), 1e6 * one.error, 2e6 * one.std
    marks: list[Mark] = [
        Points(np.degrees(angle), 1e6 * value, f"joint {j + 1}", COLORS[j % len(COLORS)]) for j, angle, value in points
    ]
    marks += [
        Band(degrees, error - two, error + two, "two standard errors"),
        Line(degrees, np.where(one.extrapolated, np.nan, error), "the curve", "ink"),
        Line(degrees, np.where(one.extrapolated, error, np.nan), "no pose near", "grey"),
    ]
    x = Axis("angle on the curve, s q − phase, degrees", 0.0, 360.0, step=30.0)
    plot = Chart((Panel(tuple(marks), x, Axis("arm less controller, µrad")),), 420)
    caption = (
        "The one curve of all these joints, with a band of two standard errors, and what the fitted poses say of it at "
        "each joint, means over a degree."
    )
    return Figure("one_curve", plot, caption)


def _marks(found: AngleErrors, degrees: Array, j: int) -> tuple[Mark, ...]:
    """The band, the curve, and its part without poses, in µrad."""
    error, two = 1e6 * found.error[:, j], 2e6 * found.std[:, j]
    far = found.extrapolated[:, j]
    return (
        Band(degrees, error - two, error + two, "two standard errors"),
        Line(degrees, np.where(far, np.nan, error), "measured", "blue"),
        Line(degrees, np.where(far, error, np.nan), "no pose near", "grey"),
    )
