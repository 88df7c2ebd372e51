"""The screens of the verbs about models: what each says in 24 lines, from the dictionaries that programs get."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clampid.diagnosis.headline import as_added, at_error, headline, left_out_text, listed, named, notes, outcome
from clampid.display import change_text, count_text, counted, error_text, error_texts, floor_text, number
from clampid.screen import Errors, Next, Screen, Tone
from clampid.stages.stage_kind import kind_of, kinds, stage_of_table
from clampid.verbs.next_step import free_name
from clampid.verbs.show import weights_text

if TYPE_CHECKING:
    from clampid.effect import Stage
    from clampid.models.model import Model, Round
    from experiments.campaign import Campaign

__all__ = [
    "addition_screen",
    "comparison_screen",
    "diagnosis_screen",
    "fit_screen",
    "history_screen",
    "mended_screen",
    "more_poses",
    "typed",
    "undo_screen",
]

Json = Mapping[str, Any]
HELD_OUT = "Error (rms) on held-out rows"
SIGMA = "; torques in σ, units of each motor's noise"
CLOSE_TO_FLOOR = 1.3
"""A held-out error of more than so many noise floors may lack an effect; as diagnosis has it."""
OVERFITTED = 3.0
"""A held-out error of more than so many fitted ones: the fit followed its rows, and predicts no others."""


def typed(*words: str | Path, effects_from: Path | None = None) -> str:
    """A command to copy, with the user's own effects where there are some."""
    own = [] if effects_from is None else ["--effects-from", str(effects_from)]
    return shlex.join(["clampid", *map(str, words), *own])


def _of_points(name: str) -> bool:
    """Whether a stage, or a table, is of measured points."""
    stage = stage_of_table(name) or name
    return any(kind.points for kind in kinds() if kind.name == stage)


def _title(stages: Sequence[str], what: str = HELD_OUT) -> str:
    return what + (SIGMA if any(not _of_points(stage) for stage in stages) else "")


def _of(nominal: Mapping[Stage, float], name: str) -> float | None:
    """The described robot's error of a stage, where it is known."""
    return {str(stage): error for stage, error in nominal.items()}.get(name)


def _times(error: float | None, floor: float | None) -> float:
    return float("nan") if not error or not floor else error / floor


def _judged(rows: Sequence[tuple[str, float | None, float | None]]) -> tuple[str, Tone]:
    """A verdict on held-out errors and their floors, stage by stage, and how it is meant."""
    far = [(times, name) for name, error, floor in rows if (times := _times(error, floor)) > CLOSE_TO_FLOOR]
    if not far:
        said = floor_text((error, floor) for _, error, floor in rows)
        return f"{said[0].upper()}{said[1:]}.", "good"
    times, name = max(far)
    return (
        f"{name}: the held-out error is {number(times, 2)} times the noise floor, so an effect may be missing.",
        "open",
    )


