"""How well the robot reaches its poses, as tables: ISO 9283, the universal model's figures, errors about a sample."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from clampid.display import count_text, error_text, number
from clampid.report.style import Table, as_table
from experiments.measures.iso9283 import MEANING

__all__ = ["placing_tables"]

Json = Mapping[str, Any]
_HEADS = ("Metric", "Poses#", "Returns#", "Mean#", "95 % of the mean#", "Largest#", "Scatter alone#")
_ERRORS = ("Errors of", "Rows#", "P mean#", "σ_P#", "P max#")
_ABOUT = ("Radial, rms#", "Largest#", "Along the sphere, rms#", "Largest#")
_WHOSE = (("robot", "the robot as its controller has it"), ("compensated", "compensated with this model"))


def placing_tables(tables: Json) -> list[Table]:
    """ISO 9283 and related figures of a comparison, for each table of poses."""
    out = []
    for name, table in tables.items():
        found = table.get("iso9283")
        if found is not None:
            of = found["compensated_rows"]
            out += [_iso9283(name, words, found[key], of, key) for key, words in _WHOSE if _any_metric(found[key])]
        errors = _errors(name, table)
        if errors is not None:
            out.append(errors)
    return out


def _any_metric(data: Json) -> bool:
    """Whether any metric of ISO 9283 could be computed; without returns to a pose there is none."""
    parts = (data.get(kind) or {} for kind in ("position", "orientation"))
    return any(metric in part for part in parts for metric in MEANING)


def _iso9283(name: str, words: str, data: Json, of: str, key: str) -> Table:
    rows: list[tuple[str, ...]] = []
    said = [f"ISO 9283, {name}, {words}{f' ({of} rows)' if key == 'compensated' else ''}."]
    wanted = data["returns_wanted"]
    missing: dict[str, list[str]] = {}
    for kind, unit in (("position", "m"), ("orientation", "rad")):
        part = data.get(kind)
        if part is None:
            continue
        of_kind = "" if kind == "position" else " of orientation, worst axis"
        for metric, meaning in MEANING.items():
            if metric in part:
                rows.append((f"{metric}, {meaning}{of_kind}", *_cells(part[metric], unit)))
        if "RP_of_30" in part:
            thirty = part["RP_of_30"]
            cells = (_text(thirty["value"], unit), _between(thirty["interval95"], unit))
            rows.append((f"RP as {wanted} returns would show it{of_kind}", "", "", *cells, "", ""))
        if part.get("RP_by_instrument") is not None and "RP_of_30" in part:
            noise = _text(part["RP_by_instrument"], unit)
            rows.append(("RP that the instrument's stated noise alone would show", "", "", noise, "", "", ""))
        for metric, reason in part["not_determinable"].items():
            if metric not in missing.setdefault(reason, []):
                missing[reason].append(metric)
    for reason, metrics in missing.items():
        rows.append((f"{', '.join(metrics)}: not determinable from these data: {reason}", *[""] * (len(_HEADS) - 1)))
    said.append(f"ISO 9283 asks for {wanted} returns to a pose.")
    return as_table(_HEADS, rows, " ".join(said))


def _cells(metric: Json, unit: str) -> tuple[str, ...]:
    fewest, most = metric["returns"]
    interval = metric["interval95"]
    return (
        count_text(int(metric["poses"])), f"{fewest}" if fewest == most else f"{fewest} to {most}",
        _text(metric["mean"], unit), "–" if interval is None else _between(interval, unit),
        _text(metric["max"], unit), "" if metric["by_scatter"] is None else _text(metric["by_scatter"], unit),
    )  # fmt: skip


def _text(value: float | None, unit: str) -> str:
    """An error as the report prints it; angles in µrad."""
    return error_text(value, unit) if unit == "m" or value is None else f"{number(1e6 * value)} µrad"


def _between(ends: Any, unit: str) -> str:
    return " to ".join(_text(end, unit) for end in ends)


def _errors(name: str, table: Json) -> Table | None:
    rows = []
    for words, part, count in (
        ("the robot as its controller has it", table.get("robot") or {}, (table.get("robot") or {}).get("rows")),
        ("held-out rows, compensated", table, (table.get("heldout") or {}).get("rows")),
    ):
        if "universal" not in part:
            continue
        cells = [_text(part["universal"][key], "m") for key in ("P_mean", "P_std", "P_max")]
        if "sample" in part:
            parts = (part["sample"][key] for key in ("radial", "along"))
            cells += [_text(one[what], "m") for one in parts for what in ("rms", "max")]
        rows.append((words, "–" if count is None else count_text(int(count)), *cells))
    if not rows:
        return None
    heads = _ERRORS if len(rows[0]) == len(_ERRORS) else _ERRORS + _ABOUT
    about = "" if heads is _ERRORS else ", and split about the sample"
    return as_table(heads, rows, f"Norms of position errors, {name}{about}.")
