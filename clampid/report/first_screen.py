"""The report's first screen: three numbers, the error falling, the verdict, what is mended and what is still open."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from clampid.diagnosis.headline import MOST_WORDS, as_added, equally_good, headline, listed, named, notes, outcome
from clampid.display import error_text, error_texts
from clampid.effect import Stage
from clampid.models.model import Model, Round
from clampid.report.rounds import nominal_error, rounds_of, unit_of
from clampid.report.stage_data import StageData, in_order, stage_title
from clampid.stages.stage_kind import kind_of

__all__ = ["Fall", "FirstScreen", "Step", "first_screen"]

Json = Mapping[str, Any]
MOST_STEPS = 7
SAID_ELSEWHERE = ("DH table", "rejected as outliers")
"""Words of notes that leave nothing open."""
MOST_OPEN = 5


@dataclass(frozen=True)
class Step:
    """One step of the falling error: its name, its error in words, and where it lies on the picture (0 to 1)."""

    label: str
    text: str
    at: float


@dataclass(frozen=True)
class Fall:
    """The falling error on a logarithmic axis.

    Attributes
    ----------
    steps
        From the described robot to the model.
    floor
        The noise floor in words, and where it lies.
    ticks
        Round values in words, and where they lie.
    """

    steps: tuple[Step, ...]
    floor: tuple[str, float]
    ticks: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class FirstScreen:
    """What the first screen shows, in words.

    Attributes
    ----------
    date
        When the report was written.
    numbers
        Name and value: the described robot, this model, the noise floor.
    what
        What the numbers are errors of.
    verdict, good
        One sentence, and whether nothing is left to do.
    mended, open
        What was missing and is now in the model; what is still open, and what to measure.
    """

    date: str
    numbers: tuple[tuple[str, str], ...]
    what: str
    fall: Fall | None
    verdict: str
    good: bool
    mended: tuple[str, ...]
    open: tuple[str, ...]


def first_screen(
    model: Model, first: Model | None, stages: Mapping[Stage, StageData], diagnosis: Json | None
) -> FirstScreen:
    """Collect the first screen.

    Parameters
    ----------
    first
        The model before anything was added, where the ledger does not say.
    stages
        The rows of the campaign with what the model leaves of them.
    diagnosis
        As the JSON of ``diagnose`` has it; None where none was made.
    """
    found: Json = (diagnosis or {}).get("stages") or {}
    added = [
        (stage, label)
        for stage in in_order(model.stages)
        for r in rounds_of(model, first, stage)
        for label in r.added
        if _has(label, {term.label for term in model.stages[stage].terms})  # and nothing took its place since
    ]
    verdict, good = _verdict(model, found, added)
    numbers, fall, what = _errors(model, first, stages)
    mended = [f"{named(*_parts(labels))} ({stage})" for (stage, _), labels in _by_effect(added).items()]
    return FirstScreen(_today(), numbers, what, fall, verdict, good, tuple(mended), tuple(_open(model, found)))


def _today() -> str:
    """The date of writing; SOURCE_DATE_EPOCH, where it is set, so that a report can be made again as it was."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    now = datetime.fromtimestamp(int(epoch), UTC) if epoch else datetime.now().astimezone()
    return f"{now.day} {now:%B %Y}"


def _by_effect(added: Sequence[tuple[str, str]]) -> dict[tuple[str, str], list[str]]:
    """Stage and effect → its labels, one for each place."""
    groups: dict[tuple[str, str], list[str]] = {}
    for stage, label in added:
        groups.setdefault((stage, label.partition("@")[0]), []).append(label)
    return groups


def _parts(labels: Sequence[str]) -> tuple[str, list[str]]:
    return labels[0].partition("@")[0], [place for label in labels if (place := label.partition("@")[2])]


def _verdict(model: Model, found: Json, added: Sequence[tuple[str, str]]) -> tuple[str, bool]:
    """One sentence of at most 25 words, and whether nothing is left to do."""
    if not found:
        return "No diagnosis of this model on this campaign was computed.", False
    now = _is_in(model, found)
    confirmed = any(not c["alternative"] for part in found.values() for c in part["candidates"])
    if confirmed or not added:
        labels: dict[str, list[str]] = {}
        for stage, label in added:
            labels.setdefault(stage, []).append(label)
        return headline(as_added(found, labels) if now else found, mended=now), outcome(found, mended=now) == "good"
    names = [named(*_parts(labels)) for labels in _by_effect(added).values()]
    good = outcome(found) == "good"
    rest = "no further effect was found." if good else headline(found)
    were = "were" if len(names) > 1 else "was"
    for most in (4, 2, 1):
        text = f"{listed(names, most)} {were} missing and {'are' if len(names) > 1 else 'is'} now in the model"
        for tail in (f"; {rest[:1].lower()}{rest[1:]}", "."):
            if len(f"{text}{tail}".split()) <= MOST_WORDS:
                return f"{text[:1].upper()}{text[1:]}{tail}", outcome(found) == "good"
    return rest, outcome(found) == "good"


def _is_in(model: Model, found: Json) -> bool:
    """Whether the model has all that a diagnosis confirmed."""
    return not any(_not_in(model, name, part) for name, part in found.items())


