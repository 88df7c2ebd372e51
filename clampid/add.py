"""Adding effects: fit again with them, and say what the error was and is on held-out rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from clampid.accuracy import StageErrors, noise_floor, stage_errors
from clampid.diagnosis.candidates import named_candidates
from clampid.diagnosis.events import event_scores
from clampid.diagnosis.score import score, space_of
from clampid.effect import STAGES, Effect, EffectError, Stage
from clampid.fitted_stage import FittedStage, fit_stage
from clampid.identify import (
    has_friction_state,
    has_inertia,
    session_of,
    stage_rows,
    stages_of,
    verification_rows,
)
from clampid.model import Model, Round, StageModel
from clampid.omission import exported_shift
from clampid.reopen import reopen
from clampid.slots import Layout, Term, find_parameter, parse_term
from clampid.stages.rows import Array
from clampid.threads import single_threaded
from experiments.campaign import Campaign

__all__ = ["Addition", "add"]


@dataclass(frozen=True)
class StageAddition:
    """What was added in one stage, the errors before and after, and what its lack had done to the exported table."""

    added: tuple[dict[str, Any], ...]
    before: StageErrors
    after: StageErrors
    shift: tuple[dict[str, Any], ...] = ()


@dataclass(frozen=True)
class Addition:
    """What adding effects did, stage by stage."""

    stages: Mapping[Stage, StageAddition]

    def to_json(self) -> dict[str, Any]:
        """For programs: INTERFACE's JSON of ``add``."""
        return {
            "stages": {
                name: {
                    "unit": "m" if name == "poses" else "sigma",
                    "added": list(s.added),
                    "noise_floor": s.after.noise_floor,
                    "heldout_rms_before": s.before.heldout_rms,
                    "heldout_rms_after": s.after.heldout_rms,
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
    """Add effects to a model and fit it again.

    Parameters
    ----------
    terms
        ``[STAGE=]EFFECT[@PLACE]`` each. Without a place: wherever these rows can tell anything about it. Without a
        stage:
        in every stage where the effect acts.

    Raises
    ------
    EffectError
        An effect is unknown, does not act there, or is active already.
    ModelError
        The model does not fit the campaigns.
    """
    several = [campaigns] if isinstance(campaigns, Campaign) else list(campaigns)
    chosen = user_effects or (Path(model.user_effects) if model.user_effects else None)
    opened = reopen(model, several, chosen)
    effects, layout, stages, base = opened.effects, opened.layout, opened.stages, opened.base
    here = [s for s in stages_of(several) if s in stages]
    wanted = _parse(terms, effects, layout, here)
    mended, ledger = dict(stages), list(model.ledger)
    found: dict[Stage, StageAddition] = {}
    references: dict[int, Array] = dict(base or {})
    unmended: StageModel | None = None
    for stage in here:
        asked = wanted.get(stage, [])
        if not asked and not (stage == "poses" and found):
            continue
        # Both models are judged by the same rows: with inertia those in acceleration, too.
        every = (*stages[stage].terms, *asked)
        moves, rests = has_inertia(every, effects), has_friction_state(every, effects)
        rows = stage_rows(several, layout, stage, base, accelerating=moves, resting=rests)
        before_stages = {s: m for s, m in mended.items() if s != stage}
        held, told = stages[stage].held_out, stages[stage].told
        old = fit_stage(rows, effects, stages[stage].terms, before_stages, stages[stage].values(), held, told)
        new_terms, shapes = _resolved(asked, old, effects)
        if not new_terms and asked:
            names = ", ".join(t.label for t in asked)
            raise EffectError(f"{stage}: nothing can be told about {names} from these rows, or it is active already")
        every = (*stages[stage].terms, *new_terms)
        new = (
            fit_stage(rows, effects, every, before_stages, {**shapes, **old.model.values()}, held, told)
            if new_terms
            else old
        )
        # An effect that takes another's place finds its own places.
        every, new_terms = new.model.terms, [t for t in new.model.terms if t not in stages[stage].terms]
        verification = verification_rows(several, layout, stage, new.base_reference)
        # A log's noise is learned from what a model leaves. Both are judged by what the better one leaves: a ripple
        # that was taken for noise would make the error seem to rise when it is gone.
        floor = noise_floor(new.estimate.experiment.rows, new.estimate.residual)
        errors = [stage_errors(f.estimate, rows, held, verification, seed, floor) for f in (old, new)]
        references |= new.base_reference
        mended[stage] = new.model
        if stage == "poses":
            unmended = old.model
        labels = tuple(t.label for t in new_terms)
        if new_terms:
            found[stage] = StageAddition(_listed(new, new_terms, effects), errors[0], errors[1])
            evidence = {"heldout_rms_before": errors[0].heldout_rms, "heldout_rms_after": errors[1].heldout_rms}
            ledger.append(
                Round(
                    stage,
                    tuple(t.label for t in every),
                    labels,
                    errors[1].rms,
                    errors[1].heldout_rms,
                    errors[1].noise_floor,
                    evidence,
                )
            )
    sessions = tuple(session_of(c, references.get(s)) for s, c in enumerate(several))
    result = replace(
        model,
        layout=layout,
        stages=mended,
        sessions=sessions,
        ledger=tuple(ledger),
        user_effects=None if chosen is None else str(chosen),
    )
    if "poses" in found and unmended is not None:
        without = replace(result, stages={**mended, "poses": unmended})
        shift = exported_shift(without, result, several[0].robot)
        found["poses"] = replace(found["poses"], shift=tuple(shift))
    return result, Addition(found)


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
        acts = [s for s in here if s in effects[term.effect].stages and (not named or s == named)]
        if not acts:
            where = named or ", ".join(here)
            raise EffectError(
                f"effect {term.effect} does not act in {where}; it does in: {', '.join(effects[term.effect].stages)}"
            )
        for stage in acts:
            wanted.setdefault(stage, []).append(term)
    return wanted


def _resolved(
    asked: Sequence[Term], fitted: FittedStage, effects: Mapping[str, Effect]
) -> tuple[list[Term], dict[Any, float]]:
    """The terms place by place, where these rows say anything about them, and the best start of their shapes."""
    if not asked:
        return [], {}
    estimate = fitted.estimate
    active = {slot.effect for slot in estimate.slots}
    out = {t: None for t in asked if effects[t.effect].aligns is not None and t.effect not in active}
    asked = [t for t in asked if effects[t.effect].aligns is None]
    absent = {t.effect: effects[t.effect] for t in asked}
    space = space_of(estimate)
    scored = [*score(space, named_candidates(estimate, absent)), *event_scores(estimate, space, absent)]
    shapes: dict[Any, float] = {}
    for term in asked:
        effect = effects[term.effect]
        own = [s for s in scored if s.candidate.name == term.effect and s.freedom]
        if term.place is not None and effect.tried == "jointly":
            out |= {term: None} if own and term in own[0].candidate.terms else {}
            continue
        if term.place is not None and effect.per != "robot" and effect.tried != "together":
            own = [s for s in own if s.candidate.places == (term.place,)]
        for s in sorted(own, key=lambda s: s.explained):
            shapes |= dict(s.candidate.shapes)
            out |= dict.fromkeys(s.candidate.terms)
    return list(out), shapes


def _listed(fitted: FittedStage, terms: Sequence[Term], effects: Mapping[str, Effect]) -> tuple[dict[str, Any], ...]:
    """The added effects with their parameters, one entry an effect."""
    out = []
    model = fitted.model
    std = np.sqrt(np.maximum(np.diag(model.covariance), 0.0))
    for name in dict.fromkeys(t.effect for t in terms):
        places = [t.place for t in terms if t.effect == name and t.place is not None]
        parameters = [
            {
                "name": slot.label,
                "value": float(model.theta[k]),
                "std": float(std[k]),
                "unit": find_parameter(slot, effects).unit,
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
