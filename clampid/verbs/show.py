"""Models and added effects as tables for people."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from clampid.display import error_text, label_text, number, places_text, quantity, readable
from clampid.stages.stage_kind import kind_of
from clampid.verbs.output import Output

if TYPE_CHECKING:
    from clampid.effect import Effect, Parameter
    from clampid.fitting.base_names import BaseParameter
    from clampid.models.drives import Drives
    from clampid.models.model import Model, Round, StageModel
    from kinematics.description import RobotDescription

__all__ = [
    "evidence_words",
    "model_json",
    "parameter_rows",
    "show_drives",
    "show_model",
    "show_rounds",
    "stage_unit",
    "terms_text",
    "weights_text",
]

NOT_KNOWN = "not identifiable from these data"
ON_BOUND = "on its physical limit: the interval has one side"


def stage_unit(stage: str) -> str:
    """The unit of a stage's errors."""
    return kind_of(stage).error_unit


def parameter_rows(stage: StageModel, effects: Mapping[str, Effect], robot: RobotDescription) -> list[tuple[str, ...]]:
    """One row per parameter: name, place, value, standard error, unit (and on which side of a gear), remark."""
    from clampid.slots import find_parameter, on_bound, unit_of

    rows: list[tuple[str, ...]] = []
    for slot, value, std, known in zip(
        stage.slots, stage.theta.tolist(), stage.std.tolist(), stage.identified, strict=True
    ):
        parameter = find_parameter(slot, effects)
        number, error, symbol = quantity(value, std, unit_of(slot, effects, robot))
        name = f"{slot.effect}.{slot.parameter}"
        remark = (ON_BOUND if on_bound(slot, value, effects) else "") if known else NOT_KNOWN
        rows.append((name, slot.place, number, error, symbol + _side(parameter, robot), remark))
    return rows


def _side(parameter: Parameter, robot: RobotDescription) -> str:
    """On which side of the gear a number counts that is not the same on both."""
    if not parameter.gearing:
        return ""
    geared = np.any(np.abs(np.diag(robot.transmission)) != 1.0)
    return " at the motor" if geared else " at the joint"


def base_rows(base: Iterable[BaseParameter]) -> list[tuple[str, ...]]:
    """One row per base parameter: name, what the description gives, value, standard error, unit, remark."""
    rows: list[tuple[str, ...]] = []
    for p in base:
        number, error, symbol = quantity(p.value, p.std, p.unit)
        described = f"{p.described:.{len(number.partition('.')[2])}f}"
        rows.append((p.name, described, number, error, symbol, "" if p.known else NOT_KNOWN))
    return rows


def show_model(
    model: Model, effects: Mapping[str, Effect], robot: RobotDescription, rejected: Mapping[str, str], out: Output
) -> None:
    """Every stage's parameters with standard errors, and what the data leave open.

    ``rejected``: stage → its outliers in words.
    """
    from clampid.fitting.observability import index_words
    from clampid.verbs.parameter_tables import show_parameters

    for name, stage in model.stages.items():
        show_parameters(name, stage, effects, robot, out)
        _show_sessions(name, stage, effects, out)
        for effect in dict.fromkeys(s.effect for s in stage.slots):
            if effects[effect].caveat:
                out.say(f"{name}: {effect}: {effects[effect].caveat}")
        if name in rejected:
            out.say(f"{name}: rejected as outliers: {rejected[name]}")
        if stage.bootstrap is not None:
            out.say(f"{name}: {bootstrap_words(stage)}")
        if stage.observability:
            out.say(f"{name}: {index_words(stage.observability)}")
        _show_unknown(name, stage, effects, robot, out)
        for sentence in stage.null_directions:
            out.say(f"{name}: {NOT_KNOWN}: {sentence}")
        _show_correlations(name, stage, out)
        if stage.base:
            title = f"{name}: base parameters of the arm, without the declared tool"
            out.table(title, ("base parameter", "described", "value", "± std", "unit", ""), base_rows(stage.base))
    for sentence in contradictions(model):
        out.warn(sentence)
    for sentence in universal_words(model):
        out.say(sentence)
    if model.joint:
        _show_moved(model, out)
    show_rounds(model.ledger, out)


