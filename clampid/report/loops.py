"""The clamped sweeps: motor torque against motor angle, with the model's loop."""

from __future__ import annotations

import numpy as np

from clampid.charts import Axis, Chart, Label, Level, Line, Mark, Panel, Points, Span
from clampid.display import Scale, with_error, with_std
from clampid.models.drives import Drives, drives_of
from clampid.report.stage_data import StageData
from clampid.report.style import Figure
from clampid.role_slots import any_of_role
from clampid.stages.rows import Integers

__all__ = ["loops_figure"]

DEGREES = Scale(180.0 / np.pi, "deg")


def loops_figure(data: StageData) -> Figure:
    """Motor torque against motor angle, driven joint by driven joint."""
    piece = data.first
    driven, sweep = piece.rows.sweep.driven, piece.rows.series.run
    joints = np.unique(driven).tolist()
    springs = any_of_role(data.model.slots, "compliance")
    drives = drives_of(data.model, piece.rows.robot) if springs else None
    panels = []
    for k, j in enumerate(joints):
        marks: list[Mark] = [Level(0.0, color="faint", dash="")]
        for index, s in enumerate(np.unique(sweep[driven == j]).tolist()):
            rows = np.flatnonzero(sweep == s)
            marks += _sweep(data, j, rows, f"sweep {s + 1}")
            if index == 0 and drives is not None:
                marks += _spring(data, drives, j, rows)
        up = "" if k % 3 else "torque at the motor, Nm"
        panels.append(Panel(tuple(marks), Axis(), Axis(up), f"joint {j + 1} driven"))
    below = "angle of the motor from the sweep's mean, deg"
    plot = Chart(tuple(panels), 280 * -(-len(joints) // 3), below=below)
    caption = (
        "Clamped: torque against angle of the motor driven, all sweeps of a joint. The slope is the drive's stiffness, "
        "the height of the loop twice its friction, the flat stretch in the middle its clearance (band; numbers at the "
        "motor, ± one standard error). Dashed: spring and clearance as identified, without friction, of the first "
        "sweep; where the clamp yields, loops are flatter. Light rows, right after a reversal, are not used."
    )
    return Figure("loops", plot, caption)


def _sweep(data: StageData, joint: int, rows: Integers, name: str) -> list[Mark]:
    """One sweep: torque measured and by the model against angle."""
    piece = data.first
    angle = piece.rows.signals["motor"][rows, joint]
    angle = np.degrees(angle - angle.mean())
    measured = piece.rows.measured[rows, joint]
    own = piece.good[rows, joint]
    held_out = bool(piece.held_out[rows].all())
    kept = "measured, held out" if held_out else "measured"
    model = np.where(own, measured - piece.residual[rows, joint], np.nan)
    return [
        Points(angle[~own], measured[~own], "measured, not used", "faint", 3.5, tips=(name,)),
        Points(angle[own], measured[own], kept, "orange" if held_out else "grey", 3.5, tips=(name,)),
        Line(angle, model, "model, held out" if held_out else "model", "green" if held_out else "blue", 1.6),
    ]


def _spring(data: StageData, drives: Drives, joint: int, rows: Integers) -> list[Mark]:
    """The spring's line, broken by the clearance, of one sweep, and its numbers.

    A joint that is driven alone against the clamp winds its own motor's spring only, also in a coupled wrist: with
    C = Tᵀ diag(1/k) T, T C⁻¹ e = diag(k) T⁻ᵀ e, so that torque over angle is k.
    """
    piece = data.first
    k, gap, friction = drives.stiffness[joint], drives.gap[joint], drives.friction[joint]
    gap = max(float(np.nan_to_num(gap)) / abs(float(piece.rows.robot.transmission[joint][joint])), 0.0)
    used = rows[piece.good[rows, joint]]
    if not np.isfinite(k) or len(used) < 2:
        return []
    angle = piece.rows.signals["motor"][:, joint]
    model = piece.rows.measured[used, joint] - piece.residual[used, joint]
    bare = model - float(np.nan_to_num(friction)) * piece.rows.signals["motor_motion"][used, joint]
    middle = float(np.median(angle[used] - bare / k - 0.5 * gap * np.sign(bare)) - angle[rows].mean())
    reach = np.array([min(bare.min(), 0.0), 0.0, 0.0, max(bare.max(), 0.0)])
    x = np.degrees(middle + reach / k + 0.5 * gap * np.array([-1.0, -1.0, 1.0, 1.0]))
    texts = [f"k = {with_error(float(k), float(drives.stiffness_std[joint]), 'Nm/rad')}"]
    if np.isfinite(drives.gap[joint]):
        spread = float(drives.gap_std[joint]) / abs(float(piece.rows.robot.transmission[joint][joint]))
        texts.append(f"clearance {with_std(gap, spread, DEGREES)}")
        texts += [] if drives.gap_identified[joint] else ["(not significant)"]
    return [
        Span(float(x[1]), float(x[2])),
        Line(x, reach, "spring and clearance", "ink", 1.4, dash="5 4"),
        Label(tuple(texts)),
    ]
