"""The evidence of a verdict as tables: candidates, what was not confirmed, detection limits, outliers, errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clampid.diagnosis.headline import is_known
from clampid.display import Scale, count_text, error_text, error_texts, number, scale_for, with_std
from clampid.report.limits import detection_limits, exported, shifted
from clampid.report.style import Table, as_table

__all__ = [
    "BEYOND_LIMIT",
    "UNCERTAIN",
    "comparison_table",
    "confusable_text",
    "evidence",
    "explained_marks",
    "filled_table",
    "p_text",
    "parameters_text",
    "places_text",
]

Json = Mapping[str, Any]
FLOOR_FROM = {
    "replicates": "returns to a pose",
    "instrument": "instrument's maker",
    "repeated_runs": "runs of one motion",
    "regression": "a regression",
}
MOST_CONSIDERED = 12
MOST_OUTLIERS = 40
MOST_PARAMETERS = 80
MOST_IN_A_CELL = 6  # parameters; more have a table of their own
UNCERTAIN = "uncertain"
BEYOND_LIMIT = "above its limit"
_COMPARED = "Root mean square errors of the fitted and of the held-out rows, and the noise floor."
_FOUND = "What was found, in the order to add it; held-out errors are cumulative."
MARKS = {
    UNCERTAIN: "the data exclude zero, but the standard error is larger than the parameter usually is.",
    BEYOND_LIMIT: "the value is larger than is physically plausible. The effect may stand for another one that moves "
    "the points in the same way. Use it inside the measured range only.",
}
_HEADS = (
    "Effect",
    "At",
    "p, alone#",
    "p, family-wise#",
    "p, held out#",
    "Held out before#",
    "After#",
    "Parameters",
    "Confusable with",
)
_LOOKED = ("Effect", "At", "p, alone#", "p, family-wise#", "Held out before#", "After#", "Remark", "Confusable with")


def evidence(found: Json, unit: str) -> list[Table]:
    """The tables of one stage's verdict."""
    unit = str(found.get("unit", unit))
    out = []
    rows = [_candidate(c, unit) for c in found.get("candidates") or ()]
    if rows:
        out.append(filled_table(_HEADS, rows, f"{_FOUND}{_explained(found['candidates'])}"))
    out += [_of_places(c) for c in found.get("candidates") or () if _has_a_table(c)]
    named = {(_name(c), places_text(c)) for c in found.get("candidates") or ()}
    looked = _once([c for c in found.get("considered") or () if (_name(c), places_text(c)) not in named])
    if looked:
        shown = max(MOST_CONSIDERED, sum("reason" in c for c in looked))  # all that were fitted and refused
        more = f" {len(looked) - shown} more are not shown." if len(looked) > shown else ""
        rows = [_looked_at(c, unit) for c in looked[:shown]]
        out.append(filled_table(_LOOKED, rows, f"Looked at and not confirmed.{more}"))
    out += shifted(found.get("omission") or ())
    out += exported(found.get("exported_shift") or ())
    out += detection_limits(found.get("testability") or ())
    return out + _outliers(found.get("outliers") or (), "Nm" if unit == "sigma" else unit)


def explained_marks(texts: Sequence[str]) -> str:
    """What the marks beside some values mean; empty where there are none."""
    return "".join(f" “({mark})”: {meaning}" for mark, meaning in MARKS.items() if any(f"({mark})" in t for t in texts))


def _explained(candidates: Sequence[Json]) -> str:
    return explained_marks([_identified(c) for c in candidates])


def filled_table(heads: Sequence[str], rows: Sequence[Sequence[str]], caption: str) -> Table:
    """A table without its empty columns."""
    kept = [k for k in range(len(heads)) if any(row[k] not in ("", "–") for row in rows)]
    return as_table([heads[k] for k in kept], [[row[k] for k in kept] for row in rows], caption)