def fit_screen(
    data: Json,
    nominal: Mapping[Stage, float],
    rejected: Json,
    read: Sequence[Campaign],
    campaigns: Sequence[Path],
    effects_from: Path | None,
) -> Screen:
    """What ``identify`` did.

    Parameters
    ----------
    data
        Its JSON.
    nominal
        Stage → the error of the described robot; see :func:`clampid.comparison.nominal.nominal_errors`.
    rejected
        Stage → its rejected rows in words.
    read
        The campaigns of the folders ``campaigns``.
    """
    stages = data["stages"]
    rows, facts, said, lacking = [], [], [], []
    for name, part in stages.items():
        unit = part["unit"]
        errors = (_of(nominal, name), part["heldout_rms"], part["noise_floor"])
        rows.append((name, tuple(error_text(e, unit) for e in errors), ""))
        known = part["parameters"] - len(part["not_identifiable"])
        effects = ", ".join(_once(part["effects"])).replace("_", " ")
        facts.append((name, f"{effects}; {known} of {part['parameters']} parameters are identifiable"))
        if (part["heldout_rms"] or 0.0) > OVERFITTED * (part["rms"] or float("inf")):
            fitted = error_text(part["rms"], unit)
            held_out = error_text(part["heldout_rms"], unit)
            poses = part.get("enough_poses")
            more = "more" if poses is None else f"{poses} poses or more"
            said.append(
                f"{name}: {held_out} on held-out rows, {fitted} on fitted ones: too few rows for {part['parameters']} "
                f"parameters. Measure {more}, or fit fewer effects."
            )
            lacking.append(poses)
        if shown := part.get("resolution"):
            step = 1e3 * shown["step_s"]
            said.append(
                f"{name}: {count_text(shown['rows'])} of {count_text(shown['moving'])} rows in motion count. "
                f"The others lie where a move begins or ends between two samples, {step:.0f} ms apart. Record more "
                "often, or speed up more slowly."
            )
        if weighted := weights_text(part.get("weights")):
            said.append(f"{name}: {weighted}.")
        if name in rejected:
            said.append(f"{name}: rejected as outliers: {_first(rejected[name])}")
    verdict, tone = _judged([(n, p["heldout_rms"], p["noise_floor"]) for n, p in stages.items()])
    model = data["model"]
    ask = typed("diagnose", model, *campaigns, effects_from=effects_from)
    steps: tuple[Next, ...] = (Next("Next, find out what is missing:", ask),)
    if lacking:
        verdict, tone = "The model fits its rows and does not predict others: do not use it.", "bad"
        steps = () if lacking[0] is None else more_poses(read[0], campaigns[0], lacking[0])
    return Screen(
        f"Fitted {model} to {_campaigns(campaigns)}.",
        Errors(_title(list(stages)), ("nominal", "this model", "noise floor"), tuple(rows)),
        tuple(facts),
        verdict,
        tone,
        tuple(said),
        "Parameters with their standard errors: --verbose, --json FILE.",
        steps,
    )


def more_poses(campaign: Campaign, folder: Path, poses: int | None = None) -> tuple[Next, ...]:
    """The command that plans as many poses as a fit needs; without a number, as many as the plan takes by default.

    A campaign without targets measured the flange itself, with its orientation: the plan then assumes a tool.
    """
    robot = str(campaign.header.get("robot", campaign.robot.name))
    own = folder / robot
    output = free_name(Path("plan.toml"))
    like: list[str | Path] = ["--like", folder] if campaign.targets else []
    described = own if own.is_file() else robot
    count = [] if poses is None else ["--poses", str(poses)]
    call = typed("plan", "poses", "--robot", described, *like, *count, "-o", output)
    return (Next("Next, plan as many poses as a fit needs:", call),)


def _once(labels: Sequence[str]) -> list[str]:
    """Effects without their places, each once."""
    return list(dict.fromkeys(label.partition("@")[0] for label in labels))


def _first(text: str) -> str:
    """The count and the first of several things listed with semicolons, with the mark that ends a sentence."""
    first, more, _ = text.partition("; ")
    return f"{first}, …" if more else f"{first}."


def _campaigns(campaigns: Sequence[Path]) -> str:
    return listed([str(c) for c in campaigns], 2)


def comparison_screen(
    data: Json,
    nominal: Mapping[Stage, float],
    model: Path,
    campaign: Path,
    report: Path | None,
    effects_from: Path | None,
) -> Screen:
    """What ``compare`` found."""
    rows, judged, said = [], [], []
    for name, table in data["tables"].items():
        held_out = (table.get("heldout") or {}).get("rms", table.get("rms"))
        floor = table.get("noise_floor")
        errors = (_of(nominal, name), held_out, floor)
        rows.append((name, tuple(error_text(e, table["unit"]) for e in errors), ""))
        judged.append((name, held_out, floor))
        beyond = table.get("extrapolating")
        if beyond and beyond["rows"]:
            kinds = listed(list(dict.fromkeys(q["quantity"] for q in beyond["quantities"])))
            said.append(
                f"{name}: {beyond['rows']} of {beyond['of']} held-out rows lie outside the fitted range of {kinds}."
            )
        far = table.get("extrapolated")
        if far and far["share"]:
            said.append(f"{name}: {100 * far['share']:.0f} % of held-out rows stand at joint angles no pose was near.")
        if wrong := (table.get("heldout") or {}).get("outliers"):
            kind = "an outlier" if len(wrong) == 1 else "outliers"
            said.append(f"{name}: {counted(len(wrong), 'held-out row', 'was')} rejected as {kind}.")
    said += _compensation_notes(data)
    verdict, tone = _judged(judged)
    heads = ("nominal", "this model", "noise floor")
    ask = typed("diagnose", model, campaign, effects_from=effects_from)
    return Screen(
        f"Compared {model} with {campaign}." + ("" if report is None else f" Report: {report}."),
        Errors(_title(list(data["tables"])), heads, tuple(rows)),
        (),
        verdict,
        tone,
        tuple(said),
        "Fitted rows, motors, ISO 9283 and largest errors: --verbose, --json FILE.",
        (Next("Next, find out what is missing:", ask),),
    )


