"""The screen of ``check``: what the campaign holds, whether it can be used, and the command that fits a model."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from clampid.display import count_text, error_text, places_text
from clampid.screen import Next, Screen, Tone
from clampid.verbs.next_step import free_name

__all__ = ["check_screen", "contents"]

Json = Mapping[str, Any]


def check_screen(
    holds: Json,
    stages: Json,
    findings: Sequence[Json],
    campaign: Path,
    measured: Json,
    stated: Sequence[str],
    more: tuple[Next, ...] = (),
) -> Screen:
    """What ``check`` found.

    Parameters
    ----------
    holds
        As `experiments.checks.check.holdings` gives it.
    stages
        Stage → its standard effects and the others known.
    findings
        Errors, warnings and notes, the most severe first.
    measured
        Metrics of ISO 9283 by table, and repeatability along a line, where they were asked for.
    stated
        What is known beforehand, in words.
    more
        What to do next where the poses are too few for a fit; empty where they are enough.
    """
    facts = [(name, f"{count_text(t['rows'])} rows: {contents(t)}") for name, t in holds["tables"].items()]
    facts += [("known", line) for line in stated]
    for name, table in (measured.get("iso9283") or {}).items():
        position = table["position"]
        found = [f"{key} {error_text(position[key]['mean'], 'm')}" for key in ("AP", "RP") if key in position]
        facts.append((f"{name}, ISO 9283", ", ".join(found) or "not determinable from these data"))
    if "along_a_line" in measured:
        facts.append(("distances, one line", _along_a_line(measured["along_a_line"])))
    counts = {kind: sum(f["severity"] == kind for f in findings) for kind in ("error", "warning", "note")}
    said = [_finding(f) for f in findings]
    for stage, part in stages.items() if not counts["error"] else ():  # nothing is fitted to what is refused
        standard = ", ".join(label.replace("_", " ") for label in part["standard"])
        others = len(set(part["known"]) - set(part["standard"]) - set(part["only_asked"]))
        said.append(f"{stage}: identify fits {standard}; diagnose tests {others} more effects.")
    verdict, tone = _verdict(counts, bool(stages))
    model = free_name(Path("model.json"))
    fit = Next("Next, fit a model:", shlex.join(["clampid", "identify", str(campaign), "-o", str(model)]))
    again = Next("Mend the tables, then check again:", shlex.join(["clampid", "check", str(campaign)]))
    return Screen(
        f"Checked {campaign}: {holds['robot']}, {holds['joints']} joints, instrument: {holds['instrument']}.",
        None,
        tuple(facts),
        verdict,
        tone,
        tuple(said),
        "All effects and findings: --verbose, --json FILE.",
        (again,) if counts["error"] else more or ((fit,) if stages else ()),
    )


def _verdict(counts: Mapping[str, int], fits: bool) -> tuple[str, Tone]:
    if counts["error"]:
        return f"The campaign cannot be used: {_count(counts['error'], 'error')}.", "bad"
    if not fits:
        return "There is no table that a model can be fitted to.", "bad"
    if counts["warning"]:
        return f"The campaign can be used; read {_count(counts['warning'], 'warning')} first.", "open"
    return "The campaign can be used.", "good"


def _along_a_line(found: Json | None) -> str:
    """Repeatability along one line, in words."""
    if found is None:
        return "no place was measured twice from one side"
    words = f"repeatability {error_text(found['one_side'], 'm')} (4 s) from one side"
    if found["both_sides"] is None:
        return words
    both, reversal = (error_text(found[name], "m") for name in ("both_sides", "reversal"))
    return f"{words}, {both} from both; the sides differ by up to {reversal}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}" + ("s" if number > 1 else "")


def _finding(finding: Json) -> str:
    where = finding["table"]
    where += "" if finding["row"] is None else f", row {finding['row']}"
    where += "" if finding["column"] is None else f", {finding['column']}"
    return f"{finding['severity']}: {where}: {finding['message']}"


def _counted(number: int, several: str) -> str:
    return f"{number} {several.removesuffix('s') if number == 1 else several}"


def _single(moved: Sequence[int]) -> str:
    return f"joint {moved[0]} moves" if moved else "no joint moves"


def contents(table: Mapping[str, Any]) -> str:
    """A table's summary in words."""
    words = []
    for key in ("poses", "visits", "replicates", "runs", "sweeps"):
        if table.get(key):
            words.append(_counted(table[key], key))
    if table["duration_s"] is not None:
        seconds = table["duration_s"]
        words.append(f"{seconds / 60:.0f} min" if seconds >= 60.0 else f"{seconds:.0f} s")
    moved = table["joints_moved"]
    words.append(f"{places_text([f'joint{j}' for j in moved])} move" if len(moved) > 1 else _single(moved))
    for key, word in (
        ("targets", "targets"),
        ("anchors", "anchors"),
        ("orientation", "orientations"),
        ("directions", "approach directions"),
        ("velocities", "velocities"),
        ("fixture", "fixture watched"),
        ("temperatures", "temperature sensors"),
    ):
        value = table.get(key)
        if value:
            words.append(_counted(len(value), word) if isinstance(value, list) else word)
    if table.get("variables"):
        words.append(f"also {', '.join(table['variables'])}")
    return "; ".join(words)
