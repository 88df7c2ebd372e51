"""ISO 9283, the universal model's figures and errors about a sample as tables for people."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from clampid.display import error_text, number, ranged_text
from clampid.verbs.output import Output

__all__ = ["show_iso9283", "show_placing"]

KINDS = (("position", "", "m"), ("orientation", " of angle", "microrad"))
POSITION_NAMES = {
    "AP": "AP, accuracy",
    "RP": "RP, from one side",
    "RP_bidirectional": "RP, all sides",
    "vAP": "vAP, between sides",
    "dAP": "dAP, drift of AP",
    "dRP": "dRP, drift of RP",
}
ANGLES = {
    "AP": "AP angle",
    "RP": "RP angle, one side",
    "RP_bidirectional": "RP angle, all sides",
    "vAP": "vAP angle",
    "dAP": "dAP angle",
    "dRP": "dRP angle",
}
MEASURED = "as its controller has it, base and targets fitted to these rows"
ALONE = "what the returns' scatter alone would show"


def show_placing(name: str, table: Mapping[str, Any], out: Output) -> None:
    """ISO 9283 of one table of poses: the uncorrected robot, and the robot corrected by the model."""
    found = table.get("iso9283")
    if found is not None:
        _show_both(name, found, out)
    rows = []
    for words, part in (("the robot, all rows", table.get("robot") or {}), ("compensated, held out", table)):
        if "universal" in part:
            sizes = [error_text(part["universal"][key], "m") for key in ("P_mean", "P_std", "P_max")]
            if "sample" in part:
                parts = (part["sample"][key] for key in ("radial", "along"))
                sizes += [error_text(one[what], "m") for one in parts for what in ("rms", "max")]
            rows.append((words, *sizes))
    if rows:
        heads = ("position errors", "P mean", "σ_P", "P max", "radial rms", "max", "along rms", "max")
        out.table("", heads[: len(rows[0])], rows)
        if len(rows[0]) == len(heads):
            out.say(f"{name}: radial and along the sphere are about the sample")


def show_iso9283(name: str, data: Mapping[str, Any], out: Output) -> None:
    """The metrics of the uncorrected robot, with their intervals and the share of scatter."""
    rows = [
        (label, f"{m['poses']}", _to(m["returns"]), *_sizes(m, unit), _alone(m, unit))
        for label, m, unit in _metrics(data)
    ]
    if rows:
        heads = ("", "poses", "returns", "mean", "95 % of mean", "largest", "scatter alone")
        out.table(f"{name}: ISO 9283, the robot as its controller has it", heads, rows)
        out.say(f"{name}: {MEASURED}; angles: of the worst axis; scatter alone: {ALONE}")
    _show_thirty(name, data, out)
    _show_missing(name, data, out)
    if "universal" in data:
        mean, spread, most = (error_text(data["universal"][key], "m") for key in ("P_mean", "P_std", "P_max"))
        out.say(f"{name}: position errors of the robot, all rows: P mean {mean}, σ_P {spread}, P max {most}")


def _show_both(name: str, found: Mapping[str, Any], out: Output) -> None:
    robot, model = found["robot"], {label: (m, unit) for label, m, unit in _metrics(found["compensated"])}
    here = list(_metrics(robot))
    rows = [
        (label, *_sizes(m, unit), *(_sizes(*model[label]) if label in model else ("–",) * 3), _alone(m, unit))
        for label, m, unit in here
    ]
    if rows:
        heads = ("", "robot", "95 % of mean", "largest", "compensated", "95 % of mean", "largest", "scatter")
        out.table(f"{name}: ISO 9283, mean over places", heads, rows)
        poses = _to({m["poses"] for _, m, _ in here})
        returns = _to({count for _, m, _ in here for count in m["returns"]})
        count = max((m["poses"] for m, _ in model.values()), default=0)
        of = "held-out rows" if found["compensated_rows"] == "held out" else "all rows, fitted ones among them"
        minutes = robot["position"]["span_s"] / 60
        out.say(
            f"{name}: {poses} poses with {returns} returns (ISO 9283 asks for {robot['returns_wanted']}), drift over "
            f"up to {number(minutes)} min"
        )
        out.say(
            f"{name}: robot: {MEASURED}; compensated: with this model, {of} ({count} poses); "
            f"angles: of the worst axis; scatter: {ALONE}"
        )
    _show_thirty(name, robot, out)
    _show_missing(name, robot, out)
    thirty = robot["position"].get("RP_of_30")
    differ = found["reported_angles_differ_m"]
    if thirty is not None and differ > 0.1 * thirty["value"]:
        out.say(
            f"{name}: joint angles reported at returns to one pose differ, by up to {error_text(differ, 'm')} at the "
            "point; that counts as scatter of the robot"
        )


def _metrics(data: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any], str]]:
    """Label, metric and unit of all that there are."""
    for kind, _, unit in KINDS:
        part = data.get(kind) or {}
        for key, name in (POSITION_NAMES if kind == "position" else ANGLES).items():
            if key in part:
                yield name, part[key], unit


def _sizes(metric: Mapping[str, Any], unit: str) -> tuple[str, str, str]:
    interval = "–" if metric["interval95"] is None else ranged_text(metric["interval95"], unit)
    return error_text(metric["mean"], unit), interval, error_text(metric["max"], unit)


def _to(counts: Collection[int]) -> str:
    """``2 to 30``, or one number where they are equal."""
    return " to ".join(f"{count}" for count in sorted({min(counts), max(counts)}))


def _alone(metric: Mapping[str, Any], unit: str) -> str:
    return "" if metric["by_scatter"] is None else error_text(metric["by_scatter"], unit)


def _show_thirty(name: str, data: Mapping[str, Any], out: Output) -> None:
    for kind, words, unit in KINDS:
        part = data.get(kind) or {}
        if "RP_of_30" not in part:
            continue
        thirty, instrument = part["RP_of_30"], part.get("RP_by_instrument")
        noise = "" if instrument is None else f"; the instrument's stated noise alone: {error_text(instrument, unit)}"
        out.say(
            f"{name}: RP{words} as {data['returns_wanted']} returns would show it: "
            f"{error_text(thirty['value'], unit)} (95 %: {ranged_text(thirty['interval95'], unit)}){noise}"
        )


def _show_missing(name: str, data: Mapping[str, Any], out: Output) -> None:
    missing: dict[str, dict[str, None]] = {}
    for kind, _, _ in KINDS:
        for key, reason in (data.get(kind) or {}).get("not_determinable", {}).items():
            missing.setdefault(reason, {})[key] = None
    for reason, keys in missing.items():
        which: Sequence[str] = () if len(keys) == len(POSITION_NAMES) else (", ".join(keys), "")
        out.say(f"{name}: ISO 9283: {' '.join(which)}not determinable from these data: {reason}")
