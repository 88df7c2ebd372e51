"""Add effects to a model: fit it again with them, and compare the held-out error before and after."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from clampid.diagnosis.headline import left_out_text
from clampid.diagnosis.omission import exported_shift
from clampid.diagnosis.result import Step
from clampid.effect import STAGES, Effect, EffectError, Stage
from clampid.fitting.accuracy import Floor, StageErrors
from clampid.identification.fitted_stage import FittedStage, fit_stage
from clampid.identification.identify import (
    effects_in,
    session_of,
    stage_rows,
    stages_of,
    verification_rows,
)
from clampid.identification.model_on_campaign import ModelOnCampaign, on_campaign
from clampid.loop.change import Change, change_between
from clampid.loop.resolving import Resolved, by_effect, resolved
from clampid.models.model import Model, Round, StageModel
from clampid.progress import in_parts
from clampid.shown import Shown
from clampid.slots import Layout, Term, fixed_slots, parse_term, unit_of
from clampid.stages.counting import explained
from clampid.stages.rows import Array, Rows
from clampid.stages.stage_kind import kind_of, stages_with
from clampid.threads import single_threaded
from experiments.campaign import Campaign

__all__ = ["Addition", "add", "add_steps"]


@dataclass(frozen=True)
class StageAddition:
    """What was added in one stage, and the errors before and after.

    Attributes
    ----------
    added
        One entry for each effect, with its parameters, as in the JSON of ``add``.
    before, after
        Errors before the first round and after the last.
    change
        Change of the held-out error, with its standard error.
    left_out
        Requested terms that are not identifiable once the effects before them are in the model.
    shift
        By how much the lack of these effects had biased the exported DH table.
    """

    added: tuple[dict[str, Any], ...]
    before: StageErrors
    after: StageErrors
    change: Change
    left_out: tuple[str, ...] = ()
    shift: tuple[dict[str, Any], ...] = ()


@dataclass(frozen=True, repr=False)
class Addition(Shown):
    """Result of adding effects, stage by stage."""

    stages: Mapping[Stage, StageAddition]

    def title(self) -> str:
        """One line: which effects were added."""
        names = [entry["name"] for s in self.stages.values() for entry in s.added]
        return f"added {', '.join(dict.fromkeys(names))}"

    def findings(self) -> list[str]:
        """Where the held-out error has risen or not changed, and what was left out."""
        risen = [f"{name}: the held-out error has risen by more than its standard error." for name in self.worse]
        same = [name for name, s in self.stages.items() if s.change.within_noise]
        unchanged = [f"{name}: the held-out error has not changed within its standard error." for name in same]
        left = [f"{name}: {left_out_text(s.left_out)}." for name, s in self.stages.items() if s.left_out]
        return [*risen, *unchanged, *left]

    def records(self) -> list[dict[str, Any]]:
        """The parameters that were added."""
        return [
            {"stage": name, "effect": entry["name"], **parameter}
            for name, s in self.stages.items()
            for entry in s.added
            for parameter in entry["parameters"]
        ]

    def errors(self) -> dict[str, tuple[str, dict[str, float | None]]]:
        """Stage → held-out errors before and after."""
        return {
            name: (
                kind_of(name).error_unit,
                {"before": s.before.heldout_rms, "after": s.after.heldout_rms, "noise floor": s.after.noise_floor},
            )
            for name, s in self.stages.items()
        }

    @property
    def worse(self) -> tuple[Stage, ...]:
        """Stages whose held-out error has risen by more than its standard error."""
        return tuple(name for name, s in self.stages.items() if s.change.worse)

    def to_json(self) -> dict[str, Any]:
        """For programs: INTERFACE's JSON of ``add``."""
        return {
            "stages": {
                name: {
                    "unit": kind_of(name).error_unit,
                    "added": list(s.added),
                    "left_out": list(s.left_out),
                    "noise_floor": s.after.noise_floor,
                    "heldout_rms_before": s.before.heldout_rms,
                    "heldout_rms_after": s.after.heldout_rms,
                    "heldout_rise": s.change.rise,
                    "heldout_rise_std": s.change.std if math.isfinite(s.change.std) else None,
                    "rms_before": s.before.rms,
                    "rms_after": s.after.rms,
                    "exported_shift": list(s.shift),
                }
                for name, s in self.stages.items()
            }
        }


