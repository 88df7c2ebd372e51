"""Detection limits, and the bias of the model without an effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clampid.diagnosis.limits import limit_rows, not_testable
from clampid.display import length, scale_for, with_std
from clampid.exports.determined import determined_shifts
from clampid.report.style import Table, as_table

__all__ = ["detection_limits", "exported", "shifted"]

Json = Mapping[str, Any]
MOST_SHIFTED = 8
MOST_EXPORTED = 12


def shifted(omission: Sequence[Json]) -> list[Table]:
    """Bias of the model's parameters without the missing effect."""
    rows = []
    for p in determined_shifts(omission)[:MOST_SHIFTED]:
        shift, std = float(p["shift"]), float(p.get("std") or 0.0)
        rows.append((str(p.get("name", "")), with_std(shift, std, scale_for(str(p.get("unit", "")), [shift, std]))))
    caption = (
        "Bias of the model without the effect: how its parameters change when it is added, the most significant first."
    )
    return [as_table(("Parameter", "Shift ± standard error#"), rows, caption)] if rows else []


def exported(shifts: Sequence[Json]) -> list[Table]:
    """Bias of the exported table without the missing effect."""
    rows = []
    for p in shifts[:MOST_EXPORTED]:
        shift, std = float(p["shift"]), float(p["std"])
        value = with_std(shift, std, scale_for(str(p["unit"]), [shift, std]))
        at_flange = length(p["at_flange_m"]) if "at_flange_m" in p else "not known"  # of an earlier version's diagnosis
        rows.append((str(p["row"]), str(p["parameter"]), value, at_flange))
    more = f" {len(shifts) - MOST_EXPORTED} more are not shown." if len(shifts) > MOST_EXPORTED else ""
    caption = (
        "Bias of the exported DH table (Hayati's rows) without the effect: the numbers without it less those with it, "
        f"where that is more than two standard errors, the largest at the flange first.{more}"
    )
    return [as_table(("Row", "Number", "Shift ± standard error#", "At the flange#"), rows, caption)] if rows else []


def detection_limits(testability: Sequence[Json]) -> list[Table]:
    """For each absent effect the size from which it would have been found in 9 of 10 campaigns."""
    groups = "; ".join(f"{', '.join(names)} ({why})" for why, names in not_testable(testability).items())
    caption = (
        "Detection limits: an effect larger than this would have been found with 90 % probability. Given are the "
        "smallest and the largest limit over the places, for the parameter that is seen best."
    )
    caption += f" Not testable here: {groups}." if groups else ""
    rows = limit_rows(testability)
    if rows:
        return [as_table(("Absent effect", "At", "Detection limit"), rows, caption)]
    return [as_table(("Not testable here",), [(groups,)])] if groups else []
