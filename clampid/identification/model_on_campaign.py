"""A model applied to a campaign, or to all campaigns that it was fitted on: rows, predictions and refits."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from clampid.effect import Effect, Stage
from clampid.fitting.bootstrap import Bootstrap
from clampid.identification.fitted_stage import FittedStage, fit_stage
from clampid.identification.identify import effects_in, stage_rows, stages_of
from clampid.models.model import Model, ModelError, StageModel
from clampid.models.own_effects import effects_of
from clampid.progress import substep
from clampid.role_slots import has_role
from clampid.roles import Role
from clampid.slots import Layout, Slot
from clampid.stages.fit_problem import FitProblem, fit_problem
from clampid.stages.layout import layout_of
from clampid.stages.pose_rows import Anchors, pose_rows
from clampid.stages.rows import Array, Integers, Rows
from clampid.stages.stage_kind import known_of
from experiments.campaign import Campaign

__all__ = ["ModelOnCampaign", "on_campaign"]


@dataclass(frozen=True)
class ModelOnCampaign:
    """A model with one campaign, or with all campaigns that it was fitted on.

    Attributes
    ----------
    model, campaigns, effects
        The model, the campaigns, and the catalogue (name → effect).
    layout
        Layout of the campaigns.
    session
        For a single campaign, its index among those that the model was fitted on; None if it is not one of them, or
        for several campaigns.
    stages
        The model's stages, with the slots' places renamed to this layout.
    base
        Session → reference pose of the base ``(4, 4)``, instrument frame; None: from the rows of the campaign.
    anchors
        Session → reference positions of the anchors of distances; None: from the campaign.
    """

    model: Model
    campaigns: tuple[Campaign, ...]
    effects: Mapping[str, Effect]
    layout: Layout
    session: int | None
    stages: Mapping[Stage, StageModel]
    base: Mapping[int, Array] | None
    anchors: Anchors | None = None

    @property
    def campaign(self) -> Campaign:
        """The campaign, or the first of several."""
        return self.campaigns[0]

    def has(self, tables: Collection[str]) -> bool:
        """Whether any campaign has any of these tables."""
        return any(table in c.tables for c in self.campaigns for table in tables)

    def active(self, stage: Stage) -> tuple[Effect, ...]:
        """The active effects of a stage."""
        return effects_in(self.stages[stage].terms, self.effects)

    def rows(self, stage: Stage) -> Rows:
        """The rows of a stage, for its active effects."""
        return stage_rows(
            self.campaigns, self.layout, stage, self.base, active=self.active(stage), anchors=self.anchors
        )

    def verification(self, base: Mapping[int, Array] | None = None) -> Rows | None:
        """The rows of the table ``verification``; None if there is none. ``base`` replaces that of this value."""
        if not self.has(("verification",)) or known_of(self.stages, "points") is None:
            return None
        return pose_rows(self.campaigns, self.layout, "verification", base or self.base)

    def fit_problem(self, stage: Stage, rows: Rows) -> FitProblem:
        """The problem of rows of a stage with the model's slots."""
        model = self.stages[stage]
        return fit_problem(rows, self.effects, model.slots, model.lean)

    def held_out(self, stage: Stage) -> tuple[tuple[int, ...], ...]:
        """Numbers of the folds that were held out, for each campaign; empty for a campaign that was not fitted."""
        kept = self.stages[stage].held_out
        if len(self.campaigns) > 1:
            return kept
        if self.session is None or not kept:
            return ()
        return (kept[self.session],) if len(kept) > self.session else ()

    @substep("fitting the effects again", 0.3)
    def refit(self, stage: Stage, rows: Rows | None = None, *, settled: bool = False) -> FittedStage:
        """Fit a stage's active effects to the campaigns again, from the model's values.

        Parameters
        ----------
        stage
            The stage.
        rows
            Its rows, if they have been read.
        settled
            Whether poses are fitted once more, starting with the noise that the first fit learned. A round of ``add``
            starts with that of the round before. So both reject the same outliers.
        """
        before = {s: m for s, m in self.stages.items() if s != stage}
        model = self.stages[stage]
        rows = self.rows(stage) if rows is None else rows
        start, held_out = model.values(), self.held_out(stage)
        others = model.carried_prior or before
        found = fit_stage(rows, self.effects, model.terms, others, start, held_out)
        if not (settled and model.kind.points):
            return found
        return fit_stage(rows, self.effects, model.terms, others, found.model.values(), held_out, last=found.estimate)


def on_campaign(
    model: Model, campaigns: Campaign | Sequence[Campaign], user_effects: Path | None = None
) -> ModelOnCampaign:
    """Apply a model to a campaign, or to all campaigns that it was fitted on, in their order.

    Parameters
    ----------
    model
        The model.
    campaigns
        One campaign, or all that the model was fitted on.
    user_effects
        File or folder of the user's own effects; None: that of the model.

    Raises
    ------
    ModelError
        The model is of another robot, has unknown effects, or no stage that the campaign has tables for; or several
        campaigns are not those of the model.
    """
    several = (campaigns,) if isinstance(campaigns, Campaign) else tuple(campaigns)
    for campaign in several:
        if campaign.robot.name != model.robot:
            raise ModelError(
                f"the model is of the robot {model.robot}, the campaign {campaign.name} of {campaign.robot.name}"
            )
    effects = effects_of(model, user_effects)
    return _on_one(model, several[0], effects) if len(several) == 1 else _on_all(model, several, effects)