def _show_moved(model: Model, out: Output) -> None:
    """Where the joint fit and the stages one by one disagree; both values."""
    out.say("all tables in one fit, with the parameters that they share")
    found = [(entry.stage, moved) for entry in model.ledger for moved in entry.evidence.get("moved") or ()]
    if not found:
        out.say("joint fit and fits stage by stage agree: no shared parameter differs by more than chance (5 %)")
        return
    out.warn("joint fit and fits stage by stage differ by more than chance (5 %): some stage contradicts another")
    rows = []
    for stage, moved in found:
        figures = [f"{moved[key]:.4g} ± {moved[f'{key}_std']:.2g}" for key in ("apart", "joint")]
        rows.append((stage, moved["parameter"], moved["where"], *figures, f"{abs(moved['z']):.1f}"))
    heads = ("stage", "parameter", "at", "stage alone, SI", "jointly, SI", "difference, standard errors")
    out.table("", heads, rows, left=3)


def _show_sessions(name: str, stage: StageModel, effects: Mapping[str, Effect], out: Output) -> None:
    """What differs from session to session of what each has of its own."""
    from clampid.models.session_differences import session_differences

    rows = []
    for d in session_differences(stage, effects):
        number, error, symbol = quantity(d.value, d.std, d.unit)
        rows.append((d.parameter, f"{d.session} less {d.less}", number, error, symbol))
    if rows:
        out.table(f"{name}: from session to session", ("parameter", "", "difference", "± std", "unit"), rows, left=2)


def _show_unknown(
    name: str, stage: StageModel, effects: Mapping[str, Effect], robot: RobotDescription, out: Output
) -> None:
    """By what rule a parameter is called not identifiable, with the numbers for those that are."""
    from clampid.stages.fit_problem import parameter_of

    limits: dict[tuple[str, str], list[str]] = {}
    for slot, known in zip(stage.slots, stage.identified, strict=True):
        if not known:
            parameter = parameter_of(slot, effects, robot)
            size = readable(parameter.clear, parameter.unit, 2)
            limits.setdefault((f"{slot.effect}.{slot.parameter}", size), []).append(slot.place)
    if limits:
        listed = ", ".join(f"{parameter} at {places_text(at)} {size}" for (parameter, size), at in limits.items())
        out.say(f"{name}: not identifiable is a parameter whose standard error is not below its usual size: {listed}")


def _show_correlations(name: str, stage: StageModel, out: Output) -> None:
    """The strongest correlations of identified parameters; nothing where there are none."""
    from clampid.models.correlations import PAIRS_SHOWN, STRONG, correlations

    found = correlations(stage)
    if not found:
        return
    which = f"the strongest {PAIRS_SHOWN} of {len(found)}" if len(found) > PAIRS_SHOWN else f"all {len(found)}"
    out.say(f"{name}: correlations of identified parameters beyond ±{STRONG:g}, {which}:")
    rows = [(c.first.label, c.second.label, f"{c.r:+.4f}") for c in found[:PAIRS_SHOWN]]
    out.table("", ("parameter", "with", "r"), rows, left=2)


def bootstrap_words(stage: StageModel) -> str:
    """How standard errors by drawing poses anew compare with those of the formula."""
    known = [k for k, identified in enumerate(stage.identified) if identified]
    if stage.bootstrap is None or not known:
        return "no parameter is identifiable, so that the bootstrap gives no standard errors"
    ratio = stage.bootstrap.std[known] / stage.std[known]
    least, most = (stage.slots[known[k]].label for k in (int(ratio.argmin()), int(ratio.argmax())))
    return (
        f"bootstrap, {stage.bootstrap.count} draws of whole poses: standard errors are {ratio.min():.2f} ({least}) to "
        f"{ratio.max():.2f} ({most}) times those of the table, {float(np.median(ratio)):.2f} times in the median"
    )


