"""The drives identified from clamped sweeps: a table, the compliance matrix, and the clamp's motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from clampid.charts import Axis, Cells, Chart, Line, Mark, Panel, Points, thin
from clampid.display import Scale, number, with_std
from clampid.fitting.prior_and_start import clamping_offsets
from clampid.models.drives import Drives, drives_of
from clampid.report.stage_data import StageData
from clampid.report.style import Figure, Section, Table, as_table
from clampid.role_slots import any_of_role
from clampid.stages.clamped import fixture_motion
from clampid.stages.rows import Array, Integers

__all__ = ["drives_section"]

AXES = ("x", "y", "z")
WATCHED = tuple(f"fixture_{a}_m" for a in AXES) + tuple(f"fixture_r{a}_rad" for a in AXES)
MOST_ROWS = 1600


def drives_section(clamped: StageData | None) -> Section | None:
    """Section "Drives"; None where no clamped stage with springs is."""
    if clamped is None or not any_of_role(clamped.model.slots, "compliance"):
        return None
    drives = drives_of(clamped.model, clamped.first.rows.robot)
    blocks: list[str | Table | Figure] = [_table(drives), _matrix(drives)]
    moved = _fixture(clamped)
    return Section("drives", "Drives", (), tuple(blocks if moved is None else [*blocks, moved]))


def _table(d: Drives) -> Table:
    """Springs, clearances and friction, drive by drive."""
    rows = []
    for j in range(len(d.stiffness)):
        clear = "" if not np.isfinite(d.gap[j]) else "yes" if d.gap_identified[j] else "no"
        rows.append(
            (
                str(j + 1),
                _pair(d.stiffness[j], d.stiffness_std[j]),
                _pair(d.joint_stiffness[j] / 1e3, d.joint_stiffness_std[j] / 1e3),
                _pair(np.degrees(d.gap[j]), np.degrees(d.gap_std[j])),
                number(float(np.degrees(d.gap_limit[j])), 2),
                clear,
                _pair(d.friction[j], d.friction_std[j]),
            )
        )
    columns = (
        "axis", "k at the motor, Nm/rad#", "k at the joint, kNm/rad#", "clearance, deg#", "detection limit, deg#",
        "differs from zero", "friction at the motor, Nm#",
    )  # fmt: skip
    caption = (
        "Springs, clearances and dry friction of the drives, ± one standard error. A clearance below its detection "
        "limit does not differ significantly from zero (Currie 1968, both risks 5 %)."
    )
    return as_table(columns, rows, caption)


def _matrix(d: Drives) -> Figure:
    """The compliance at the joints; colours are couplings, C_ij / sqrt(C_ii C_jj)."""
    n = len(d.stiffness)
    own = np.sqrt(np.maximum(np.diag(d.compliance), 1e-300))
    coupling = d.compliance / np.outer(own, own)
    value, std = 1e6 * d.compliance, 1e6 * d.compliance_std
    text = [[_pair(value[a, b], std[a, b]) if value[a, b] else "0" for b in range(n)] for a in range(n)]
    tips = [
        [
            f"joint {a + 1} by torque at joint {b + 1}: {text[a][b]} µrad/Nm, coupling {coupling[a, b]:.2f}"
            for b in range(n)
        ]
        for a in range(n)
    ]
    names = tuple((float(j), f"joint {j + 1}") for j in range(n))
    across, down = Axis("torque at", -0.5, n - 0.5, ticks=names), Axis("", -0.5, n - 0.5, flipped=True, ticks=names)
    panel = Panel((Cells(coupling, text, tips),), across, down, "deflection of a joint, µrad, by 1 Nm at another")
    plot = Chart((panel,), 430)
    caption = (
        "Compliance at the joints, Tᵀ·diag(1/k)·T and cross springs where the model has them, µrad/Nm ± one standard"
        " error. Colours are couplings (blue positive, orange negative): ±1 where two joints yield as one. In a "
        "coupled wrist a torque at one joint turns the others too."
    )
    return Figure("compliance", plot, caption)


def _fixture(data: StageData) -> Figure | None:
    """The clamp's motion by its sensor and by the model; None without a sensor."""
    frame = data.frames.get("clamped")
    if frame is None or not any(name in frame.columns for name in WATCHED):
        return None
    rows = data.first.rows
    seen = thin(len(rows), MOST_ROWS)
    titles = [f"along {a}" for a in AXES] + [f"about {a}" for a in AXES]
    sensor, model = _from_mean(_sensor(frame), rows.series.run), _modelled(data)
    panels = []
    for k in range(6):
        marks: list[Mark] = [Points(seen.astype(float), 1e6 * sensor[seen, k], "sensor", "grey", 2.5)]
        if model is not None:
            marks.append(Line(seen.astype(float), 1e6 * model[seen, k], "model", "blue", 1.2))
        unit = "" if k % 3 else ("motion, µm" if k == 0 else "rotation, µrad")
        panels.append(Panel(tuple(marks), Axis(), Axis(unit), titles[k]))
    plot = Chart(tuple(panels), 480, below="row of the table clamped")
    caption = "Motion of the clamped flange by the sensor on its fixture, from the mean of each sweep, base axes" + (
        ", and by the model." if model is not None else ". In the model the fixture does not move."
    )
    return Figure("fixture", plot, caption)


def _sensor(frame: pd.DataFrame) -> Array:
    """The sensor's readings ``(N, 6)``, m and rad; zero where a column is missing."""
    empty = np.zeros(len(frame))
    return np.column_stack([frame[n].to_numpy(float) if n in frame.columns else empty for n in WATCHED])


def _modelled(data: StageData) -> Array | None:
    """The flange's motion as the model has it ``(N, 6)``, m and rad, from each sweep's mean."""
    trial = data.first.problem
    if not any("fixture" in trial.effects[s.effect].acts for s in trial.slots):
        return None
    theta = np.r_[data.model.theta, np.zeros(trial.offsets)]
    offsets = clamping_offsets(trial, theta)
    moved = fixture_motion(trial.rows, trial.chain, data.model.theta, offsets)
    return _from_mean(np.c_[moved[:, 3:], moved[:, :3]], trial.rows.series.run)


def _from_mean(values: Array, sweep: Sequence[int] | Integers) -> Array:
    """Values less the mean of their sweep: at which posture a sweep was clamped is not known."""
    out = values - np.nan_to_num(np.nanmean(values, axis=0))
    for s in np.unique(sweep):
        inside = np.asarray(sweep) == s
        out[inside] = values[inside] - np.nanmean(values[inside], axis=0)
    return np.asarray(out)


def _pair(value: float, std: float) -> str:
    """``12.34 ± 0.42``, the unit being in the head."""
    return with_std(value, std, Scale(1.0, "")) if np.isfinite(value) else "–"