def _once(considered: Sequence[Json]) -> list[Json]:
    """Each effect and place once, the most likely of its shapes; first those that were fitted and refused."""
    best: dict[tuple[str, str], Json] = {}
    for c in considered:
        key = (_name(c), places_text(c))
        if key not in best or _order(c) < _order(best[key]):
            best[key] = c
    return sorted(best.values(), key=_order)


def _order(c: Json) -> tuple[bool, float, float]:
    family, alone = (1.0 if c.get(k) is None else float(c[k]) for k in ("p_familywise", "p_value"))
    return "reason" not in c, family, alone


def places_text(c: Json) -> str:
    """Where a candidate is."""
    where = c.get("where") or ()
    return where if isinstance(where, str) else ", ".join(map(str, where))


def _candidate(c: Json, unit: str) -> tuple[str, ...]:
    effect = _name(c)
    return (
        f"{effect} (one of the alternatives)" if c.get("alternative") else effect,
        places_text(c),
        p_text(c.get("p_value")),
        p_text(c.get("p_familywise")),
        p_text(c.get("p_held_out")),
        *error_texts([c.get("heldout_rms_before"), c.get("heldout_rms_after")], unit),
        _identified(c),
        confusable_text(c),
    )


def _name(c: Json) -> str:
    """The effect as the catalogue calls it, not its family."""
    return str(c.get("name") or c.get("effect") or "")


def _identified(c: Json) -> str:
    """The parameters that the data determine, with their values, and how many others there are."""
    every = [{**p, "name": _short(str(p.get("name", "")), c)} for p in c.get("parameters") or ()]
    known = [p for p in every if is_known(p)]
    if _has_a_table(c):
        return f"{len(every)} numbers, in a table below"
    if len(known) == len(every) or len(every) > MOST_PARAMETERS:
        return parameters_text(every)
    text = parameters_text(known) if known else ""
    return f"{text}; {len(every) - len(known)} not identifiable" if text else "not identifiable"


def _has_a_table(c: Json) -> bool:
    """Whether the parameters of a candidate are too many for a cell, and few enough for a table."""
    return MOST_IN_A_CELL < len(c.get("parameters") or ()) <= MOST_PARAMETERS


def _short(name: str, c: Json) -> str:
    """A parameter's name without what its row says already."""
    name = name.removeprefix(f"{_name(c)}.")
    return name.removesuffix(f"@{places_text(c)}")


def _looked_at(c: Json, unit: str) -> tuple[str, ...]:
    state = str(c.get("state") or "testable")
    remarks = [str(c[key]) for key in ("reason", "stand_in") if c.get(key)]
    if c.get("depends_on"):
        remarks.append(f"depends on {', '.join(map(str, c['depends_on']))}")
    if state != "testable":
        remarks.append(
            f"{state}: the fitted parameters explain all but {number(100 * float(c.get('retained') or 0.0), 2)} % of it"
        )
    return (
        _name(c),
        places_text(c),
        p_text(c.get("p_value")),
        p_text(c.get("p_familywise")),
        *error_texts([c.get("heldout_rms_before"), c.get("heldout_rms_after")], unit),
        "; ".join(remarks) or "–",
        confusable_text(c),
    )


def confusable_text(c: Json) -> str:
    """The effects that a candidate is most confusable with; variants of one effect at one place once."""
    return "; ".join(dict.fromkeys(_other(o) for o in c.get("confusable_with") or ())) or "–"


def _other(other: Any) -> str:
    if isinstance(other, Mapping):
        return f"{other.get('effect', '')}{f' @ {places_text(other)}' if other.get('where') else ''}"
    return str(other)


def parameters_text(parameters: Sequence[Json] | Json) -> str:
    """Parameters with standard errors in display units: of a verdict, or of what was hidden."""
    if isinstance(parameters, Mapping):
        return ", ".join(f"{k} = {_plain(v)}" for k, v in parameters.items()) or "–"
    if len(parameters) > MOST_PARAMETERS:
        return f"{len(parameters)} numbers, drawn as curves below"
    out = []
    for p in parameters:
        value, std = float(p.get("value", float("nan"))), float(p.get("std", float("nan")))
        scale = scale_for(str(p.get("unit", "")), [value, std])
        out.append(f"{p.get('name', '')} = {with_std(value, std, scale)}{marked(p)}")
    return ", ".join(out) or "–"