def _on_all(model: Model, campaigns: tuple[Campaign, ...], effects: Mapping[str, Effect]) -> ModelOnCampaign:
    """The model on all campaigns that it was fitted on."""
    layout = layout_of(campaigns)
    prints = tuple(c.fingerprint for c in campaigns)
    if layout != model.layout or prints != tuple(s.fingerprint for s in model.sessions):
        names = ", ".join(s.name for s in model.sessions)
        raise ModelError(f"expected the campaigns that the model was fitted on, in their order ({names}), found others")
    base = {k: s.base_reference for k, s in enumerate(model.sessions) if s.base_reference is not None}
    anchors = {k: s.anchors for k, s in enumerate(model.sessions)} if base else None
    return ModelOnCampaign(model, campaigns, effects, layout, None, model.stages, base or None, anchors)


def _on_one(model: Model, campaign: Campaign, effects: Mapping[str, Effect]) -> ModelOnCampaign:
    """The model on one campaign, which may be one that it was fitted on or a new one."""
    prints = [s.fingerprint for s in model.sessions]
    session = prints.index(campaign.fingerprint) if campaign.fingerprint in prints else None
    here = [s for s in stages_of([campaign]) if s in model.stages]
    if not here:
        raise ModelError(
            f"the model has the stages {', '.join(model.stages)}, the campaign {campaign.name} tables for "
            f"{', '.join(stages_of([campaign])) or 'none'}"
        )
    layout = layout_of([campaign])
    stages = {s: _renamed(model.stages[s], session or 0, len(model.sessions), layout) for s in here}
    if session is None or len(model.sessions) > 1:  # the sweep of an event is counted over all sessions
        stages = {s: _left_out(m, [e for e in effects.values() if e.event is not None]) for s, m in stages.items()}
    if session is None:  # effects of another session, such as a settling base, do not apply to this one
        stages = {s: _left_out(m, [e for e in effects.values() if e.of_session]) for s, m in stages.items()}
    # Stages without a table in this campaign still give loads and flanks.
    stages |= {s: m for s, m in model.stages.items() if s not in stages}
    base = anchors = None
    reference = model.sessions[session or 0].base_reference if model.sessions else None
    if reference is not None and session is not None:
        base, anchors = {0: reference}, {0: model.sessions[session].anchors}
    return ModelOnCampaign(model, (campaign,), effects, layout, session, stages, base, anchors)


def _renamed(stage: StageModel, session: int, sessions: int, layout: Layout) -> StageModel:
    """The stage with the slots of the robot and of one session, whose places are renamed to a single session's."""
    keep, slots = [], []
    prefix = f"session{session + 1}:"
    for k, slot in enumerate(stage.slots):
        place = slot.place
        if sessions > 1 and has_role(slot, "target_point", "anchor_point"):
            if not place.startswith(prefix):
                continue
            place = place.removeprefix(prefix)
        elif re.fullmatch(r"session\d+", place):
            if place != f"session{session + 1}":
                continue
            place = layout.sessions[0]
        known: dict[Role, tuple[str, ...]] = {"target_point": layout.targets, "anchor_point": layout.anchors}
        if any(has_role(slot, role) and place not in names for role, names in known.items()):
            continue
        keep.append(k)
        slots.append(Slot(slot.effect, slot.parameter, place))
    chosen = np.array(keep, dtype=int)
    return StageModel(
        stage=stage.stage,
        terms=stage.terms,
        slots=tuple(slots),
        theta=stage.theta[chosen],
        covariance=stage.covariance[np.ix_(chosen, chosen)],
        identified=tuple(stage.identified[k] for k in keep),
        held_out=stage.held_out,
        outliers=tuple(o for o in stage.outliers if o[0] == session),
        null_directions=stage.null_directions,
        base=stage.base,
        observability=stage.observability,
        bootstrap=None if stage.bootstrap is None else _taken(stage.bootstrap, chosen),
        carried_prior=stage.carried_prior,
        by_springs=None if stage.by_springs is None else stage.by_springs[chosen],
        lean=stage.lean,
        ranges=stage.ranges,
    )


def _left_out(stage: StageModel, removed: Sequence[Effect]) -> StageModel:
    """The stage without some effects, such as events or effects of another session."""
    names = {effect.name for effect in removed}
    keep = np.array([k for k, s in enumerate(stage.slots) if s.effect not in names], dtype=int)
    if len(keep) == len(stage.slots):
        return stage
    return replace(
        stage,
        terms=tuple(t for t in stage.terms if t.effect not in names),
        slots=tuple(stage.slots[k] for k in keep),
        theta=stage.theta[keep],
        covariance=stage.covariance[np.ix_(keep, keep)],
        identified=tuple(stage.identified[k] for k in keep),
        bootstrap=None if stage.bootstrap is None else _taken(stage.bootstrap, keep),
        by_springs=None if stage.by_springs is None else stage.by_springs[keep],
    )


def _taken(found: Bootstrap, chosen: Integers) -> Bootstrap:
    """The bootstrap's results for the parameters with numbers ``chosen``."""
    return replace(found, std=found.std[chosen], low=found.low[chosen], high=found.high[chosen])
