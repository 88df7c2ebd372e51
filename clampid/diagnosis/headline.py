"""A diagnosis in one sentence of at most 25 words, and in short notes, from the dictionary that programs get."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

from clampid.display import error_text, error_texts, floor_text, length, number, places_text, with_error
from clampid.stages.stage_kind import kind_of

__all__ = [
    "MOST_WORDS",
    "Outcome",
    "as_added",
    "at_error",
    "equally_good",
    "headline",
    "is_known",
    "left_out_text",
    "listed",
    "named",
    "notes",
    "outcome",
    "worth_naming",
]

Json = Mapping[str, Any]
Outcome = Literal["good", "open"]
MOST_WORDS = 25
AS_GOOD = 1.5
"""An alternative explains the rest as well as another only if its held-out error is at most so many times as large."""
PLACELESS = ("base", "instrument", "tool", "robot", "fixture")
OUTLIERS_WORTH_A_WORD = 3
MEASURABLE = 1e-5
"""m at the flange, about what a laser tracker resolves: a smaller shift of the exported table is not named."""
UNDECIDED_IN_WORDS = {
    "ambiguous": "several effects explain what is left equally well",
    "unknown": "no known effect explains the rest",
}
"""What is left, where there is no room to name it."""


def named(name: str, places: Sequence[str]) -> str:
    """``gear eccentricity at joint 2``: an effect by its name in the catalogue, and where it acts."""
    shown = [p for p in places if p not in PLACELESS and not p.startswith("session")]
    words = name.replace("_", " ")
    if not shown:
        return words
    at = places_text(shown)
    if len(shown) == 1:
        kind = shown[0].rstrip("0123456789")
        at = f"{kind} {shown[0].removeprefix(kind)}".rstrip()
    return f"{words} at {at}"


def equally_good(candidates: Sequence[Json]) -> list[Json]:
    """The alternatives that may be offered as equally good.

    One whose parameters the data do not determine, or which leaves a clearly larger held-out error than the best of its
    group, is not among them.
    """
    groups: dict[int, list[Json]] = {}
    for c in candidates:
        if c["alternative"]:
            groups.setdefault(c.get("group", 0), []).append(c)
    out: list[Json] = []
    for group in groups.values():
        determined = [c for c in group if _determined(c)] or group
        errors = [c["heldout_rms_after"] for c in determined if c.get("heldout_rms_after") is not None]
        least = min(errors, default=math.inf)
        out += [c for c in determined if (c.get("heldout_rms_after") or least) <= AS_GOOD * least]
    return out


def _determined(candidate: Json) -> bool:
    known = [bool(p["identified"]) for p in candidate.get("parameters", ()) if "identified" in p]
    return any(known) or not known


def headline(stages: Json, mended: bool = False) -> str:
    """The verdict on all stages in one sentence of at most 25 words.

    Parameters
    ----------
    stages
        Stage → what the JSON of ``diagnose`` has for it.
    mended
        Whether what was missing has been added to the model.
    """
    sentences = list(_variants(stages, mended))
    return next((s for s in sentences if len(s.split()) <= MOST_WORDS), sentences[-1])


def as_added(stages: Json, added: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """A diagnosis whose confirmed candidates are what the model has of them now.

    One curve for several joints takes the place of a curve for each. A verdict on the mended model names what is in it.

    Parameters
    ----------
    stages
        Stage → what the JSON of ``diagnose`` has for it.
    added
        Stage → the terms that were added and are still in the model, such as ``backlash@joint2``.
    """
    out = dict(stages)
    for stage, labels in added.items():
        candidates = stages[stage]["candidates"] if stage in stages else ()
        confirmed = {c.get("name", c["effect"]): c for c in candidates if not c["alternative"]}
        if not confirmed:
            continue
        places: dict[str, list[str]] = {}
        for effect, _, place in (label.partition("@") for label in labels):
            places.setdefault(effect, []).extend([place] if place else confirmed.get(effect, {}).get("where", ()))
        now = [
            {**confirmed.get(effect, {"effect": effect, "name": effect, "alternative": False}), "where": where}
            for effect, where in places.items()
        ]
        out[stage] = {**stages[stage], "candidates": [*now, *(c for c in candidates if c["alternative"])]}
    return out


def at_error(part: Json, heldout_rms: float, noise_floor: float) -> Json:
    """What a diagnosis says of a stage, with the distance from the noise floor at which the mended model is now.

    Parameters
    ----------
    heldout_rms, noise_floor
        Of the model, in one unit.
    """
    if not part.get("above_floor") or not noise_floor > 0.0:
        return part
    return {**part, "above_floor": {**part["above_floor"], "times_floor": heldout_rms / noise_floor}}


def outcome(stages: Json, mended: bool = False) -> Outcome:
    """``good`` where nothing is left to add or to find out."""
    for part in stages.values():
        unfinished = part["verdict"] in ("ambiguous", "unknown") or part.get("above_floor") is not None
        if unfinished or (part["verdict"] == "missing" and not mended):
            return "open"
    return "good"


def _variants(stages: Json, mended: bool) -> Iterator[str]:
    """The sentence with all its detail, then with less and less."""
    falls = [part for part in stages.values() if any(not c["alternative"] for c in part["candidates"])]
    if falls and not _left(stages, True, 99) and (mended or len(falls) == 1):
        ends = error_texts([falls[0][f"heldout_rms_{when}"] for when in ("before", "after")], falls[0]["unit"])
        said = _sentence(stages, mended, True, False, 99).removesuffix(".")
        above = any(part.get("above_floor") for part in stages.values())
        rest = "the error is still above the noise floor" if above else "no further effect was found"
        yield f"{said}; {rest}." if mended else f"{said}; with it the held-out error falls from {ends[0]} to {ends[1]}."
    several = len(stages) > 1
    for where, stage_names, most in ((True, several, 99), (True, False, 99), (True, False, 3), (False, False, 3)):
        yield _sentence(stages, mended, where, stage_names, most)
    for where, most in ((True, 3), (False, 3), (False, 1)):
        yield _sentence(stages, mended, where, False, most, brief=True)
    missing = sum(not c["alternative"] for part in stages.values() for c in part["candidates"])
    now = f", {'are' if missing > 1 else 'is'} now in the model" if mended else ""
    said = f"{missing} effect{'s were' if missing > 1 else ' was'} missing{now}; " if missing else ""
    yield _capital(f"{said}{_briefly(stages) or 'nothing is left'}.")


def _briefly(stages: Json) -> str:
    """What stays open, without naming it; empty where nothing does."""
    return " and ".join(
        words for verdict, words in UNDECIDED_IN_WORDS.items() if any(p["verdict"] == verdict for p in stages.values())
    )


def _sentence(stages: Json, mended: bool, where: bool, stage_names: bool, most: int, *, brief: bool = False) -> str:
    missing = [
        (stage, named(c.get("name", c["effect"]), c["where"] if where else ()))
        for stage, part in stages.items()
        for c in part["candidates"]
        if not c["alternative"]
    ]
    what = [f"{words} ({stage})" if stage_names else words for stage, words in dict.fromkeys(missing)]
    left = _briefly(stages) if brief else _left(stages, where, most)
    if what:
        were = "were" if len(what) > 1 else "was"
        are = "are" if len(what) > 1 else "is"
        now = f" and {are} now in the model" if mended else ""
        said = f"{listed(what, most)} {were} missing{now}"
        return _capital(f"{said}; {left}." if left else f"{said}.")
    return _capital(f"{left or _nothing(stages)}.")


def _left(stages: Json, where: bool, most: int) -> str:
    """What stays open after that; empty where nothing does."""
    either = [c for part in stages.values() for c in equally_good(part["candidates"])]
    unknown = [v for part in stages.values() if part["verdict"] == "unknown" for v in part.get("depends_on") or ("",)]
    before = any(not c["alternative"] for part in stages.values() for c in part["candidates"])
    partly = any(part["verdict"] == "unknown" and equally_good(part["candidates"]) for part in stages.values())
    out = []
    if len(either) == 1:
        rest = "a part of the error" if partly else "the rest"
        out.append(f"{named(either[0].get('name', either[0]['effect']), either[0]['where'])} explains {rest} best")
    elif either:
        names = [named(c.get("name", c["effect"]), c["where"] if where else ()) for c in either]
        rest = "a part of the error" if partly else "what is left" if before else "the error"
        out.append(f"{_either(names, most)} explain {rest} equally well")
    if unknown:
        what = listed(list(dict.fromkeys(unknown)), 4)
        what = f"an error that depends on {what}" if any(unknown) else "an error that depends on no recorded variable"
        out.append(f"no known effect explains {what}")
    return "; ".join(out)


def _either(names: Sequence[str], most: int) -> str:
    if len(names) > most:
        return f"{len(names)} effects"
    return listed(list(dict.fromkeys(names)), most)


def _nothing(stages: Json) -> str:
    """That nothing was found, with how far the error is from the noise floor."""
    above = [part["above_floor"]["times_floor"] for part in stages.values() if part.get("above_floor")]
    if above:
        return f"no missing effect was found, but the held-out error is {number(max(above), 2)} times the noise floor"
    errors = floor_text((part.get("heldout_rms_before"), part.get("noise_floor")) for part in stages.values())
    return f"no missing effect was found: {errors}"


def listed(words: Sequence[str], most: int = 3) -> str:
    """``a, b and c``, or ``a, b and 3 more``."""
    if len(words) > most:
        words = [*words[:most], f"{len(words) - most} more"]
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def notes(stage: str, part: Json, mended: bool = False) -> list[str]:
    """What a person must know beside the verdict on a stage, the most important first; a sentence or two each."""
    out = []
    good = equally_good(part["candidates"])
    worse = [c for c in part["candidates"] if c["alternative"] and c not in good]
    for c in worse:
        name, error = (
            named(c.get("name", c["effect"]), c["where"]),
            error_text(c.get("heldout_rms_after"), part["unit"]),
        )
        if _determined(c):
            out.append(f"{name} explains it less well: held-out error {error}.")
        else:
            out.append(f"{name} is no alternative: the data do not determine its values (held-out error {error}).")
    undecided, plan = bool(good or worse), part.get("next_plan") or {}
    if undecided and plan.get("for") == "parting":
        kind = kind_of(stage).words.folds
        if plan.get("helps"):
            now, then = (f"{number(plan[f'sigma_{when}'], 2)} σ" for when in ("before", "after"))
            out.append(f"The closest two differ by {now}; {plan['count']} proposed {kind} raise this to {then}.")
        else:
            out.append(f"No {kind} that this robot can take distinguish all of them.")
    elif undecided and part.get("next_measurement"):
        out.append(f"To distinguish them: {part['next_measurement']}.")
    if above := part.get("above_floor"):
        out.append(
            f"The held-out error is {number(above['times_floor'], 2)} times the noise floor. One possible reason: "
            f"{above['reasons'][0].partition(':')[0]}."
        )
    if sides := part.get("one_sided"):
        joints = places_text([f"joint{s['joint']}" for s in sides])
        what = kind_of(stage).words.moved
        recorded = any(s["side"] != 0 for s in sides)
        why = f"{what} from one side only" if recorded else "no directions were recorded"
        out.append(f"Direction-dependent effects were not tested at {joints}: {why}.")
    if len(part.get("outliers") or ()) >= OUTLIERS_WORTH_A_WORD:
        out.append(f"{len(part['outliers'])} rows were rejected as outliers.")
    if shifts := worth_naming(part.get("exported_shift") or ()):
        p = shifts[0]
        row = p["row"] if str(p["row"]).isalpha() else f"row {p['row']}"
        much = with_error(p["shift"], p["std"], p["unit"])
        named_here = [c for c in part["candidates"] if not c["alternative"]]
        without = "Without these effects" if len(named_here) > 1 else "Without it"
        biased = "Without what was added the DH table was biased" if mended else f"{without} the DH table is biased"
        count = "1 number:" if len(shifts) == 1 else f"{len(shifts)} numbers, such as"
        at_flange = f"{length(p['at_flange_m'])} at the flange"
        out.append(f"{biased} in {count} {p['parameter']} of {row} by {much}; {at_flange}.")
    return [f"{stage}: {text}" for text in out]


def is_known(parameter: Json) -> bool:
    """Whether a candidate's parameter has a value to show: the data identify it, or at least exclude zero."""
    return bool(parameter.get("identified", True) or parameter.get("excludes_zero", False))


def left_out_text(labels: Sequence[str]) -> str:
    """What was asked for and not added, and why."""
    return f"not added, because these rows do not identify it in this model: {', '.join(labels)}"


def worth_naming(shifts: Sequence[Json]) -> list[Json]:
    """Shifts of the exported table that move the flange measurably, the largest first.

    Diagnoses that an earlier version stored do not say what a shift does at the flange; of these none is named.
    """
    known = [s for s in shifts if s.get("at_flange_m", 0.0) >= MEASURABLE]
    return sorted(known, key=lambda s: -float(s["at_flange_m"]))