def universal_words(model: Model) -> list[str]:
    """The universal model's figures of a fit by its cost, beside those of least squares."""
    out = []
    for entry in model.ledger:
        for name, figures in (entry.evidence.get("universal") or {}).items():
            figures_text = ", ".join(f"{key} {error_text(value, 'm')}" for key, value in figures.items())
            out.append(f"{entry.stage} by {name}, fitted points: {figures_text}")
    return out


def contradictions(model: Model) -> list[str]:
    """Where the poses contradict the clamped sweeps, so that springs and clearances were not taken over, in words."""
    out = []
    for entry in model.ledger:
        found = entry.evidence.get("contradicted") or ()
        if found:
            where = ", ".join(f"{a['parameter']} at {a['where']} ({abs(a['z']):.1f} standard errors)" for a in found)
            out.append(
                f"{entry.stage}: the poses contradict the clamped sweeps in {where}; springs and clearances of the "
                "sweeps are not used. Did the clamp yield, or are the poses' loads wrong? See `clampid diagnose`"
            )
    return out


def show_drives(drives: Drives, out: Output) -> None:
    """Springs, clearances with detection limits and friction, drive by drive; then the compliance off the diagonal.

    Torques are per radian at the motor, as the thesis has them, and per radian at the joint; clearances are degrees.
    """
    rows = []
    d, degree = drives, math.degrees(1.0)
    for j in range(len(d.stiffness)):
        gap = _pair(degree * d.gap[j], degree * d.gap_std[j])
        limit, verdict = "–", ""
        if math.isfinite(d.gap[j]):
            limit, verdict = f"{degree * d.gap_limit[j]:.4f}", "yes" if d.gap_identified[j] else "no"
        springs = (
            _pair(d.stiffness[j], d.stiffness_std[j]),
            _pair(d.joint_stiffness[j] / 1e3, d.joint_stiffness_std[j] / 1e3),
        )
        rows.append((f"{j + 1}", *springs, gap, limit, verdict, _pair(d.friction[j], d.friction_std[j])))
    columns = (
        "axis", "k [Nm/rad] at the motor", "at the joint [kNm/rad]", "clearance [deg]", "detection limit [deg]",
        "differs from zero", "friction [Nm] at the motor",
    )  # fmt: skip
    out.table("drives", columns, rows)
    cross = []
    for a in range(len(d.stiffness)):
        for b in range(a + 1, len(d.stiffness)):
            if d.compliance[a, b] != 0.0:
                cross.append((f"{a + 1} and {b + 1}", _pair(1e6 * d.compliance[a, b], 1e6 * d.compliance_std[a, b])))
    if cross:
        out.table("compliance between joints", ("joints", "µrad/Nm"), cross)


def _pair(value: float, std: float) -> str:
    """``12.3 ± 0.4`` in the unit that its column has."""
    if not math.isfinite(value):
        return "–"
    number, error, _ = quantity(value, std, "")
    return f"{number} ± {error}"


def show_rounds(rounds: Iterable[Round], out: Output) -> None:
    """The ledger as a table; where a diagnosis chose a step, by which p, and what else that might have been."""
    rounds = list(rounds)
    with_p = any("p_familywise" in entry.evidence for entry in rounds)
    rows, notes = [], []
    for k, entry in enumerate(rounds, 1):
        unit = stage_unit(entry.stage)
        errors = (error_text(v, unit) for v in (entry.rms, entry.heldout_rms, entry.noise_floor))
        what = "+ " + terms_text(entry.added) if entry.added else terms_text(entry.effects)
        p = entry.evidence.get("p_familywise")
        rows.append((str(k), entry.stage, what, *errors, *(["–" if p is None else number(p, 2)] if with_p else [])))
        notes += [f"round {k}: {said}" for said in evidence_words(entry)]
    columns = ("", "stage", "effects", "rms", "rms held out", "noise floor", *(["p family"] if with_p else []))
    out.table("rounds", columns, rows, left=3)
    for said in notes:
        out.say(said)


