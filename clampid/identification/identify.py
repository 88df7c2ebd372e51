"""Identification of a model from campaigns, stage by stage (free air, clamped, poses) or jointly."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from clampid.catalogue import with_user_effects
from clampid.effect import STAGES, Effect, EffectError, Stage
from clampid.fitting.bootstrap import bootstrap as by_poses
from clampid.fitting.solve import FitError
from clampid.identification.fitted_stage import Cost, FittedStage, fit_stage
from clampid.identification.identify_log import LogStage
from clampid.identification.joint import JointPart, fit_jointly, shared_slots
from clampid.identification.joint_vs_stagewise import joint_fit_disagreements
from clampid.models.model import Model, Round, Session, StageModel
from clampid.progress import in_parts
from clampid.slots import Layout, Term, parse_term
from clampid.stages.counting import needs_whole_log
from clampid.stages.layout import layout_of
from clampid.stages.log_facts import log_parts
from clampid.stages.pose_rows import Anchors
from clampid.stages.rows import Array, Rows
from clampid.stages.stage_kind import Wanted, kind_of, kinds, stages_with
from clampid.stages.steady_share import steady_share
from clampid.standard_sets import DYNAMICS, POSES_ALONE, POSES_DIRECTED, STANDARD
from clampid.threads import single_threaded
from experiments.campaign import Campaign, CampaignError

__all__ = [
    "FittedStage",
    "effects_in",
    "fit_stage",
    "identify",
    "session_of",
    "stage_rows",
    "stages_of",
    "standard_effects",
    "verification_rows",
]

LEAST_STEADY_SHARE = 0.9  # of a log's motion: without the rest, standard errors grow by 5 %


def stages_of(campaigns: Sequence[Campaign]) -> tuple[Stage, ...]:
    """The stages that the campaigns have tables for, in the order of identification."""
    return tuple(s for s in STAGES if any(t in c.tables for c in campaigns for t in kind_of(s).tables))


def standard_effects(campaigns: Sequence[Campaign]) -> dict[Stage, tuple[Term, ...]]:
    """The standard set of effects for each stage that the campaigns have tables for.

    Poses alone get geometry, springs of the drives, and backlash if approach directions were recorded. Logs get the
    inertia of rotors and links where they accelerate: if less than nine tenths of their rows in motion would count
    without it, or if these would have less than nine tenths of the mean squared speed. All other effects are left to
    diagnosis.
    """
    found = stages_of(campaigns)
    names = dict(STANDARD)
    alone = [kind for kind in map(kind_of, found) if kind.points] if all(kind_of(s).resting for s in found) else []
    for kind in alone:
        n = campaigns[0].robot.n
        columns = [f"dir{i + 1}" for i in range(n)]
        directed = any(
            (c.tables[t][columns] != 0).any(axis=None) for c in campaigns for t in kind.tables if t in c.tables
        )
        names[kind.name] = (*POSES_ALONE, *(POSES_DIRECTED if directed else ()))
    for stage in found:
        if kind_of(stage).moving and min(steady_share(log_parts([c])) for c in campaigns) < LEAST_STEADY_SHARE:
            names[stage] += DYNAMICS
    return {stage: tuple(Term(n) for n in names[stage]) for stage in found}


def stage_rows(
    campaigns: Sequence[Campaign],
    layout: Layout,
    stage: Stage,
    base: Mapping[int, Array] | None = None,
    table: str = "",
    active: Collection[Effect] = (),
    anchors: Anchors | None = None,
) -> Rows:
    """The rows of a stage.

    Parameters
    ----------
    campaigns, layout
        The campaigns, and their layout.
    stage
        The stage.
    base
        Session → reference pose of the base ``(4, 4)``, instrument frame; None: from the rows themselves.
    table
        Another table to read as rows of this stage, such as ``verification``.
    active
        Active effects, which decide which rows can be used.
    anchors
        Session → reference positions of the anchors of distances.
    """
    return kind_of(stage).rows(campaigns, layout, Wanted(active, base, anchors, table))


def effects_in(terms: Iterable[Term], effects: Mapping[str, Effect]) -> tuple[Effect, ...]:
    """The effects of some terms; terms of unknown effects are left out."""
    return tuple(effects[name] for name in dict.fromkeys(t.effect for t in terms) if name in effects)


def resolve_terms(
    wanted: Mapping[Stage, Sequence[str]] | Sequence[str] | None,
    campaigns: Sequence[Campaign],
    effects: Mapping[str, Effect],
    layout: Layout,
) -> dict[Stage, tuple[Term, ...]]:
    """The terms of every stage, from the names that the user gave; other stages keep their standard set.

    Parameters
    ----------
    wanted
        Stage → names (``effect`` or ``effect@joint3``), or a list of names if there is a single stage, or None.
    campaigns, effects, layout
        The campaigns, the catalogue (name → effect), and the layout of the campaigns.

    Raises
    ------
    EffectError
        An effect is unknown, does not exist at its place or does not act in its stage; a stage is unknown or has no
        table; or a list without a stage is given although there are several stages.
    """
    terms = standard_effects(campaigns)
    if wanted is None:
        return terms
    if not isinstance(wanted, Mapping):
        if len(terms) > 1:
            raise EffectError(
                f"--effects: expected STAGE=a,b,…, because the campaign has tables of {', '.join(terms)}; found a list "
                "without a stage"
            )
        wanted = {next(iter(terms)): wanted}
    for stage, names in wanted.items():
        if stage not in STAGES:
            raise EffectError(f"stage {stage!r} is not known; known: {', '.join(STAGES)}")
        if stage not in terms:
            raise EffectError(f"the campaign has no table of the stage {stage}; it has: {', '.join(terms)}")
        chosen = tuple(parse_term(name, effects, layout) for name in names if name.strip())
        if not chosen:
            raise EffectError(f"stage {stage}: expected at least one effect, found none")
        for term in chosen:
            if not kind_of(stage).has(effects[term.effect]):
                acts = ", ".join(stages_with(effects[term.effect]))
                raise EffectError(f"effect {term.effect} does not act in {stage}; it does in: {acts}")
        terms[stage] = tuple(dict.fromkeys(chosen))
    return terms


def held_out_folds(rows: Rows, share: float, seed: int) -> tuple[tuple[int, ...], ...]:
    """Numbers of the folds (whole poses, runs or sweeps) to hold out, for each session.

    ``share``: of the folds of each session, 0 … 1; ``seed``: for the choice.
    """
    if share <= 0:
        return ()
    out: list[tuple[int, ...]] = []
    for s in range(len(rows.layout.sessions)):
        part = rows.take(np.flatnonzero(rows.session == s))
        if not len(part):
            out.append(())
            continue
        order = part.shuffled_folds(seed)
        count = min(round(share * len(order)), len(order) - 1)
        picked = order[((np.arange(count) + 0.5) * len(order) / max(count, 1)).astype(int)]
        out.append(tuple(sorted(int(f) for f in picked - part.fold.min())))
    return tuple(out)


@single_threaded
def identify(
    campaigns: Sequence[Campaign] | Campaign,
    effects: Mapping[Stage, Sequence[str]] | Sequence[str] | None = None,
    *,
    holdout: float = 0.0,
    seed: int = 0,
    joint: bool = False,
    user_effects: Path | None = None,
    bootstrap: int = 0,
    cost: Cost = "least-squares",
) -> Model:
    """Fit a model to one or several campaigns of one robot.

    Parameters
    ----------
    campaigns
        The campaigns; several are sessions of one robot.
    effects
        Stage → names of effects (``effect`` or ``effect@joint3``); a list of names if there is a single stage; None:
        the standard set.
    holdout
        Share of whole poses, runs and sweeps that are held out.
    seed
        For the choice of held-out rows, cross-validation and bootstrap.
    joint
        Whether all tables are fitted at once, with common values of shared parameters; otherwise stage by stage, with
        results of earlier stages as priors.
    user_effects
        File or folder of the user's own effects.
    bootstrap
        Number of bootstrap draws of whole poses, for standard errors that do not assume normal noise; 0: none.
    cost
        Cost of the stage ``poses``: ``least-squares``, or ``mean-norm``, that of the universal model
        (:mod:`clampid.fitting.mean_norm`).

    Raises
    ------
    CampaignError
        The campaigns are of different robots or have no table to fit.
    EffectError
        An effect is unknown or does not act in its stage.
    FitError
        The rows do not allow the fit; or the mean norm is combined with a joint fit or a bootstrap, or without poses.
    """
    several = [campaigns] if isinstance(campaigns, Campaign) else list(campaigns)
    _same_robot(several)
    catalogue = with_user_effects(user_effects)
    layout = layout_of(several)
    terms = resolve_terms(effects, several, catalogue, layout)
    if cost == "mean-norm" and (joint or bootstrap or not any(kind_of(s).points for s in terms)):
        raise FitError("cost mean-norm: expected a table poses, and neither a joint fit nor a bootstrap")
    parts: list[JointPart] = []
    before: dict[Stage, StageModel] = {}
    for stage, wanted in in_parts(terms.items(), lambda item: f"fitting {item[0]}"):
        active, log = effects_in(wanted, catalogue), None
        if kind_of(stage).moving and not needs_whole_log(active):
            log = LogStage(log_parts(several), layout, catalogue, wanted)
        if log is not None and (log.linear or not joint):
            parts.append(log.fit(held_out_folds(log.folds, holdout, seed), seed=seed))
        else:
            rows = stage_rows(several, layout, stage, active=active)
            held_out, own = held_out_folds(rows, holdout, seed), cost if kind_of(stage).points else "least-squares"
            fitted = fit_stage(rows, catalogue, wanted, before, held_out=held_out, cost=own)
            parts.append(fitted if joint else fitted.with_best_weights(seed))
        before[stage] = parts[-1].model
    alone = parts
    if joint:
        parts = fit_jointly(alone)
    ledger = []
    reference: dict[int, Array] = {}
    anchors: Anchors = {}
    for part, apart in zip(parts, alone, strict=True):
        verification = None
        if isinstance(part, FittedStage):
            reference |= part.base_reference
            anchors = part.anchors or anchors
            verification = verification_rows(several, layout, part.model.stage, part.base_reference)
        errors = part.errors(verification, seed)
        labels = tuple(t.label for t in part.model.terms)
        evidence = part.evidence
        if joint:
            moved = joint_fit_disagreements(apart.model, part.model, shared_slots(alone))
            evidence |= {"joint": True, "moved": [m.to_json() for m in moved]}
        stage = part.model.stage
        ledger.append(Round(stage, labels, (), errors.rms, errors.heldout_rms, errors.noise_floor, evidence))
    stages = {part.model.stage: part.model for part in parts}
    for part in parts:
        if bootstrap and isinstance(part, FittedStage) and part.model.kind.points:
            stages[part.model.stage] = replace(part.model, bootstrap=by_poses(part.estimate, bootstrap, seed))
    sessions = tuple(session_of(c, reference.get(s), anchors.get(s)) for s, c in enumerate(several))
    path = None if user_effects is None else str(user_effects)
    name, file = several[0].robot.name, several[0].robot_file
    return Model(name, layout, stages, sessions, tuple(ledger), seed, holdout, path, joint, file)


def verification_rows(
    campaigns: Sequence[Campaign], layout: Layout, stage: Stage, base: Mapping[int, Array]
) -> Rows | None:
    """The rows of the table that verifies a stage and is never fitted; None if there is none.

    ``base``: session → reference pose of the base ``(4, 4)``, instrument frame.
    """
    table = kind_of(stage).verification
    if not any(table in c.tables for c in campaigns):
        return None
    return stage_rows(campaigns, layout, stage, base, table)


def _same_robot(campaigns: Sequence[Campaign]) -> None:
    """Raise :class:`CampaignError` unless the campaigns are of one robot and have a table to fit."""
    if not campaigns:
        raise CampaignError("expected at least one campaign, found none")
    first = campaigns[0]
    for other in campaigns[1:]:
        if other.robot.name != first.robot.name:
            raise CampaignError(
                f"{other.name}: expected the robot of {first.name}, {first.robot.name}, found {other.robot.name}; "
                "several campaigns are sessions of one robot"
            )
    if not stages_of(campaigns):
        known = [table for kind in kinds() for table in kind.tables]
        raise CampaignError(f"{first.name}: expected a table {', '.join(known[:-1])} or {known[-1]} to fit, found none")


def session_of(campaign: Campaign, reference: Array | None, anchors: Mapping[str, Array] | None = None) -> Session:
    """The session of a model: what it keeps of a campaign that it was fitted on.

    Parameters
    ----------
    campaign
        The campaign.
    reference
        Reference pose of the base ``(4, 4)``, instrument frame; None without poses.
    anchors
        Name → reference position of an anchor ``(3,)``, m.
    """
    temperature = None
    for table in ("poses", "distances", "free_air", "clamped"):
        if table in campaign.long and temperature is None:
            temperature = campaign.long[table].warmth
            continue
        columns = [c for c in campaign.tables.get(table, ()) if str(c).startswith("temp_")]
        if columns and temperature is None:
            values = campaign.tables[table][columns].to_numpy(float)
            values = values[np.isfinite(values)]
            temperature = (float(values.min()), float(values.max())) if values.size else None
    com, gravity = (tuple(np.asarray(v, dtype=float).tolist()) for v in (campaign.tool.com, campaign.gravity))
    targets, mass = tuple(campaign.targets), campaign.tool.mass
    return Session(
        campaign.name, campaign.fingerprint, reference, targets, mass, temperature, com, gravity, anchors or {}
    )
