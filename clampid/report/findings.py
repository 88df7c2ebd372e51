"""One sentence for each section of the report: what it shows, as its heading."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from clampid.diagnosis.headline import listed, named
from clampid.display import counted, error_text, error_texts, number
from clampid.effect import Stage
from clampid.exports.dh_export import nominal_rows, static_table
from clampid.models.drives import drives_of
from clampid.models.model import Model, ModelError, Round
from clampid.report.budget import SETUP, pose_budget
from clampid.report.rounds import rounds_of, unit_of
from clampid.report.stage_data import StageData, in_order, stage_title
from clampid.role_slots import any_of_role
from clampid.stages.stage_kind import kind_of, known_of
from experiments.campaign import Campaign
from kinematics.dh_conversion import DHError
from kinematics.robot import RobotDescription

__all__ = ["findings"]

Json = Mapping[str, Any]
CURVE = 40  # numbers of an effect at one place: more are a curve


def findings(
    model: Model,
    first: Model | None,
    campaign: Campaign,
    stages: Mapping[Stage, StageData],
    diagnosis: Json | None,
    truth: Sequence[Json] | None,
    verdict: str,
) -> dict[str, str]:
    """Section → its finding; sections without one keep their title as heading.

    Parameters
    ----------
    verdict
        The sentence of the first screen.
    """
    found: Json = (diagnosis or {}).get("stages") or {}
    out = {
        "measured": _measured(campaign),
        "rounds": _rounds(model, first),
        "steps": _steps(model, first),
        "verdict": verdict if found else "",
        "truth": _truth(truth, model),
        "robot": _space(stages.get("poses")),
        "budget": _budget(stages.get("poses")),
        "model": _model(model),
        "torque": _torque(model, first),
        "drives": _drives(stages.get("clamped")),
        "dh": _dh(model, campaign.robot),
    }
    return {key: text for key, text in out.items() if text}


def _measured(campaign: Campaign) -> str:
    """``632 poses of ur10_series_d, measured by a laser tracker``."""
    measured = []
    for table, one, column in (("poses", "pose", "pose"), ("distances", "pose", "pose"), ("clamped", "sweep", "sweep")):
        if table in campaign.tables:
            count = int(campaign.tables[table][column].nunique())
            measured.append(f"{counted(count, one)}{_OF.get(table, '')}")
    rows = sum(len(campaign.tables[table]) for table in ("free_air", "wrist") if table in campaign.tables)
    if rows:
        measured.append(f"{counted(rows, 'row')} of motor torques")
    return f"{listed(measured, 4)} were measured." if measured else ""


_OF = {"distances": " with distances to anchors", "clamped": " with the flange clamped"}


def _rounds(model: Model, first: Model | None) -> str:
    """By how much the held-out error fell, of poses where there are some."""
    for stage in in_order(model.stages):
        rounds = rounds_of(model, first, stage)
        if not rounds:
            continue
        unit, last = unit_of(stage), rounds[-1]
        before, now = error_texts([rounds[0].heldout_rms, last.heldout_rms], unit)
        floor = error_text(last.noise_floor, unit)
        if len(rounds) == 1:
            return f"The held-out error of the start model is {now}; the noise floor is {floor}."
        word = "fell" if last.heldout_rms < rounds[0].heldout_rms else "rose"
        return f"The held-out error {word} from {before} to {now}; the noise floor is {floor}."
    return ""


def _added(rounds: Sequence[Round]) -> list[str]:
    """The effects of rounds, each once, with all their places."""
    places: dict[str, list[str]] = {}
    for label in (label for r in rounds for label in r.added):
        effect, _, place = label.partition("@")
        places.setdefault(effect, []).extend([place] if place else [])
    return [named(effect, list(dict.fromkeys(at))) for effect, at in places.items()]


def _steps(model: Model, first: Model | None) -> str:
    """What was added, and how many others were rejected."""
    rounds = [r for stage in in_order(model.stages) for r in rounds_of(model, first, stage) if r.added]
    rejected = sum(len(r.evidence.get("rejected", ())) for r in rounds)
    if not rounds:
        return ""
    also = f"; {rejected} other candidate{'s were' if rejected > 1 else ' was'} rejected" if rejected else ""
    names = listed(_added(rounds), 3)
    return f"{names[:1].upper()}{names[1:]} {'was' if len(_added(rounds)) == 1 else 'were'} added{also}."


def _truth(truth: Sequence[Json] | None, model: Model) -> str:
    """What the demo had hidden, and whether the model has it."""
    if truth is None:
        return ""
    hidden = [(str(t.get("effect", "")), str(t.get("where", ""))) for t in truth]
    if not hidden:
        return "Nothing was hidden."
    have = {term.label for part in model.stages.values() for term in part.terms}
    every = all(f"{effect}@{place}" in have or effect in have for effect, place in hidden)
    names = listed([named(effect, [place] if place else []) for effect, place in hidden], 4)
    was, they = ("were", "they are") if len(hidden) > 1 else ("was", "it is")
    end = f"; {they} in the model." if every else "; not all of it is in the model by that name."
    return f"{names[:1].upper()}{names[1:]} {was} hidden{end}"


def _space(poses: StageData | None) -> str:
    """What the model leaves of the measured points, and the worst of them."""
    if poses is None:
        return ""
    good = poses.good.all(axis=1)
    if not good.any():
        return ""
    size = np.linalg.norm(poses.residual[good], axis=1)
    rms = float(np.sqrt(np.mean(size**2)))
    most = error_text(float(size.max()), "m")
    return f"The model leaves {error_text(rms, 'm')} rms at all measured points, {most} at most."


def _budget(poses: StageData | None) -> str:
    """Which effect of the robot, other than its geometry, moves the points most."""
    if poses is None or not poses.good.any():
        return ""
    shares = [s for s in pose_budget(poses) if s.name != SETUP and float(s.total[0]) > 0.0]
    if not shares:
        return ""
    top = max(shares, key=lambda s: float(s.total[0]))
    name = top.name.replace("_", " ")
    return (
        f"{name[:1].upper()}{name[1:]}: {error_text(float(top.total[0]), 'm')} rms, the largest effect on the points."
    )


def _model(model: Model) -> str:
    """How many parameters are identifiable; numbers of curves, of which each says nothing, are not counted."""
    parts, curves = [], False
    for stage in in_order(model.stages):
        part = model.stages[stage]
        many = {key for key, count in Counter((s.effect, s.place) for s in part.slots).items() if count > CURVE}
        known = [
            ok for slot, ok in zip(part.slots, part.identified, strict=True) if (slot.effect, slot.place) not in many
        ]
        curves |= bool(many)
        parts.append(f"{sum(map(bool, known))} of {len(known)} in {stage_title(stage).partition(' (')[0].lower()}")
    end = ", the curves' numbers not counted" if curves else ""
    return f"Identifiable parameters: {listed(parts, 4)}{end}." if parts else ""


def _torque(model: Model, first: Model | None) -> str:
    """The held-out error of motor torques and the noise floor."""
    said = []
    for stage in in_order(model.stages):
        rounds = rounds_of(model, first, stage)
        if not kind_of(stage).points and rounds:
            now = error_text(rounds[-1].heldout_rms, unit_of(stage))
            said.append(f"{now} in {stage_title(stage).partition(' (')[0].lower()}")
    return f"Held-out torque error: {listed(said, 3)}, the noise floor is 1 σ." if said else ""


def _drives(clamped: StageData | None) -> str:
    """The softest drive, and how many clearances differ from zero."""
    if clamped is None or not any_of_role(clamped.model.slots, "compliance"):
        return ""
    d = drives_of(clamped.model, clamped.first.rows.robot)
    k = np.where(np.isfinite(d.joint_stiffness) & (d.joint_stiffness > 0.0), d.joint_stiffness, np.inf)
    if not np.isfinite(k).any():
        return ""
    soft, clear = int(np.argmin(k)), int(sum(map(bool, d.gap_identified)))
    found = (
        f"{clear} clearance{'s differ' if clear != 1 else ' differs'} from zero" if clear else "no clearance is found"
    )
    return (
        f"The softest drive is that of axis {soft + 1}, {number(float(k[soft]) / 1e3)} kNm/rad at the joint; {found}."
    )


def _dh(model: Model, robot: RobotDescription) -> str:
    """The largest deviation of a length from the nominal table, of those that are determined."""
    if known_of(model.stages, "points") is None:
        return ""
    try:
        frame, nominal = static_table(model, "hayati", robot=robot), nominal_rows(robot, "hayati")
    except (DHError, ModelError):
        return ""
    off = [
        (float(row[f"{name}_m"]) - getattr(nominal[i], name), name, i + 1)
        for i, (_, row) in enumerate(frame.iloc[: len(nominal)].iterrows())
        for name in ("d", "a")
        if np.isfinite(float(row[f"std_{name}_m"]))
    ]
    if not off:
        return ""
    change, name, row = max(off, key=lambda item: abs(item[0]))
    return f"Largest deviation of a length from the nominal table: {name} of row {row}, {number(1e3 * change)} mm."