def evidence_words(entry: Round) -> list[str]:
    """The effects that these data hardly distinguish from a round's, and those that were fitted instead and refused."""
    alike: dict[str, Mapping[str, Any]] = {}
    for c in entry.evidence.get("confusable_with", ()):
        alike.setdefault(c["effect"], c)  # the closest place of each comes first
    out = []
    if said := weights_text(entry.evidence.get("weights")):
        out.append(said)
    if alike:
        listed = (f"{label_text(name, c['where'])} ({_share(c['cos2'])})" for name, c in alike.items())
        out.append(f"confusable with {', '.join(listed)}; in brackets cos²")
    refused = [r for r in entry.evidence.get("rejected", ()) if "heldout_rms_after" in r]
    out += [f"refused: {label_text(r['name'], r['where'])}: {r['reason']}" for r in refused]
    return out


def weights_text(weights: Mapping[str, Any] | None) -> str:
    """Note on a log that was fitted with equal weights; empty where it was not."""
    if not weights or not weights["equal"]:
        return ""
    gain, error = (f"{100.0 * weights[key]:.2g}" for key in ("gain", "std"))
    return f"fitted with equal weights: they lower the mean square of held-out rows by {gain} ± {error} %"


def terms_text(labels: Iterable[str]) -> str:
    """Terms as one reads them, each effect once: ``backlash at joints 1, 2, base_tilt@base``."""
    places: dict[str, list[str]] = {}
    for effect, _, place in (label.partition("@") for label in labels):
        places.setdefault(effect, []).extend([place] if place else [])
    return ", ".join(label_text(effect, own) for effect, own in places.items())


def _share(cos2: float) -> str:
    """To two digits, and 1 only where it is aliased."""
    return "1" if cos2 > 0.999 else f"{min(cos2, 0.99):.2f}"


def _bootstrap_json(stage: StageModel) -> dict[str, Any] | None:
    """Standard errors and 95 % intervals by drawing poses anew, SI."""
    found = stage.bootstrap
    if found is None:
        return None
    rows = zip(stage.slots, found.std.tolist(), found.low.tolist(), found.high.tolist(), strict=True)
    parameters = [{"name": slot.label, "std": std, "low": low, "high": high} for slot, std, low, high in rows]
    return {"count": found.count, "parameters": parameters}


def model_json(model: Model) -> dict[str, Any]:
    """What ``identify`` and ``auto`` tell programs beside the model file."""
    from clampid.fitting.base_names import base_json
    from clampid.models.correlations import correlations
    from clampid.models.own_effects import effects_of
    from clampid.models.session_differences import session_differences

    stages: dict[str, Any] = {}
    effects = effects_of(model)
    for name, stage in model.stages.items():
        rounds = [r for r in model.ledger if r.stage == name]
        last = rounds[-1] if rounds else None
        stages[name] = {
            "unit": stage_unit(name),
            "effects": [term.label for term in stage.terms],
            "parameters": len(stage.slots),
            "not_identifiable": [s.label for s, known in zip(stage.slots, stage.identified, strict=True) if not known],
            "open": list(stage.null_directions),
            "correlations": [c.to_json() for c in correlations(stage)],
            "observability": dict(stage.observability),
            "bootstrap": _bootstrap_json(stage),
            "base_parameters": [base_json(p) for p in stage.base],
            "outliers": [{"session": s, "table": t, "row": r} for s, t, r in stage.outliers],
            "held_out": [list(folds) for folds in stage.held_out],
            "rms": last and last.rms,
            "heldout_rms": last and last.heldout_rms,
            "noise_floor": last and last.noise_floor,
        }
        if weights := next((r.evidence["weights"] for r in reversed(rounds) if "weights" in r.evidence), None):
            stages[name]["weights"] = weights
        if apart := session_differences(stage, effects):
            stages[name]["session_differences"] = [d.to_json() for d in apart]
    return {
        "robot": model.robot,
        "sessions": [s.name for s in model.sessions],
        "joint": model.joint,
        "stages": stages,
    }
