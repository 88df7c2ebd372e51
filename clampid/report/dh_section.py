"""The compensated Denavit-Hartenberg table, as the export gives it."""

from __future__ import annotations

import importlib
import math
from typing import Any

from clampid.display import Scale, fixed, with_std
from clampid.models.model import Model
from clampid.report.style import Section, Table, as_table
from clampid.stages.stage_kind import known_of
from kinematics.dh_conversion import DHError
from kinematics.robot import RobotDescription

__all__ = ["dh_section"]

MAX_LENGTH = 100.0  # m: no robot is that long
VAGUE = 0.1  # m, standard error: no position of a robot's axis is known so badly
NOT_DETERMINED = "not determined"


def dh_section(model: Model, robot: RobotDescription) -> Section | None:
    """Section "Compensated DH table"; None without poses or without the export."""
    if known_of(model.stages, "points") is None:
        return None
    try:
        export = importlib.import_module("clampid.exports.dh_export")
    except ModuleNotFoundError:
        return None
    blocks: list[Table] = []
    reasons: list[str] = []
    for convention in ("hayati", "standard"):
        try:
            frame = export.static_table(model, convention, robot=robot)
        except DHError as error:
            reasons.append(f"No table in the {convention} convention: {error}")
            continue
        blocks += _tables(frame, convention)
    text = (
        "A_i = Rz(sign·q_i + θ)·Tz(d)·Tx(a)·Rx(α)·Ry(β); base·A_1⋯A_n·tool is the flange in the instrument's frame. It "
        "holds the geometry only: what depends on load, direction or temperature is not in a DH table. Full precision, "
        "and what that leaves of the model over the workspace: clampid export dh MODEL.json --convention hayati."
    )
    return Section("dh", "Compensated DH table", (text, *reasons), tuple(blocks))


def _tables(frame: Any, convention: str) -> list[Table]:
    """The joints' rows, then base and tool."""
    out = []
    numbered = {"theta_offset_rad": "θ", "d_m": "d", "a_m": "a", "alpha_rad": "α", "beta_rad": "β"}
    placed = {"x_m": "x", "y_m": "y", "z_m": "z", "rx_rad": "rx", "ry_rad": "ry", "rz_rad": "rz"}
    label = frame["row"].astype(str)
    framed = label.isin(["base", "tool"])
    for chosen, columns, what in ((~framed, numbered, "joints"), (framed, placed, "base and tool")):
        part = frame[chosen]
        present = {c: t for c, t in columns.items() if _has_values(part, c, convention)}
        if not len(part) or not present:
            continue
        signed = what == "joints" and "sign" in part.columns
        heads = ["Row", *(["Sign#"] if signed else [])]
        heads += [f"{t}, {'mm' if c.endswith('_m') else 'deg'}#" for c, t in present.items()]
        rows = [
            (str(r["row"]), *([_sign(r["sign"])] if signed else []), *(_cell(r, c) for c in present))
            for _, r in part.iterrows()
        ]
        caption = f"{convention.capitalize()} convention, {what}: value ± one standard error."
        if "d_m" in present and any(NOT_DETERMINED in row for row in rows):
            caption += (
                " d is not determined where the next axis is nearly parallel: the common normal may lie anywhere along "
                "the two, and the offsets cancel. The export has these numbers. Hayati's rows do not have this problem."
            )
        out.append(as_table(heads, rows, caption))
    return out


def _has_values(part: Any, column: str, convention: str) -> bool:
    if column not in part.columns or not part[column].notna().any():
        return False
    return not (convention == "standard" and column == "beta_rad")


def _sign(value: Any) -> str:
    return "+1" if float(value) > 0 else "−1"


def _cell(row: Any, column: str) -> str:
    value, std = float(row[column]), float(row.get(f"std_{column}", math.nan))
    if math.isnan(value):
        return ""
    if column == "d_m" and _anywhere(value, std):
        return NOT_DETERMINED
    scale, decimals = (Scale(1e3, "mm"), 4) if column.endswith("_m") else (Scale(180.0 / math.pi, "deg"), 5)
    if math.isnan(std) or std * scale.factor < 0.5 * 10.0**-decimals:  # what only the convention fixes
        return fixed(value * scale.factor, decimals).rstrip("0").rstrip(".")
    return with_std(value, std, scale, unit=False)


def _anywhere(value: float, std: float) -> bool:
    """Whether an offset along an axis, m, is not determined: the next axis is nearly parallel."""
    return abs(value) > MAX_LENGTH or std > VAGUE
