"""Diagnosis of a model on a campaign: where it fails, and which physical effect is missing, stage by stage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from clampid.comparison.compensation import Compensation, compensation_of, summary_prefix, with_actual_joint_values
from clampid.diagnosis.candidate_scores import refuse_few_flips
from clampid.diagnosis.few_rows import refuse_unjudged
from clampid.diagnosis.headline import headline, notes
from clampid.diagnosis.next_measurement import NextPlan
from clampid.diagnosis.next_plan import parting_plan, showing_plan, weak_ones
from clampid.diagnosis.omission import exported_shift, shift_in_words
from clampid.diagnosis.result import StageDiagnosis
from clampid.diagnosis.stage import diagnose_stage
from clampid.diagnosis.trial import Bench
from clampid.effect import Effect, Stage
from clampid.evidence.alignment import simpler
from clampid.evidence.score import Scored
from clampid.fitting.accuracy import counted, noise_floor
from clampid.fitting.solve import Estimate
from clampid.identification.fitted_stage import FittedStage, fit_stage
from clampid.identification.identify import session_of
from clampid.identification.model_on_campaign import ModelOnCampaign, on_campaign
from clampid.models.model import Model
from clampid.progress import in_parts
from clampid.shown import Shown
from clampid.slots import Slot, Term
from clampid.stages.counting import explained
from clampid.stages.stage_kind import acts_with, kind_of, kinds, known_of, only_of
from clampid.threads import single_threaded
from experiments.campaign import Campaign
from experiments.plans.errors import PlanError

__all__ = ["Diagnosis", "diagnose", "with_fits"]

FLIPS = 199
LARGEST_KEPT_FIT = 300  # parameters: a fit of twice as many holds 20 MB, and one is kept for every trial


@dataclass(frozen=True, repr=False)
class Diagnosis(Shown):
    """What was found, stage by stage.

    Attributes
    ----------
    compensation
        Errors of the controller's own compensation that the poses contain, by name; None where none shows.
    simpler
        Stage → effects that replace several curves of the model, with its missing effects added, by one curve.
    """

    stages: Mapping[Stage, StageDiagnosis]
    compensation: Compensation | None = None
    simpler: Mapping[Stage, Sequence[Mapping[str, Any]]] = field(default_factory=dict)

    def title(self) -> str:
        """The verdict on all stages in a sentence."""
        return headline(self.to_json()["stages"])

    def findings(self) -> list[str]:
        """Notes that a person must know beside the verdict."""
        return [note for name, part in self.to_json()["stages"].items() for note in notes(name, part)]

    def records(self) -> list[dict[str, Any]]:
        """The candidates, stage by stage."""
        return [record for stage in self.stages.values() for record in stage.records()]

    def errors(self) -> dict[str, tuple[str, dict[str, float | None]]]:
        """Stage → held-out errors without and with what was missing."""
        return {name: error for stage in self.stages.values() for name, error in stage.errors().items()}

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
    flips: int = FLIPS,
    user_effects: Path | None = None,
    stages: Sequence[Stage] | None = None,
    plan_for: Sequence[str] | None = None,
) -> Diagnosis:
    """Find where a model fails on a campaign, or on several at once, and which effect is missing.

    The model's active effects are fitted first, so errors that they can absorb are not evidence. A stage takes loads,
    frictions and springs from the stages before it, with the effects that were found missing there. If effects of an
    earlier stage are not distinguishable, the loads have correspondingly larger standard errors.

    Parameters
    ----------
    campaigns
        One, or all that the model was fitted on, as sessions of one robot.
    flips
        Sign flips that decide: p_familywise is at least 1/(flips + 1), and at most the level of the test.
    stages
        Those to diagnose; by default all that the campaigns have tables for.
    plan_for
        Effects, ``effect`` or ``effect@joint3``, that the next measurements are to test if no candidates have to be
        distinguished; empty: all that the rows test too weakly. None: no such plan.

    Raises
    ------
    ModelError
        The model does not fit the campaigns.
    EffectError
        There are fewer flips than the level of the test needs: nothing could be found to be missing.
    """
    found = _found(model, campaigns, user_effects, seed, flips, stages, plan_for)
    for part in found.stages.values():
        part.forget_fits()
    return found


@single_threaded
def with_fits(
    model: Model, campaigns: Campaign | Sequence[Campaign], *, seed: int = 0, user_effects: Path | None = None
) -> Diagnosis:
    """As :func:`diagnose`; each step remembers its fit, to be added without another one."""
    return _found(model, campaigns, user_effects, seed)


def _found(
    model: Model,
    campaigns: Campaign | Sequence[Campaign],
    user_effects: Path | None,
    seed: int,
    flips: int = FLIPS,
    stages: Sequence[Stage] | None = None,
    plan_for: Sequence[str] | None = None,
) -> Diagnosis:
    """The diagnosis of all stages that are asked for, with the fits of its steps."""
    refuse_few_flips(flips)
    opened = mending = on_campaign(model, campaigns, user_effects)
    several = len(opened.campaigns) > 1  # each has a controller's setting of its own
    alone = [on_campaign(model, c, user_effects) for c in opened.campaigns] if several else [opened]
    compensation = next((c for c in map(compensation_of, alone) if c is not None), None)
    posed = any(kind_of(s).points and (stages is None or s in stages) for s in opened.stages)
    right = None if several or compensation is None or not posed else with_actual_joint_values(opened, compensation)
    found: dict[Stage, StageDiagnosis] = {}
    for stage in in_parts(opened.stages, str, lambda stage: 3.0 if kind_of(stage).points else 1.0):
        wanted = stages is None or stage in stages
        if wanted and opened.has(kind_of(stage).tables):
            if kind_of(stage).points and right is not None:  # else what a compensation did would go by other names
                mending = replace(mending, campaigns=right.campaigns, base=right.base)
            found[stage] = part = _one(mending, stage, seed, flips, plan_for)
            taken = part.open or (part.fitted if part.added else None)
            if taken is not None:
                mending = replace(mending, stages={**mending.stages, stage: taken.model})
    mended = {stage: part.fitted.estimate for stage, part in found.items() if part.fitted is not None}
    of_points = known_of(found, "points")
    if compensation is not None and of_points is not None:
        rest = "" if right is None else summary_prefix(compensation)
        of_points.summary = " ".join(filter(None, (compensation.said, rest, of_points.summary)))
    return Diagnosis(found, compensation, {stage: simpler(estimate) for stage, estimate in mended.items()})


def _one(
    opened: ModelOnCampaign, stage: Stage, seed: int, flips: int, plan_for: Sequence[str] | None = None
) -> StageDiagnosis:
    rows = opened.rows(stage)
    fitted = opened.refit(stage, rows)
    before = {s: m for s, m in opened.stages.items() if s != stage}

    done: dict[tuple[object, ...], FittedStage] = {}

    def refit(terms: Sequence[Term], last: FittedStage, start: Mapping[Slot, float]) -> FittedStage:
        known, held_out = {**last.model.values(), **start}, opened.held_out(stage)
        others = opened.stages[stage].carried_prior or before
        # Poses may be searched twice, and then most of what is fitted is the same. Some fits are too large to be kept.
        key = (tuple(terms), tuple(known.items()), float(last.estimate.noise.sigma.sum()))
        found = done.get(key)
        if found is None:
            found = fit_stage(last.rows, opened.effects, terms, others, known, held_out, last=last.estimate)
            if kind_of(stage).points and len(found.estimate.theta) <= LARGEST_KEPT_FIT:
                done[key] = found
        return found

    that_count = {explained(opened.active(stage)): fitted.rows}

    def on_its_rows(last: FittedStage) -> FittedStage:
        if not kind_of(stage).moving:
            return last
        model = replace(opened, stages={**opened.stages, stage: last.model})
        wanted = explained(model.active(stage))
        if wanted not in that_count:
            that_count[wanted] = model.rows(stage)
        wider = replace(last, rows=that_count[wanted])
        return last if wider.rows is last.rows else refit(last.model.terms, wider, {})

    verification = opened.verification(fitted.base_reference) if kind_of(stage).points else None
    if opened.stages[stage].carried_prior is None:  # else the model knows more than these rows
        refuse_unjudged(fitted, verification is not None)

    refused: list[str] = []

    def propose(estimate: Estimate, rivals: Sequence[Scored], scale: float) -> NextPlan | None:
        try:
            return parting_plan(opened.campaign, estimate, rivals, scale, seed)
        except PlanError as error:
            refused.append(f"No plan can be made: {error}.")
            return None

    asked = propose if len(opened.campaigns) == 1 else None
    effects = _effects_for(opened, stage)
    bench = Bench(
        effects=effects,
        refit=refit,
        verification=verification,
        floor=noise_floor(*counted(fitted.estimate, verification)),
        seed=seed,
        flips=flips,
        called_for=_called_for(opened, stage),
        on_its_rows=on_its_rows,
        elsewhere=frozenset(s for s in opened.stages if s != stage and opened.has(kind_of(s).tables)),
    )
    found = diagnose_stage(fitted, bench, asked)
    found.warnings += refused
    if kind_of(stage).points and found.next_plan is not None:
        from clampid.diagnosis.next_poses import poses_of

        found.next_poses = poses_of(opened.campaign, found.next_plan, seed)
    if plan_for is not None and len(opened.campaigns) == 1 and not found.undecided:
        _test_too(opened, found, effects, plan_for, seed)
    if kind_of(stage).points and found.added and found.fitted is not None:
        ends = [_alone(opened, end) for end in (fitted, found.fitted)]
        found.exported_shift = exported_shift(ends[0], ends[1], opened.campaign.robot)
        found.summary = f"{found.summary} {shift_in_words(found.exported_shift)}".rstrip()
    return found


def _test_too(
    opened: ModelOnCampaign, found: StageDiagnosis, effects: dict[str, Effect], names: Sequence[str], seed: int
) -> None:
    """Plan what tests better what the rows of a stage test too weakly."""
    if found.scores is None or found.fitted is None:
        return
    estimate = found.fitted.estimate
    here = [n for n in names if found.stage in getattr(effects.get(n.partition("@")[0]), "stages", (found.stage,))]
    if names and not here:
        return
    weak = weak_ones(found.scores, estimate, effects, here)
    try:
        found.next_plan = showing_plan(opened.campaign, estimate, weak, found.scores.space.scale, seed)
    except PlanError as error:
        found.warnings.append(f"No plan can be made: {error}.")


def _alone(opened: ModelOnCampaign, poses: FittedStage) -> Model:
    """A model of the poses of these campaigns alone."""
    seen, anchors = poses.base_reference, poses.anchors
    sessions = tuple(session_of(c, seen.get(s), anchors.get(s)) for s, c in enumerate(opened.campaigns))
    return replace(opened.model, layout=opened.layout, stages={poses.model.stage: poses.model}, sessions=sessions)


def _called_for(opened: ModelOnCampaign, stage: Stage) -> frozenset[Term]:
    """Effects at the joints that the torque log has shown, for the stage of poses."""
    if not kind_of(stage).points or known_of(opened.stages, "moving") is None:
        return frozenset()
    known = only_of(opened.stages, "moving").terms
    return frozenset(t for t in known if set(opened.effects[t.effect].acts) == {"joint_torque"})


def _effects_for(opened: ModelOnCampaign, stage: Stage) -> dict[str, Effect]:
    """The effects that a stage searches.

    Torques at a joint show in torque logs directly. If there are such logs, the poses search no torque effect that the
    logs did not show, because in poses a spring on a joint looks like an eccentric gear. A tool that differs between
    tables is an exception: the logs do not show it. Some are not searched in poses without logs either
    (:attr:`clampid.search_policy.Search.shown_by`).
    """
    measured = {s for s in opened.stages if opened.has(kind_of(s).tables)}
    both = [model for model in opened.stages.values() if model.kind.moving or model.kind.points]
    known = {term.effect for model in both for term in model.terms}
    effects = {
        name: e
        for name, e in opened.effects.items()
        if e.search.differs_from in (None, *measured) and (e.search.shown_by in (None, stage) or name in known)
    }
    logged = any(kind.moving and opened.has(kind.tables) for kind in kinds())
    if not kind_of(stage).points or not logged:
        return effects
    return {
        name: e
        for name, e in effects.items()
        if set(e.acts) != {"joint_torque"} or not acts_with(e, "moving") or name in known
    }