def _compensation_notes(data: Json) -> list[str]:
    """What the poses say of the controller's own compensation, and what to do where it is wrong."""
    found = data.get("compensation") or {}
    said = [f"poses: {found['summary']}"] if found.get("summary") else []
    if found.get("mistake"):
        said.append("poses: Correct the controller's compensation and measure again before you add effects.")
    return said


def diagnosis_screen(data: Json, done: str, written: Sequence[str], steps: Sequence[Next]) -> Screen:
    """What ``diagnose`` found."""
    stages = data["stages"]
    added = any(not c["alternative"] for part in stages.values() for c in part["candidates"])
    heads = {key: head for key, head in zip(KEYS, HEADS, strict=True) if added or key != "heldout_rms_after"}
    rows = [
        (name, _ends(part) if added else tuple(error_text(part[k], part["unit"]) for k in heads), str(part["verdict"]))
        for name, part in stages.items()
    ]
    return Screen(
        done,
        Errors(_title(list(stages)), tuple(heads.values()), tuple(rows)),
        (),
        headline(stages),
        outcome(stages),
        (*written, *_compensation_notes(data), *_notes(stages)),
        "Evidence, values and detection limits: --verbose, --json FILE.",
        tuple(steps),
    )


KEYS = ("heldout_rms_before", "heldout_rms_after", "noise_floor")
HEADS = ("this model", "mended", "noise floor")


def _ends(part: Json) -> tuple[str, ...]:
    """The errors of a stage before and after, and its noise floor, in words."""
    ends = error_texts([part[key] for key in KEYS[:2]], part["unit"])
    return *ends, error_text(part[KEYS[2]], part["unit"])


def _notes(stages: Json, mended: bool = False) -> tuple[str, ...]:
    """Notes on all stages, the most important of each first."""
    found = [notes(name, part, mended) for name, part in stages.items()]
    return tuple(texts[k] for k in range(max(map(len, found), default=0)) for texts in found if k < len(texts))


def mended_screen(data: Json, model: Model, nominal: Mapping[Stage, float], done: str, steps: Sequence[Next]) -> Screen:
    """What ``auto`` found and added: ``data`` is its JSON, the ledger of ``model`` says what was added."""
    now = {name: (part["heldout_rms"], part["noise_floor"]) for name, part in data["stages"].items()}
    found = {
        name: at_error(part, *now[name]) if name in now else part for name, part in data["diagnosis"]["stages"].items()
    }
    rows, facts, said = [], [], []
    for name, part in data["stages"].items():
        if weighted := weights_text(part.get("weights")):
            said.append(f"{name}: {weighted}.")
        before = found.get(name, {}).get("heldout_rms_before")
        ends = error_texts([before, part["heldout_rms"]], part["unit"])
        around = [error_text(e, part["unit"]) for e in (_of(nominal, name), part["noise_floor"])]
        verdict = str(found[name]["verdict"])  # what was missing is in the model by now
        rows.append((name, (around[0], *ends, around[1]), "mended" if verdict == "missing" else verdict))
        labels = [label.partition("@") for label in _still_in(model, name)]
        if labels:
            facts.append((f"{name}:", f"added {_grouped([(effect, place) for effect, _, place in labels])}"))
    return Screen(
        done,
        Errors(_title(list(data["stages"])), ("nominal", "start model", "this model", "noise floor"), tuple(rows)),
        tuple(facts),
        headline(as_added(found, {name: _still_in(model, name) for name in data["stages"]}), mended=True),
        outcome(found, mended=True),
        (*_notes(found, mended=True), *said),
        "Parameters, evidence and detection limits: --verbose, --json FILE, --report FILE.html.",
        tuple(steps),
    )


def _still_in(model: Model, stage: str) -> list[str]:
    """What was added to a stage and is in the model; not what another effect has replaced since."""
    terms = {term.label for term in model.stages[stage].terms}
    added = [label for r in model.ledger if r.stage == stage for label in r.added]
    return [label for label in added if label in terms or label.partition("@")[0] in terms]


