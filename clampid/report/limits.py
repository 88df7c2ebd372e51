"""What could have been found, and what leaving an effect out had done to the model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clampid.report.display import number, scale_for, with_std
from clampid.report.style import Table, as_table

__all__ = ["detection_limits", "exported", "shifted"]

Json = Mapping[str, Any]
MOST_SHIFTED = 8
MOST_EXPORTED = 12


def shifted(omission: Sequence[Json]) -> list[Table]:
    """What the model's parameters had taken up of the missing effect."""
    rows = []
    for p in omission[:MOST_SHIFTED]:
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
        rows.append((str(p["row"]), str(p["parameter"]), value))
    more = f" {len(shifts) - MOST_EXPORTED} more are not shown." if len(shifts) > MOST_EXPORTED else ""
    caption = (
        "What leaving it out had done to the exported DH table (Hayati's rows): the numbers without the effect less "
        f"those with it, as far as they are told from zero, the clearest first.{more}"
    )
    return [as_table(("Row", "Number", "Shift ± standard error#"), rows, caption)] if rows else []


def detection_limits(testability: Sequence[Json]) -> list[Table]:
    """For each absent effect the smallest size that would have been found with 90 % probability, place by place."""
    cells: dict[tuple[str, str, str], dict[str, tuple[float | None, str]]] = {}
    for entry in testability:
        state = str(entry.get("state", ""))
        for limit in entry.get("limits") or ():
            label, _, place = str(limit["name"]).partition("@")
            key = (str(entry.get("name", "")), label.rpartition(".")[2], str(limit.get("unit", "")))
            value = limit.get("limit")
            seen = cells.setdefault(key, {})
            if value is not None and state != "testable" and place in seen:
                continue
            seen[place] = (None if value is None else float(value), state)
    rows = []
    for (effect, parameter, unit), places in cells.items():
        known = [v for v, state in places.values() if v is not None and state == "testable"]
        weak = [p for p, (v, state) in places.items() if v is None or state != "testable"]
        scale = scale_for(unit, known)
        told = [
            f"{place} {number(value / scale.factor, 2)}"
            for place, (value, state) in places.items()
            if value is not None and state == "testable"
        ]
        name = f"{effect} {parameter}" + (f", {scale.unit}" if scale.unit else "")
        rows.append((name, ", ".join(told) or "–", ", ".join(weak) or "–"))
    caption = (
        "Not in the model: sizes above these would have been found with 90 % probability. Hardly testable: the model "
        "takes up nearly all of it on these rows, it does not act on them, or only a size that cannot be would be seen."
    )
    return (
        [as_table(("Effect", "Found with 90 % probability above", "Hardly testable at"), rows, caption)] if rows else []
    )