@single_threaded
def add(
    model: Model,
    campaigns: Sequence[Campaign] | Campaign,
    terms: Sequence[str],
    *,
    seed: int = 0,
    user_effects: Path | None = None,
) -> tuple[Model, Addition]:
    """Add effects to a model and fit it again, one effect after the other, each as a round of its own in the ledger.

    Some effects are identifiable only after another one is in the model, such as friction through springs. So the order
    matters; use that of the diagnosis.

    Parameters
    ----------
    model
        A model of these campaigns.
    campaigns
        Those that the model was fitted on, in their order.
    terms
        ``[STAGE=]EFFECT[@PLACE]`` each. Without a place: wherever these rows identify it. Without a stage: in every
        stage where the effect acts.
    seed
        Of the held-out folds.
    user_effects
        File or folder with effects of your own.

    Returns
    -------
    model, addition
        The new model with its ledger, and what was added.

    Raises
    ------
    EffectError
        An effect is unknown, does not act there, is active already, or is not identifiable from these rows.
    ModelError
        The model does not fit the campaigns.
    """
    opened = on_campaign(model, _several(campaigns), user_effects)
    here = [s for s in stages_of(opened.campaigns) if s in opened.stages]
    wanted = _parse(terms, opened.effects, opened.layout, here)
    mended = _added(opened, {stage: [*map(Step, by_effect(asked))] for stage, asked in wanted.items()}, seed)
    found = {stage: m.addition(opened.effects) for stage, m in mended.items() if m.rounds}
    for stage, asked in wanted.items():
        if stage not in found:
            names = ", ".join(t.label for t in asked)
            there = all(_has(model.stages[stage].terms, term) for term in asked)
            why = "in the model already" if there else "not identifiable from these rows"
            raise EffectError(f"{stage}: {names}: {why}")
    result = _model_with(opened, mended, user_effects)
    for stage in [stage for stage in found if kind_of(stage).points]:
        without = result.with_stage(mended[stage].unmended.model)
        shift = exported_shift(without, result, opened.campaign.robot)
        found[stage] = replace(found[stage], shift=tuple(shift))
    return result, Addition(found)


@single_threaded
def add_steps(
    model: Model,
    campaigns: Sequence[Campaign] | Campaign,
    steps: Mapping[Stage, Sequence[Step]],
    *,
    seed: int = 0,
    user_effects: Path | None = None,
) -> tuple[Model, list[tuple[Stage, Step]]]:
    """Add the steps that a diagnosis confirmed, one after the other, each as a round of its own in the ledger.

    Parameters
    ----------
    model, campaigns, seed, user_effects
        As for :func:`add`.
    steps
        Stage → steps in the order in which they are added.

    Returns
    -------
    model, left_out
        The new model, and the steps that are not identifiable once the others have been added.

    Raises
    ------
    EffectError
        These rows cannot give an effect the initial values that it needs.
    ModelError
        The model does not fit the campaigns.
    """
    opened = on_campaign(model, _several(campaigns), user_effects)
    mended = _added(opened, steps, seed)
    left_out = [(stage, step) for stage, m in mended.items() for step in m.left_out]
    return _model_with(opened, mended, user_effects), left_out


def _several(campaigns: Sequence[Campaign] | Campaign) -> list[Campaign]:
    return [campaigns] if isinstance(campaigns, Campaign) else list(campaigns)