def _not_in(model: Model, name: str, part: Json) -> list[Json]:
    """The confirmed candidates of a stage that were never added to the model."""
    terms = [term.label for stage, s in model.stages.items() if stage == name for term in s.terms]
    # What another effect took the place of since, such as one curve for several, was added, too.
    have = {*terms, *(label for r in model.ledger if r.stage == name for label in r.added)}
    return [
        c
        for c in part["candidates"]
        if not c["alternative"] and not all(_has(f"{c.get('name', c['effect'])}@{p}", have) for p in c["where"])
    ]


def _has(label: str, labels: set[str]) -> bool:
    """Whether a term is among labels, at its place or wherever its effect acts."""
    return label in labels or label.partition("@")[0] in labels


def _open(model: Model, found: Json) -> list[str]:
    """What is still open, and what to measure."""
    out = [] if found else ["Not known: no diagnosis was computed. Run clampid diagnose, then clampid report."]
    now = _is_in(model, found)
    for name, part in found.items():
        for c in _not_in(model, name, part):
            out.append(f"{name}: {named(c.get('name', c['effect']), c['where'])} is not in the model yet.")
        either = equally_good(part["candidates"])
        if len(either) > 1:
            names = [named(c.get("name", c["effect"]), c["where"]) for c in either]
            out.append(f"{name}: the data do not distinguish {listed(names, 4)}.")
        if part["verdict"] == "unknown":
            variables = listed(list(part.get("depends_on") or ()), 4)
            out.append(f"{name}: an error that depends on {variables or 'no recorded variable'} has no known effect.")
        out += [text for text in notes(name, part, now) if not any(word in text for word in SAID_ELSEWHERE)]
        if either and (part.get("next_plan") or {}).get("helps"):
            out.append(f"{name}: To plan that measurement: clampid diagnose MODEL CAMPAIGN --plan next.toml")
    # A plan of what to measure next is never cut off.
    out = [*out[: MOST_OPEN - 1], *out[-1:]] if len(out) > MOST_OPEN else out
    return [_alone(text, found) for text in out]


def _alone(text: str, found: Json) -> str:
    """A remark without the name of its stage where there is only one stage."""
    stage, colon, rest = text.partition(": ")
    return rest[:1].upper() + rest[1:] if colon and stage in found and len(found) == 1 else text


def _errors(
    model: Model, first: Model | None, stages: Mapping[Stage, StageData]
) -> tuple[tuple[tuple[str, str], ...], Fall | None, str]:
    """The three numbers and the picture, of poses where there are some, and what they are errors of."""
    for stage in in_order(model.stages):
        rounds = rounds_of(model, first, stage)
        if not rounds:
            continue
        unit = unit_of(stage)
        nominal = nominal_error(stages[stage]) if stage in stages else None
        last = rounds[-1]
        numbers = (
            ("nominal robot", error_text(nominal, unit)),
            ("with this model", error_text(last.heldout_rms, unit)),
            ("noise floor", error_text(last.noise_floor, unit)),
        )
        what = "rms position error on held-out rows" if kind_of(stage).points else "rms torque error on held-out rows"
        return numbers, _fall(rounds, nominal, unit), f"{stage_title(stage)}: {what}"
    return (), None, ""


def _fall(rounds: Sequence[Round], nominal: float | None, unit: str) -> Fall | None:
    entries = [] if nominal is None else [("nominal robot", nominal)]
    entries += [(_label(r, k), r.heldout_rms) for k, r in enumerate(rounds)]
    if len(entries) > MOST_STEPS:
        left = len(entries) - MOST_STEPS
        entries = [*entries[:2], *entries[2 + left :]]
    floor = rounds[-1].noise_floor
    values = [value for _, value in entries] + [floor]
    if not all(math.isfinite(v) and v > 0 for v in values):
        return None
    low, high = min(values) / 1.5, max(values) * 1.3

    def place(value: float) -> float:
        return math.log(value / low) / math.log(high / low)

    ticks = [m * 10.0**e for e in range(-9, 6) for m in (1, 2, 5) if low <= m * 10.0**e <= high]
    if len(ticks) > 6:
        ticks = [t for t in ticks if f"{t:e}".startswith("1")]
    texts = error_texts([value for _, value in entries], unit)
    steps = tuple(Step(label, text, place(value)) for (label, value), text in zip(entries, texts, strict=True))
    marks = tuple((error_text(t, unit).replace(".00", "").replace(".0 ", " "), place(t)) for t in ticks)
    return Fall(steps, (error_text(floor, unit), place(floor)), marks)


def _label(entry: Round, index: int) -> str:
    """A round's name, short enough for the picture."""
    if not entry.added:
        return "start model" if index == 0 else f"round {index + 1}"
    names = list(dict.fromkeys(label.partition("@")[0] for label in entry.added))
    text = "+ " + names[0].replace("_", " ") + (f" and {len(names) - 1} more" if len(names) > 1 else "")
    places = [place for label in entry.added if (place := label.partition("@")[2])]
    return f"{text}, {named('', places).removeprefix(' at ')}" if len(names) == 1 and 0 < len(places) < 3 else text
