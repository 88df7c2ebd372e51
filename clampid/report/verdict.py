"""The verdict in sentences, and the evidence for and against every candidate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clampid.display import error_text, error_texts
from clampid.effect import Stage
from clampid.models.model import Model, Round
from clampid.report.evidence import comparison_table, evidence, parameters_text
from clampid.report.placing import placing_tables
from clampid.report.rounds import rounds_of, unit_of
from clampid.report.stage_data import in_order, stage_title
from clampid.report.style import Figure, Section, Table, as_table

__all__ = ["headline", "truth_section", "verdict_section"]

Json = Mapping[str, Any]
MEANING = {
    "adequate": "no missing effect was found",
    "missing": "the candidates are what was missing; no further effect was found",
    "ambiguous": "these data do not settle which effect explains the rest",
    "unknown": "structure is left that no known effect explains",
}


def headline(model: Model, first: Model | None, comparison: Json | None, diagnosis: Json | None) -> list[str]:
    """One or two sentences for each stage: what was found, and the held-out error before and now against the noise."""
    verdicts: Json = (diagnosis or {}).get("stages", {})
    out = []
    for stage in in_order(model.stages):
        found = verdicts.get(stage)
        said = str(found.get("summary") or MEANING.get(found.get("verdict", ""), "")) if found else ""
        parts = [said.rstrip(".") + "." if said else ""]
        if not (found and _states_error(said, found, rounds_of(model, first, stage))):
            parts.append(_fall(model, first, stage, found, comparison))
        text = " ".join(p for p in parts if p)
        if text:
            out.append(f"{stage_title(stage)}: {text}")
    return out


def _states_error(said: str, found: Json, rounds: Sequence[Round]) -> bool:
    """Whether a summary gives the held-out error already, and nothing was added since."""
    after = found.get("heldout_rms_after")
    further = len(rounds) > 1 and (after is None or abs(rounds[-1].heldout_rms / float(after) - 1.0) > 0.02)
    return "held-out" in said.lower() and not further


def _fall(model: Model, first: Model | None, stage: Stage, found: Json | None, comparison: Json | None) -> str:
    unit = unit_of(stage)
    rounds = rounds_of(model, first, stage)
    if len(rounds) > 1:
        ends = error_texts([r.heldout_rms for r in (rounds[0], rounds[-1])], unit)
        floor = error_text(rounds[-1].noise_floor, unit)
        change = rounds[-1].heldout_rms / rounds[0].heldout_rms
        went = f"{'fell' if change < 1 else 'rose'} from {ends[0]} to {ends[1]}"
        if abs(change - 1) < 0.005:
            went = f"stayed at {ends[1]}"
        return f"The held-out error {went}; the noise floor is {floor}."
    if found and found.get("candidates"):
        ends = error_texts([found.get(f"heldout_rms_{when}") for when in ("before", "after")], unit)
        floor = error_text(found.get("noise_floor"), unit)
        fall = f"the held-out error falls from {ends[0]} to {ends[1]}"
        return f"With the candidates below, {fall}; the noise floor is {floor}."
    table = _compared(comparison, stage)
    if table is not None:
        held_out = (table.get("heldout") or {}).get("rms", table.get("rms"))
        floor = error_text(table.get("noise_floor"), unit)
        return f"The held-out error is {error_text(held_out, unit)}; the noise floor is {floor}."
    if rounds:
        held_out, floor = error_text(rounds[-1].heldout_rms, unit), error_text(rounds[-1].noise_floor, unit)
        return f"The held-out error is {held_out}; the noise floor is {floor}."
    return ""


def _compared(comparison: Json | None, stage: str) -> Json | None:
    tables: Json = (comparison or {}).get("tables", {})
    found = tables.get(stage)
    return found if isinstance(found, Mapping) else None


def verdict_section(diagnosis: Json | None, comparison: Json | None) -> Section | None:
    """Section "The verdict and its evidence"."""
    blocks: list[str | Table | Figure] = []
    stages: Json = (diagnosis or {}).get("stages") or {}
    for stage in in_order(stages):
        blocks += [stage_title(stage), *evidence(stages[stage], unit_of(stage))]
    tables: Json = (comparison or {}).get("tables") or {}
    if tables:
        blocks += ["Model against measurement", comparison_table(tables), *placing_tables(tables)]
    notes = (
        "p, alone: asymptotic score test of the candidate by itself. p, family-wise: sign-flip maximum over all "
        "candidates at once; only this one decides. “Adequate” means that no missing effect was found, not "
        "that nothing is there: an effect below its detection limit, or one that these rows cannot test, is not "
        "excluded.",
    )
    paragraphs = tuple(_verdict(stage, stages[stage]) for stage in in_order(stages))
    if not blocks:
        return None
    return Section("verdict", "The verdict and its evidence", paragraphs, tuple(blocks), notes if stages else ())


def _verdict(stage: str, found: Json) -> str:
    title, verdict = stage_title(stage), str(found.get("verdict", ""))
    text = f"{title}: {verdict} – {MEANING[verdict]}." if verdict in MEANING else f"{title}: {verdict}."
    if found.get("depends_on"):
        left = "What is left depends" if verdict == "unknown" else "The residual of the start model depended"
        text += f" {left} on {', '.join(map(str, found['depends_on']))}."
    if found.get("next_measurement"):
        text += f" Next measurement: {_next(found['next_measurement'])}"
    return text


def _next(proposal: Any) -> str:
    if isinstance(proposal, Mapping):
        return "; ".join(f"{k}: {v}" for k, v in proposal.items()) + "."
    return str(proposal).rstrip(".") + "."


def truth_section(truth: Sequence[Json] | None) -> Section | None:
    """Section "What had been hidden", for a demonstration."""
    if truth is None:
        return None
    rows = [
        (str(t.get("effect", "")), str(t.get("where", "")), parameters_text(t.get("parameters") or {})) for t in truth
    ]
    text = (
        "This campaign was measured on the virtual robot. What was hidden in it was read only after the verdict above."
    )
    if not rows:
        return Section("truth", "What had been hidden", (text, "Nothing."))
    return Section("truth", "What had been hidden", (text,), (as_table(("Effect", "At", "Parameters, SI"), rows),))
