"""Diagnosis of a model on a campaign: where it fails, and which physical effect is missing, stage by stage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from clampid.alignment import simpler
from clampid.compensation import Compensation, compensation_of
from clampid.diagnosis.next_measurement import NextPoses
from clampid.diagnosis.result import StageDiagnosis
from clampid.diagnosis.score import Scored
from clampid.diagnosis.stage import diagnose_stage
from clampid.effect import Effect, Stage
from clampid.fitted_stage import FittedStage, fit_stage
from clampid.fitting.solve import Estimate
from clampid.identify import TABLES_OF, session_of
from clampid.model import Model
from clampid.omission import exported_shift, shift_in_words
from clampid.reopen import Reopened, reopen
from clampid.slots import Slot, Term
from clampid.threads import single_threaded
from experiments.campaign import Campaign

__all__ = ["Diagnosis", "diagnose"]


@dataclass(frozen=True)
class Diagnosis:
    """What was found, stage by stage.

    Attributes
    ----------
    compensation
        Mistakes of the controller's own compensation that were measured along, by name; None where none shows.
    simpler
        Stage → effects that say with one curve what the model, with what was found missing, says with several.
    """

    stages: Mapping[Stage, StageDiagnosis]
    compensation: Compensation | None = None
    simpler: Mapping[Stage, Sequence[Mapping[str, Any]]] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """For programs: INTERFACE's JSON of ``diagnose``."""
        simpler = {name: {"simpler": list(found)} for name, found in self.simpler.items() if found}
        stages = {name: {**stage.to_json(), **simpler.get(name, {})} for name, stage in self.stages.items()}
        data: dict[str, Any] = {"stages": stages}
        if self.compensation is not None:
            data["compensation"] = self.compensation.to_json()
        return data


@single_threaded
def diagnose(
    model: Model,
    campaigns: Campaign | Sequence[Campaign],
    *,
    seed: int = 0,
    flips: int = 199,
    user_effects: Path | None = None,
    stages: Sequence[Stage] | None = None,
) -> Diagnosis:
    """Find out where a model fails on a campaign, or on several at once, and which effect is missing.

    The model's active effects are fitted to the campaigns first, from the model's values, so that what they could still
    absorb is not taken for evidence.

    Parameters
    ----------
    campaigns
        One, or all that the model was fitted on, as sessions of one robot.
    flips
        Sign flips that decide: p_familywise is at least 1/(flips + 1).
    stages
        Those to diagnose; by default all that the campaigns have tables for.

    Raises
    ------
    ModelError
        The model does not fit the campaigns.
    """
    opened = reopen(model, campaigns, user_effects)
    found: dict[Stage, StageDiagnosis] = {}
    for stage in opened.stages:
        wanted = stages is None or stage in stages
        if wanted and opened.has(TABLES_OF[stage]):
            found[stage] = _one(opened, stage, seed, flips)
    mended = {stage: part.fitted.estimate for stage, part in found.items() if part.fitted is not None}
    several = len(opened.campaigns) > 1  # each has a controller's setting of its own
    alone = [reopen(model, c, user_effects) for c in opened.campaigns] if several else [opened]
    compensation = next((c for c in map(compensation_of, alone) if c is not None), None)
    if compensation is not None and "poses" in found:
        found["poses"].summary = f"{compensation.said} {found['poses'].summary}".strip()
    return Diagnosis(found, compensation, {stage: simpler(estimate) for stage, estimate in mended.items()})


def _one(opened: Reopened, stage: Stage, seed: int, flips: int) -> StageDiagnosis:
    rows = opened.rows(stage)
    fitted = opened.refit(stage, rows)
    before = {s: m for s, m in opened.stages.items() if s != stage}

    def refit(terms: Sequence[Term], last: FittedStage, start: Mapping[Slot, float]) -> FittedStage:
        known = {**start, **last.model.values()}
        return fit_stage(rows, opened.effects, terms, before, known, opened.held(stage), opened.stages[stage].told)

    verification = opened.verification(fitted.base_reference) if stage == "poses" else None

    def propose(estimate: Estimate, rivals: Sequence[Scored], scale: float) -> NextPoses | None:
        from clampid.diagnosis.next_poses import next_poses  # brings collision checking along, which few need

        return next_poses(opened.campaign, estimate, rivals, scale, seed)

    asked = propose if stage == "poses" and len(opened.campaigns) == 1 else None
    found = diagnose_stage(fitted, _effects_for(opened, stage), refit, verification, seed, flips, asked)
    if stage == "poses" and found.added and found.fitted is not None:
        ends = [_alone(opened, end) for end in (fitted, found.fitted)]
        found.exported_shift = exported_shift(ends[0], ends[1], opened.campaign.robot)
        found.summary = f"{found.summary} {shift_in_words(found.exported_shift)}".rstrip()
    return found


def _alone(opened: Reopened, poses: FittedStage) -> Model:
    """A model of the poses of these campaigns alone."""
    sessions = tuple(session_of(c, poses.base_reference.get(s)) for s, c in enumerate(opened.campaigns))
    return replace(opened.model, layout=opened.layout, stages={"poses": poses.model}, sessions=sessions)


def _effects_for(opened: Reopened, stage: Stage) -> dict[str, Effect]:
    """The effects that a stage looks for.

    What acts as a torque at a joint shows in torque logs directly. Where there are such logs, poses do not blame one
    that these did not call for: a spring on a joint bends the arm just as an eccentric gear does.
    """
    effects = dict(opened.effects)
    if stage != "poses" or not opened.has(TABLES_OF["free_air"]):
        return effects
    known = {t.effect for s in ("free_air", "poses") if s in opened.stages for t in opened.stages[s].terms}
    return {
        name: e
        for name, e in effects.items()
        if set(e.acts) != {"joint_torque"} or "free_air" not in e.stages or name in known
    }
