"""The verdict in sentences, and the evidence for and against every candidate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clampid.effect import Stage
from clampid.model import Model
from clampid.report.display import count_text, error_text, number, scale_for, stage_title, with_std
from clampid.report.rounds import rounds_of, unit_of
from clampid.report.stage_data import in_order
from clampid.report.style import Section, Table, as_table

__all__ = ["headline", "truth_section", "verdict_section"]

Json = Mapping[str, Any]
MEANING = {
    "adequate": "nothing beyond the noise is left",
    "missing": "the candidates are what was missing; nothing beyond the noise is left after them",
    "ambiguous": "several effects explain the rest equally well on these data",
    "unknown": "structure is left that no known effect explains",
}
MOST_CONSIDERED = 12
MOST_OUTLIERS = 40


def headline(model: Model, first: Model | None, comparison: Json | None, diagnosis: Json | None) -> list[str]:
    """One or two sentences for each stage: what was found, and the held-out error before and now against the noise."""
    verdicts: Json = (diagnosis or {}).get("stages", {})
    out = []
    for stage in in_order(model.stages):
        found = verdicts.get(stage)
        said = str(found.get("summary") or MEANING.get(found.get("verdict", ""), "")) if found else ""
        parts = [said.rstrip(".") + "." if said else "", _fall(model, first, stage, found, comparison)]
        text = " ".join(p for p in parts if p)
        if text:
            out.append(f"{stage_title(stage)}: {text}")
    return out


def _fall(model: Model, first: Model | None, stage: Stage, found: Json | None, comparison: Json | None) -> str:
    unit = unit_of(stage)
    rounds = rounds_of(model, first, stage)
    if len(rounds) > 1:
        ends = [error_text(r.heldout_rms, unit) for r in (rounds[0], rounds[-1])]
        floor = error_text(rounds[-1].noise_floor, unit)
        change = rounds[-1].heldout_rms / rounds[0].heldout_rms
        went = f"{'fell' if change < 1 else 'rose'} from {ends[0]} to {ends[1]}"
        if abs(change - 1) < 0.005:
            went = f"stayed at {ends[1]}"
        return f"The error on rows that no fit saw {went}; noise alone leaves {floor}."
    if found and found.get("candidates"):
        ends = [error_text(found.get(f"heldout_rms_{when}"), unit) for when in ("before", "after")]
        floor = error_text(found.get("noise_floor"), unit)
        fall = f"the held-out error falls from {ends[0]} to {ends[1]}"
        return f"With the candidates below, {fall}; noise alone leaves {floor}."
    table = _compared(comparison, stage)
    if table is not None:
        held = (table.get("heldout") or {}).get("rms", table.get("rms"))
        floor = error_text(table.get("noise_floor"), unit)
        return f"The error on rows that no fit saw is {error_text(held, unit)}; noise alone leaves {floor}."
    if rounds:
        held, floor = error_text(rounds[-1].heldout_rms, unit), error_text(rounds[-1].noise_floor, unit)
        return f"The error on rows that no fit saw is {held}; noise alone leaves {floor}."
    return ""


def _compared(comparison: Json | None, stage: str) -> Json | None:
    tables: Json = (comparison or {}).get("tables", {})
    found = tables.get(stage)
    return found if isinstance(found, Mapping) else None


def verdict_section(diagnosis: Json | None, comparison: Json | None) -> Section | None:
    """Section "The verdict and its evidence"."""
    blocks: list[Table] = []
    notes: list[str] = []
    paragraphs: list[str] = []
    for stage, found in ((diagnosis or {}).get("stages") or {}).items():
        title = stage_title(stage)
        verdict = str(found.get("verdict", ""))
        text = f"{title}: {verdict} – {MEANING[verdict]}." if verdict in MEANING else f"{title}: {verdict}."
        if found.get("depends_on"):
            text += f" The rest depends on {', '.join(map(str, found['depends_on']))}."
        if found.get("next_measurement"):
            text += f" Next measurement: {_next(found['next_measurement'])}"
        paragraphs.append(text)
        unit = str(found.get("unit", unit_of(stage)))
        rows = [_candidate(c, unit) for c in found.get("candidates") or ()]
        if rows:
            caption = f"{title}: what was found, in the order to add it; held-out errors are cumulative."
            blocks.append(as_table(_HEADS, rows, caption))
        considered = list(found.get("considered") or ())
        if considered:
            rows = [_candidate(c, unit) for c in considered[:MOST_CONSIDERED]]
            more = (
                f" {len(considered) - MOST_CONSIDERED} more are not shown." if len(considered) > MOST_CONSIDERED else ""
            )
            blocks.append(as_table(_HEADS, rows, f"{title}: looked at and not confirmed.{more}"))
        blocks += _outliers(title, found.get("outliers") or (), "Nm" if unit == "sigma" else unit)
    if comparison and comparison.get("tables"):
        blocks.append(_comparison(comparison["tables"]))
    if not blocks and not paragraphs:
        return None
    if diagnosis:
        notes.append(
            "p, alone: asymptotic score test of the candidate by itself. p, family-wise: sign-flip maximum over all "
            "candidates at once; only this one decides. “Adequate” means that nothing was found beyond the noise, not "
            "that nothing is there: an effect below the detection limit, or one that these rows cannot test, is not "
            "excluded."
        )
    return Section("verdict", "The verdict and its evidence", tuple(paragraphs), tuple(blocks), tuple(notes))


_HEADS = ("Effect", "At", "p, alone#", "p, family-wise#", "Held out before#", "After#", "Parameters", "Confusable with")


def _candidate(c: Json, unit: str) -> tuple[str, ...]:
    effect = str(c.get("effect", ""))
    return (
        f"{effect} (one of the alternatives)" if c.get("alternative") else effect,
        ", ".join(map(str, c.get("where") or ())),
        _p(c.get("p_value")),
        _p(c.get("p_familywise")),
        error_text(c.get("heldout_rms_before"), unit),
        error_text(c.get("heldout_rms_after"), unit),
        parameters_text(c.get("parameters") or ()),
        "; ".join(_other(o) for o in c.get("confusable_with") or ()) or "–",
    )


def parameters_text(parameters: Sequence[Json] | Json) -> str:
    """Parameters with standard errors in display units: of a verdict, or of what was hidden."""
    if isinstance(parameters, Mapping):
        return ", ".join(f"{k} = {_plain(v)}" for k, v in parameters.items()) or "–"
    out = []
    for p in parameters:
        value, std = float(p.get("value", float("nan"))), float(p.get("std", float("nan")))
        scale = scale_for(str(p.get("unit", "")), [value, std])
        out.append(f"{p.get('name', '')} = {with_std(value, std, scale)}")
    return ", ".join(out) or "–"


def _plain(value: Any) -> str:
    return number(value) if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def _other(other: Any) -> str:
    if isinstance(other, Mapping):
        where = other.get("where") or ()
        places = where if isinstance(where, str) else ", ".join(map(str, where))
        return f"{other.get('effect', '')}{f' @ {places}' if places else ''}"
    return str(other)


def _next(proposal: Any) -> str:
    if isinstance(proposal, Mapping):
        return "; ".join(f"{k}: {v}" for k, v in proposal.items()) + "."
    return str(proposal).rstrip(".") + "."


def _p(value: Any) -> str:
    if value is None:
        return "–"
    p = float(value)
    if p == 0.0:
        return "< 10⁻³⁰⁰"
    return number(p, 2)


def _outliers(title: str, outliers: Sequence[Json], unit: str) -> list[Table]:
    if not outliers:
        return []
    listed = sorted(outliers, key=lambda o: -abs(float(o.get("size") or 0.0)))[:MOST_OUTLIERS]
    rows = [(str(o.get("table", "")), str(o.get("row", "")), error_text(o.get("size"), unit)) for o in listed]
    more = f" The {MOST_OUTLIERS} largest of {len(outliers)}." if len(outliers) > MOST_OUTLIERS else ""
    return [as_table(("Table", "Row#", "Error#"), rows, f"{title}: rows rejected before anything was diagnosed.{more}")]


def _comparison(tables: Json) -> Table:
    rows = []
    for name, t in tables.items():
        unit = str(t.get("unit", ""))
        held = t.get("heldout") or {}
        source = {"replicates": "returns to a pose", "instrument": "instrument's maker"}.get(
            t.get("noise_source"), "the log itself"
        )
        cells = [t.get("rms"), t.get("max"), held.get("rms"), held.get("max"), t.get("noise_floor")]
        count = count_text(int(held["rows"])) if held.get("rows") else "–"
        rows.append(
            (
                stage_title(name),
                *(error_text(c, unit) for c in cells[:2]),
                count,
                *(error_text(c, unit) for c in cells[2:]),
                source,
            )
        )
        for k, motor in enumerate(t.get("per_motor") or (), 1):
            out = motor.get("heldout") or {}
            numbers = (motor.get("rms_Nm"), None, out.get("rms_Nm"), None, motor.get("noise_floor_Nm"))
            texts = [error_text(v, "Nm") for v in numbers]
            r2 = f"R² {number(out['r2'], 4)} held out" if out.get("r2") is not None else ""
            rows.append((f"    motor {k}", *texts[:2], "", *texts[2:], r2))
    heads = (
        "Table",
        "RMS, fitted#",
        "Largest#",
        "Rows held out#",
        "RMS, held out#",
        "Largest#",
        "Noise alone#",
        "Known from",
    )
    return as_table(heads, rows, "Model against measurement, table by table.")


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
