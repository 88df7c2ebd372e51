"""Comparisons, diagnoses and additions as tables for people, from the same dictionaries that programs get."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clampid.diagnosis.headline import equally_good, is_known
from clampid.diagnosis.headline import listed as joined
from clampid.display import error_text, error_texts, number, places_text, ranged, readable, with_error
from clampid.exports.determined import determined_shifts
from clampid.verbs.limits import show_limits, show_plan
from clampid.verbs.output import Output
from clampid.verbs.placing import show_placing

__all__ = ["extrapolating_text", "show_addition", "show_comparison", "show_diagnosis", "where_text"]

MOST_LISTED_PARAMETERS = 40  # parameters of one effect at one place, beyond which nobody reads them one by one
FIXED = 1e-6  # of its value: a smaller standard error is rounding; the parameter is fixed
WORDS = {
    "adequate": "nothing is missing",
    "missing": "an effect is missing",
    "ambiguous": "two or more effects explain it equally well",
    "unknown": "structure is left that no known effect explains",
}


def show_comparison(data: Mapping[str, Any], out: Output) -> None:
    """Table by table: the error on fitted rows, on held-out rows, and the noise floor."""
    rows, motors = [], []
    for name, table in data["tables"].items():
        unit, held_out = table["unit"], table.get("heldout") or {}
        floor = error_text(table.get("noise_floor"), unit)
        source = f" ({table['noise_source'].replace('_', ' ')})" if "noise_source" in table else ""
        both = [("fitted", table), ("held out", held_out)]
        if held_out and all(table.get(key) == held_out.get(key) for key in ("rows", "rms")):
            both = both[1:]  # nothing of this campaign was fitted
        for which, part in both:
            errors = [error_text(part.get(key), unit) for key in ("rms", "mean", "max")]
            rows.append((name, which, f"{part.get('rows', '')}", *errors, floor + source))
        for k, motor in enumerate(table.get("per_motor", ()), 1):
            held_motor = motor.get("heldout") or {}
            cells = (motor.get("rms_Nm"), held_motor.get("rms_Nm"), motor.get("noise_floor_Nm"))
            shares = (motor.get("r2"), held_motor.get("r2"))
            motors.append((name, f"motor {k}", *(_number(v) for v in cells), *(_number(v, 5) for v in shares)))
    columns = ("table", "", "rows", "rms", "mean", "max", "noise floor")
    out.table("model against measurement", columns, rows, left=2)
    if any(table.get("measured") == "distances" for table in data["tables"].values()):
        out.say("distances: errors are of measured distances, one number each, not of points")
    for name, table in data["tables"].items():
        held_out = table.get("heldout") or {}
        if wrong := held_out.get("outliers"):
            listed = ", ".join(map(str, wrong[:8])) + (f" and {len(wrong) - 8} more" if len(wrong) > 8 else "")
            whole = error_text(held_out["rms_with_outliers"], table["unit"])
            out.say(f"{name}: held-out rows left out as wrong: verification row {listed}; with them rms {whole}")
        beyond = table.get("extrapolating")
        if beyond and beyond["rows"]:
            what = extrapolating_text(beyond["quantities"])
            out.say(f"{name}: extrapolating: {what}, in {beyond['rows']} of {beyond['of']} held-out rows")
        far = table.get("extrapolated")
        if far and far["share"]:
            joints = ", ".join(f"{joint} {100 * share:.0f} %" for joint, share in far["joints"].items())
            share = f"{100 * far['share']:.0f} %"
            one = f"; {where_text(far['one_curve'])} are on one curve and count together" if "one_curve" in far else ""
            out.say(
                f"{name}: {share} of the held-out rows stand at joint angles that no fitted pose was near, where their "
                f"curve is extrapolated: {joints}{one}"
            )
        show_placing(name, table, out)
    if motors:
        heads = ("table", "", "rms [Nm]", "rms held out [Nm]", "noise floor [Nm]", "R²", "R² held out")
        out.table("motor torques", heads, motors, left=2)

    if (data.get("compensation") or {}).get("summary"):
        out.say(f"poses: {data['compensation']['summary']}")
    if "drives" in data:
        _show_agreement(data["drives"], out)


def extrapolating_text(quantities: Sequence[Mapping[str, Any]]) -> str:
    """Joint by joint: the range that is asked for, and the range on which the model was identified."""
    parts: dict[str, list[str]] = {}
    for found in quantities:
        value, unit = found["value"], found["unit"]
        middle = 0.5 * sum(found["identified"])
        word, edge = ("to", found["identified"][1]) if value > middle else ("from", found["identified"][0])
        here, known = (ranged(v, unit) for v in (value, edge))
        parts.setdefault(found["at"], []).append(f"{found['quantity']} {word} {here}, identified {word} {known}")
    return ", ".join(f"{_place(at)} ({'; '.join(said)})" for at, said in parts.items())


def _place(at: str) -> str:
    """``joint 2`` of ``joint2``."""
    name = at.rstrip("0123456789")
    return f"{name} {at.removeprefix(name)}".rstrip()


def _show_omission(shifted: Sequence[Mapping[str, Any]], out: Output) -> None:
    """Bias of each parameter without the missing effect, and the same in standard errors."""
    rows = []
    for p in determined_shifts(shifted):
        off = with_error(p["shift"], p["std"], p["unit"])
        rows.append((p["name"], off, f"{abs(p['shift']) / p['std']:.1f}"))
    if rows:
        out.table("biased by what was missing", ("parameter", "too large by", "in standard errors"), rows)


def _show_agreement(data: Mapping[str, Any], out: Output) -> None:
    """Springs and clearances from clamped sweeps and from poses, where these contradict each other."""
    rows = []
    for p in data["parameters"]:
        both = (with_error(p[stage], _nan(p[f"{stage}_std"]), p["unit"]) for stage in ("clamped", "poses"))
        rows.append((p["parameter"], p["where"], *both, _number(p["z"], 2), _number(p["p_value"], 2), p["verdict"]))
    out.table("clamped sweeps against poses", ("", "at", "clamped", "poses", "z", "p", ""), rows, left=2)
    if data["p_value"] is not None:
        out.say(f"all together: p = {_number(data['p_value'], 2)}")


def show_diagnosis(data: Mapping[str, Any], out: Output) -> None:
    """Stage by stage: the verdict in a sentence, the candidates with their evidence, what to measure next."""
    for stage, part in data["stages"].items():
        out.say(f"{stage} ({part['verdict']}): {part.get('summary') or WORDS.get(part['verdict'], '')}")
        candidates, unit = part["candidates"], part["unit"]
        if candidates:
            columns = ("effect", "at", "p", "p of the family", "held out, before", "after")
            good = equally_good(candidates)
            out.table("", columns, [_candidate(candidate, unit, candidate in good) for candidate in candidates], left=2)
            parameters = [p for candidate in candidates for p in candidate["parameters"]]
            known = [p for p in parameters if is_known(p)]
            if known:
                out.table("", ("parameter", "value"), _values(known))
            if len(known) < len(parameters):
                names = [str(p["name"]) for p in parameters if p not in known]
                out.say(f"  not identifiable: {joined(names, 12)}")
            beyond = [str(p["name"]) for p in known if p.get("beyond_limit")]
            if beyond:
                out.say(f"  above its physical limit, and may stand for another effect: {joined(beyond, 12)}")
            _show_caveats(candidates, out)
        _show_omission(part.get("omission") or (), out)
        for found in part.get("simpler", ()):
            out.say(f"  {found['summary']}; to fit it: clampid add {stage}={found['name']} MODEL CAMPAIGN -o MENDED")
        if part.get("depends_on"):
            out.say(f"  the residual depends on {', '.join(part['depends_on'])}")
        show_limits(part.get("testability") or (), out)
        if part.get("next_measurement"):
            out.say(f"  next measurement: {part['next_measurement']}")
        if part.get("next_plan"):
            show_plan(part["next_plan"], out)
        if part.get("outliers"):
            listed = ", ".join(f"{o['table']} row {o['row']}" for o in part["outliers"][:8])
            more = len(part["outliers"]) - 8
            out.say(f"  rejected as outliers: {listed}{f' and {more} more' if more > 0 else ''}")


def _candidate(candidate: Mapping[str, Any], unit: str, good: bool) -> tuple[str, ...]:
    """A row of the table; of alternatives, whether it explains the data as well as the best."""
    which = ("or " if good else "less good: ") if candidate.get("alternative") else ""
    return (
        which + candidate.get("name", candidate["effect"]),
        where_text(candidate["where"]) if isinstance(candidate["where"], str) else places_text(candidate["where"]),
        _number(candidate.get("p_value"), 2),
        _number(candidate.get("p_familywise"), 2),
        *error_texts([candidate.get("heldout_rms_before"), candidate.get("heldout_rms_after")], unit),
    )


def show_addition(data: Mapping[str, Any], out: Output) -> None:
    """Stage by stage: what was added, and what the error was and is."""
    for stage, part in data["stages"].items():
        unit = part["unit"]
        before, after = error_texts([part[f"heldout_rms_{when}"] for when in ("before", "after")], unit)
        floor = error_text(part["noise_floor"], unit)
        out.say(f"{stage}: on held-out rows {before} before, {after} after; noise floor {floor}")
        rows = []
        for added in part["added"]:
            values = _values(added["parameters"])
            name = added.get("name", added["effect"])
            rows += [(name, where_text(added["where"]), *named) for named in values]
        out.table("", ("added", "at", "parameter", "value"), rows, left=3)
        _show_caveats(part["added"], out)
        if part.get("exported_shift"):
            from clampid.diagnosis.omission import shift_in_words

            out.say(shift_in_words(part["exported_shift"]))


def _show_caveats(entries: Sequence[Mapping[str, Any]], out: Output) -> None:
    """What the standard errors of some effects do not include."""
    for said in dict.fromkeys(entry["caveat"] for entry in entries if "caveat" in entry):
        out.say(f"  {said}")


def _values(parameters: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Parameter and value; of an effect with very many at a place, their number and their root sum of squares."""
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for p in parameters:
        effect, _, place = str(p["name"]).partition("@")
        groups.setdefault((effect.partition(".")[0], place), []).append(p)
    out = []
    for (effect, place), own in groups.items():
        if len(own) <= MOST_LISTED_PARAMETERS:
            out += [(p["name"], _value(p)) for p in own]
            continue
        total = sum(p["value"] ** 2 for p in own) ** 0.5
        spread = sum(p["std"] ** 2 for p in own if p.get("std") is not None) ** 0.5
        name = f"{effect}@{place}, {len(own)} numbers, root sum of squares"
        out.append((name, with_error(total, spread, own[0]["unit"])))
    return out


def _value(p: Mapping[str, Any]) -> str:
    """A value with its standard error; of a constant that the fit holds, without one."""
    std = _nan(p.get("std"))
    if p.get("std") is None or std < FIXED * abs(p["value"]):
        return f"{readable(p['value'], p['unit'])} (fixed)"
    return with_error(p["value"], std, p["unit"])


def where_text(where: str | Sequence[str]) -> str:
    """Places, as one reads them."""
    return where if isinstance(where, str) else ", ".join(where)


def _number(value: float | None, digits: int = 3) -> str:
    return "–" if value is None else number(value, digits)


def _nan(value: float | None) -> float:
    return float("nan") if value is None else value