def marked(p: Json) -> str:
    """What a reader must know of a fitted value before using it."""
    if p.get("beyond_limit"):
        return f" ({BEYOND_LIMIT})"
    return "" if p.get("identified", True) else f" ({UNCERTAIN})"


def _of_places(c: Json) -> Table:
    """The parameters of an effect that has too many for a cell: places by parameters."""
    every = [{**p, "name": str(p.get("name", "")).removeprefix(f"{_name(c)}.")} for p in c["parameters"]]
    at: dict[str, dict[str, Json]] = {}
    for p in every:
        parameter, _, place = p["name"].partition("@")
        at.setdefault(place, {})[parameter] = p
    names = list(dict.fromkeys(p["name"].partition("@")[0] for p in every))
    own = {name: [row[name] for row in at.values() if name in row] for name in names}
    scales = {name: scale_for(str(ps[0].get("unit", "")), [float(p["value"]) for p in ps]) for name, ps in own.items()}
    heads = [f"{name}, {scales[name].unit}#" if scales[name].unit else f"{name}#" for name in names]
    rows = [
        (place, *(_numbered(row[name], scales[name]) if name in row else "" for name in names))
        for place, row in at.items()
    ]
    return as_table(("At", *heads), rows, f"Parameters of {_name(c)}: value ± one standard error.")


def _numbered(p: Json, scale: Scale) -> str:
    if not is_known(p):
        return "not identifiable"
    std = float("nan") if p.get("std") is None else float(p["std"])
    return f"{with_std(float(p['value']), std, scale, unit=False)}{marked(p)}"


def _plain(value: Any) -> str:
    return number(value) if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def p_text(value: Any) -> str:
    """A p-value to two digits."""
    if value is None:
        return "–"
    p = float(value)
    if p == 0.0:
        return "< 10⁻³⁰⁰"
    return number(p, 2)


def _outliers(outliers: Sequence[Json], unit: str) -> list[Table]:
    if not outliers:
        return []
    listed = sorted(outliers, key=lambda o: -abs(float(o.get("size") or 0.0)))[:MOST_OUTLIERS]
    rows = [(str(o.get("table", "")), str(o.get("row", "")), error_text(o.get("size"), unit)) for o in listed]
    more = f" The {MOST_OUTLIERS} largest of {len(outliers)}." if len(outliers) > MOST_OUTLIERS else ""
    return [as_table(("Table", "Row#", "Error#"), rows, f"Rows rejected before anything was diagnosed.{more}")]


def comparison_table(tables: Json) -> Table:
    """Model against measurement, table by table and motor by motor."""
    rows = []
    for name, t in tables.items():
        unit = str(t.get("unit", ""))
        held_out = t.get("heldout") or {}
        source = FLOOR_FROM.get(str(t.get("noise_source")), "the log itself")
        cells = [t.get("rms"), t.get("max"), held_out.get("rms"), held_out.get("max"), t.get("noise_floor")]
        count = count_text(int(held_out["rows"])) if held_out.get("rows") else "–"
        rows.append(
            (
                name,
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
            if all(v is None for v in numbers[:4]):  # it stood still
                continue
            r2 = f"R² {number(out['r2'], 4)} held out" if out.get("r2") is not None else ""
            rows.append((f"    motor {k}", *texts[:2], "", *texts[2:], r2))
    heads = (
        "Table",
        "RMS, fitted#",
        "Largest#",
        "Rows held out#",
        "RMS, held out#",
        "Largest#",
        "Noise floor#",
        "Known from",
    )
    return as_table(heads, rows, _COMPARED)