@dataclass(frozen=True)
class _Mended:
    """A stage before and after its rounds, with errors. Without a round: refitted, because an earlier stage changed."""

    unmended: FittedStage
    fitted: FittedStage
    before: StageErrors
    after: StageErrors
    rounds: tuple[Round, ...]
    left_out: tuple[Step, ...]
    change: Callable[[], Change]

    def addition(self, effects: Mapping[str, Effect]) -> StageAddition:
        """Effects added, and the errors before the first round and after the last."""
        terms = [t for t in self.fitted.model.terms if t not in self.unmended.model.terms]
        left_out = tuple(term.label for step in self.left_out for term in step.terms)
        return StageAddition(_listed(self.fitted, terms, effects), self.before, self.after, self.change(), left_out)


def _added(opened: ModelOnCampaign, steps: Mapping[Stage, Sequence[Step]], seed: int) -> dict[Stage, _Mended]:
    """Add all steps of one stage, then those of the next: poses take loads, flanks and springs from earlier stages."""
    mended: dict[Stage, _Mended] = {}
    stages = dict(opened.stages)
    for stage in in_parts([s for s in stages_of(opened.campaigns) if s in opened.stages], str):
        asked = steps.get(stage, ())
        if asked or (kind_of(stage).points and any(m.rounds for m in mended.values())):
            mended[stage] = _stage_with(opened, stage, asked, stages, seed)
            stages[stage] = mended[stage].fitted.model
    return mended


def _stage_with(
    opened: ModelOnCampaign, stage: Stage, steps: Sequence[Step], stages: Mapping[Stage, StageModel], seed: int
) -> _Mended:
    """Add one step after the other to a stage. Each round starts with the fit of the round before."""
    effects, model = opened.effects, opened.stages[stage]
    before = {s: m for s, m in stages.items() if s != stage}
    held_out, others = model.held_out, model.carried_prior or before

    def begin(known: StageModel, active: Sequence[Effect]) -> tuple[FittedStage, Rows | None, StageErrors]:
        rows = stage_rows(opened.campaigns, opened.layout, stage, opened.base, active=active, anchors=opened.anchors)
        fitted = fit_stage(rows, effects, known.terms, others, known.values(), held_out)
        verification = verification_rows(opened.campaigns, opened.layout, stage, fitted.base_reference)
        return fitted, verification, fitted.errors(verification, seed, floor)

    # A missing effect looks like noise in part, so later fits have lower floors. The first one makes rounds comparable.
    floor: Floor | None = None
    active = effects_in((*model.terms, *(steps[0].terms if steps else ())), effects)
    fitted, verification, errors = begin(model, active)
    unmended, first, floor = fitted, errors, fitted.floor
    compared = fitted  # the first fit to the rows on which the last fit is judged
    rounds: list[Round] = []
    left_out: list[Step] = []
    for step in steps:
        # Both models of a round are judged on the same rows. With inertia these include rows in acceleration.
        wanted = effects_in((*fitted.model.terms, *step.terms), effects)
        if explained(wanted) != explained(active):
            active = wanted
            compared, verification, errors = begin(fitted.model, active)
            fitted = compared
        old, worse, rows = fitted.model, errors, fitted.rows
        made = step.fit_with((*old.terms, *step.terms))
        if made is not None and not others and _same(made.rows, rows):
            fitted = made
        else:  # a fit of other rows, or beside other stages, has the same terms identified, and is close
            new = resolved(step.terms, fitted, effects) if made is None else Resolved(step.terms, made.model.values())
            if not new.terms:
                left_out.append(step)
                continue
            every, last = (*old.terms, *new.terms), fitted.estimate
            fitted = fit_stage(rows, effects, every, others, new.start, held_out, last=last)
        errors = fitted.errors(verification, seed, floor)
        rounds.append(_round(old, fitted.model, worse, errors, step.evidence))
    if rounds and kind_of(stage).moving:
        fitted = fitted.with_best_weights(seed)
        errors = fitted.errors(verification, seed, floor)
        known = {**rounds[-1].evidence, "heldout_rms_after": errors.heldout_rms, **fitted.evidence}
        rounds[-1] = replace(rounds[-1], rms=errors.rms, heldout_rms=errors.heldout_rms, evidence=known)
    change = partial(change_between, compared, fitted, held_out, verification, seed, floor)
    return _Mended(unmended, fitted, first, errors, tuple(rounds), tuple(left_out), change)


