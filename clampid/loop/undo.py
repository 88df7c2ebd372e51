"""Undo the last round: the model without its effects, fitted again to the campaigns that it came from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from clampid.catalogue import catalogue
from clampid.effect import Effect, Stage
from clampid.identification.fitted_stage import fit_stage
from clampid.identification.identify import effects_in, stage_rows
from clampid.identification.model_on_campaign import on_campaign
from clampid.models.model import Model, ModelError, Round, StageModel
from clampid.slots import Term
from clampid.stages.stage_kind import kind_of
from clampid.threads import single_threaded
from experiments.campaign import Campaign

__all__ = ["undo"]


@single_threaded
def undo(
    model: Model, campaigns: Sequence[Campaign] | Campaign, *, user_effects: Path | None = None
) -> tuple[Model, Round]:
    """Remove the effects of the last round, and fit the model again.

    A model file keeps one state, so the stage is fitted again, from the present values of its parameters. If the round
    was of another stage, the poses are fitted again too: they take loads, flanks and springs from it.

    Parameters
    ----------
    model
        A model whose last round added something.
    campaigns
        Those that the model was fitted on, in their order.
    user_effects
        File or folder with effects of your own; by default that of the model.

    Returns
    -------
    model, round
        The model without the round, and the round.

    Raises
    ------
    ModelError
        Nothing was added to the model, or it was not fitted on these campaigns.
    """
    if not model.ledger or not model.ledger[-1].added:
        raise ModelError("nothing to undo: the last round of the model is its first in that stage, and added nothing")
    several = [campaigns] if isinstance(campaigns, Campaign) else list(campaigns)
    known = {s.fingerprint for s in model.sessions}
    for campaign in several:
        if campaign.fingerprint not in known:
            raise ModelError(f"{campaign.name}: expected a campaign that the model was fitted on, found another")
    last = model.ledger[-1]
    opened = on_campaign(model, several, user_effects)
    effects, layout, stages, base = opened.effects, opened.layout, opened.stages, opened.base
    mended: dict[Stage, StageModel] = dict(stages)
    # Effects that the round had replaced, such as several curves by one, are restored.
    earlier = next((r for r in reversed(model.ledger[:-1]) if r.stage == last.stage), None)
    replaced = [] if earlier is None else [label for label in earlier.effects if label not in last.effects]
    again: list[Stage] = [last.stage]
    if not kind_of(last.stage).points:
        again += [stage for stage in mended if kind_of(stage).points]
    for stage in again:
        old = mended[stage]
        gone = set(last.added) if stage == last.stage else set()
        terms = [t for t in old.terms if t.label not in gone]
        if stage == last.stage:
            terms += [Term(effect, place or None) for effect, _, place in (label.partition("@") for label in replaced)]
        active = effects_in(terms, effects)
        rows = stage_rows(several, layout, stage, base, active=active, anchors=opened.anchors)
        others = {s: m for s, m in mended.items() if s != stage}
        fitted = fit_stage(rows, effects, terms, old.carried_prior or others, old.values(), old.held_out)
        mended[stage] = fitted.with_best_weights(model.seed).model
    own = _still_used(mended, effects)
    chosen = model.user_effects if user_effects is None else str(user_effects)
    return replace(
        model, layout=layout, stages=mended, ledger=model.ledger[:-1], user_effects=chosen if own else None
    ), last


def _still_used(stages: Mapping[Stage, StageModel], effects: Mapping[str, Effect]) -> bool:
    """Whether the model still has an effect of the user's own."""
    return any(t.effect in effects and t.effect not in catalogue() for s in stages.values() for t in s.terms)