def _grouped(added: Sequence[tuple[str, str]]) -> str:
    """Effects with their places, each effect once."""
    places: dict[str, list[str]] = {}
    for effect, place in added:
        places.setdefault(effect, []).extend([place] if place else [])
    return listed([named(effect, list(dict.fromkeys(at))) for effect, at in places.items()], 6)


def addition_screen(data: Json, done: str, steps: Sequence[Next]) -> Screen:
    """What ``add`` did to the held-out error."""
    rows, worse, same, facts = [], [], [], []
    for name, part in data["stages"].items():
        rows.append((name, _ends(part), ""))
        places = [
            (a.get("name", a["effect"]), place)
            for a in part["added"]
            for place in ([a["where"]] if isinstance(a["where"], str) else a["where"] or [""])
        ]
        facts.append((f"{name}:", f"added {_grouped(places)}"))
        if part.get("left_out"):
            facts.append((f"{name}:", left_out_text(part["left_out"])))
        rise, std = part["heldout_rise"], part["heldout_rise_std"]
        if std is not None and abs(rise) <= std:
            same.append(name)
        elif rise > 0:
            worse.append(name)
        if std is not None:
            facts.append((f"{name}:", f"paired change of the held-out error {change_text(rise, std, part['unit'])}"))
    first = next(iter(data["stages"].values()))
    ends = _ends(first)
    if worse:
        verdict, tone = f"{listed(worse)}: the held-out error rose, so what was added does not help.", "bad"
    elif len(same) == len(data["stages"]):
        verdict, tone = "No change of the held-out error within its standard error.", "open"
    else:
        verdict, tone = f"The held-out error fell from {ends[0]} to {ends[1]}; the noise floor is {ends[2]}.", "good"
    shown: Tone = "bad" if tone == "bad" else "open" if tone == "open" else "good"
    return Screen(
        done,
        Errors(_title(list(data["stages"])), ("before", "after", "noise floor"), tuple(rows)),
        tuple(facts),
        verdict,
        shown,
        (),
        "Values with their standard errors: --verbose, --json FILE.",
        tuple(steps),
    )


def undo_screen(
    model: Model, gone: Round, output: Path, campaigns: Sequence[Path], effects_from: Path | None
) -> Screen:
    """What ``undo`` left."""
    last = next(r for r in reversed(model.ledger) if r.stage == gone.stage)
    unit = kind_of(gone.stage).error_unit
    errors = tuple(error_text(e, unit) for e in (gone.heldout_rms, last.heldout_rms, last.noise_floor))
    verdict, tone = _judged([(gone.stage, last.heldout_rms, last.noise_floor)])
    again = typed("diagnose", output, *campaigns, effects_from=effects_from)
    return Screen(
        f"Fitted {output} without {listed(list(gone.added), 6)}.",
        Errors(_title([gone.stage]), ("before", "this model", "noise floor"), ((gone.stage, errors, ""),)),
        (),
        verdict,
        tone,
        (),
        "All rounds: --verbose.",
        (Next("Next, diagnose again:", again),),
    )


def history_screen(rounds: Sequence[Json], model: Path) -> Screen:
    """The ledger: the last rounds, as many as fit."""
    most = 14
    rows = []
    for k, r in enumerate(rounds, 1):
        errors = tuple(error_text(r[key], r["unit"]) for key in ("rms", "heldout_rms", "noise_floor"))
        what = f"+ {listed(_once(r['added']), 2)}" if r["added"] else listed(_once(r["effects"]), 2)
        rows.append((f"{k} {r['stage']}", errors, what.replace("_", " ")))
    left = len(rounds) - most
    said = (f"{counted(left, 'earlier round')}: --verbose.",) if left > 0 else ()
    last = {r["stage"]: r for r in rounds}
    verdict, tone = _judged([(name, r["heldout_rms"], r["noise_floor"]) for name, r in last.items()])
    return Screen(
        f"{model}: {counted(len(rounds), 'round')}.",
        Errors(_title([r["stage"] for r in rounds], "Error (rms)"), ("fitted", "held out", "noise floor"),
               tuple(rows[-most:])),
        (),
        verdict,
        tone,
        said,
        "Evidence of each round: --verbose, --json FILE.",
        (Next("Next, write the report:", typed("report", model)),),
    )  # fmt: skip