def _same(one: Rows, other: Rows) -> bool:
    """Whether two sets of rows have the same numbers, and use the same ones."""
    return np.array_equal(one.measured, other.measured) and np.array_equal(one.used, other.used)


def _round(
    old: StageModel, new: StageModel, before: StageErrors, after: StageErrors, evidence: Mapping[str, Any]
) -> Round:
    """A round of the ledger. Its terms are those of the fit: an effect that replaces others chooses its own places."""
    return Round(
        new.stage,
        tuple(t.label for t in new.terms),
        tuple(t.label for t in new.terms if t not in old.terms),
        after.rms,
        after.heldout_rms,
        after.noise_floor,
        {"heldout_rms_before": before.heldout_rms, "heldout_rms_after": after.heldout_rms, **evidence},
    )


def _model_with(opened: ModelOnCampaign, mended: Mapping[Stage, _Mended], user_effects: Path | None) -> Model:
    """The model with its stages mended, and the rounds in its ledger."""
    references: dict[int, Array] = dict(opened.base or {})
    anchors = dict(opened.anchors or {})
    for m in mended.values():
        references |= m.fitted.base_reference
        anchors |= m.fitted.anchors
    model = opened.model
    return replace(
        model,
        layout=opened.layout,
        stages={**opened.stages, **{stage: m.fitted.model for stage, m in mended.items()}},
        sessions=tuple(session_of(c, references.get(s), anchors.get(s)) for s, c in enumerate(opened.campaigns)),
        ledger=(*model.ledger, *(entry for m in mended.values() for entry in m.rounds)),
        user_effects=model.user_effects if user_effects is None else str(user_effects),
    )


def _has(terms: Sequence[Term], asked: Term) -> bool:
    """Whether a model has an effect at the requested place, or anywhere if none is requested."""
    return any(t.effect == asked.effect and (None in (t.place, asked.place) or t == asked) for t in terms)


def _parse(
    texts: Sequence[str], effects: Mapping[str, Effect], layout: Layout, here: Sequence[Stage]
) -> dict[Stage, list[Term]]:
    wanted: dict[Stage, list[Term]] = {}
    for text in texts:
        head, sign, tail = text.partition("=")
        named = head.strip() if sign else ""
        if named and named not in STAGES:
            raise EffectError(f"stage {named!r} is not known; known: {', '.join(STAGES)}")
        term = parse_term(tail if sign else text, effects, layout)
        acts = [s for s in here if kind_of(s).has(effects[term.effect]) and (not named or s == named)]
        if not acts:
            where, acts_in = named or ", ".join(here), ", ".join(stages_with(effects[term.effect]))
            raise EffectError(f"effect {term.effect} does not act in {where}; it does in: {acts_in}")
        for stage in acts:
            wanted.setdefault(stage, []).append(term)
    return wanted


def _listed(fitted: FittedStage, terms: Sequence[Term], effects: Mapping[str, Effect]) -> tuple[dict[str, Any], ...]:
    """The added effects with their parameters, one entry an effect."""
    out = []
    model = fitted.model
    std = np.sqrt(np.maximum(np.diag(model.covariance), 0.0))
    fixed = fixed_slots(model.slots, effects)
    for name in dict.fromkeys(t.effect for t in terms):
        places = [t.place for t in terms if t.effect == name and t.place is not None]
        parameters = [
            {
                "name": slot.label,
                "value": float(model.theta[k]),
                "std": None if fixed[k] else float(std[k]),
                "unit": unit_of(slot, effects, fitted.rows.robot),
                "identified": model.identified[k],
            }
            for k, slot in enumerate(model.slots)
            if slot.effect == name and (not places or slot.place in places)
        ]
        out.append(
            {"effect": effects[name].family, "name": name, "where": places, "parameters": parameters}
            | effects[name].caveat_json
        )
    return tuple(out)
