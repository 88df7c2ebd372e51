"""What could have been found, and what leaving an effect out had done to the model."""

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
    """What the model's parameters had taken up of the missing effect."""
    rows = []
    for p in determined_shifts(omission)[:MOST_SHIFTED]:
        shift, std = float(p["shift"]), float(p.get("std") or 0.0)
        rows.append((str(p.get("name", "")), with_std(shift, std, scale_for(str(p.get("unit", "")), [shift, std]))))
    caption = "What leaving it out had done to the model: how its parameters shift with it, the clearest first."
    return [as_table(("Parameter", "Shift ± standard error#"), rows, caption)] if rows else []


def exported(shifts: Sequence[Json]) -> list[Table]:
    """What the exported table had taken up of the missing effect."""
    rows = []
    for p in shifts[:MOST_EXPORTED]:
        shift, std = float(p["shift"]), float(p["std"])
        value = with_std(shift, std, scale_for(str(p["unit"]), [shift, std]))
        rows.append((str(p["row"]), str(p["parameter"]), value, length(p["at_flange_m"])))
    more = f" {len(shifts) - MOST_EXPORTED} more are not shown." if len(shifts) > MOST_EXPORTED else ""
    caption = (
        "What leaving it out had done to the exported DH table (Hayati's rows): the numbers without the effect less "
        f"those with it, as far as they differ from zero, the largest at the flange first.{more}"
    )
    return [as_table(("Row", "Number", "Shift ± standard error#", "At the flange#"), rows, caption)] if rows else []


def detection_limits(testability: Sequence[Json]) -> list[Table]:
    """For each absent effect the size from which it would have been found with 90 % probability, and what is untold."""
    groups = "; ".join(f"{', '.join(names)} ({why})" for why, names in not_testable(testability).items())
    caption = (
        "Detection limits: more than this of an effect that is not in the model would have been found with 90 % "
        "probability; over places the best and the worst, of several parameters the one seen best."
    )
    caption += f" Not testable here: {groups}." if groups else ""
    rows = limit_rows(testability)
    if rows:
        return [as_table(("Absent effect", "At", "Detection limit"), rows, caption)]
    return [as_table(("Not testable here",), [(groups,)])] if groups else []
