"""What to measure next in a stage, from its own pool of poses, runs or sweeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from clampid.diagnosis.candidate_scores import CandidateScores
from clampid.diagnosis.deciding import Deciding, OpenPair, decide_most
from clampid.diagnosis.next_measurement import POWER, SAME, STATES, NextPlan
from clampid.diagnosis.pools import Pool, seen_of
from clampid.diagnosis.propose import PoolOf, Weak, parting_aim, propose_parting, propose_testing
from clampid.diagnosis.refit_signals import Rivals
from clampid.diagnosis.testability import noncentrality
from clampid.effect import Effect, EffectError, Stage
from clampid.evidence.candidates import Candidate
from clampid.evidence.score import Scored
from clampid.fitting.solve import Estimate
from clampid.slots import Slot
from clampid.stages.fit_problem import parameter_of
from clampid.stages.stage_kind import kind_of
from experiments.campaign import Campaign
from experiments.plans.errors import PlanError

__all__ = ["Undecided", "parting_plan", "separating_plan", "showing_plan", "weak_ones"]

BETTER = 0.5  # of the present limit: the aim where a parameter of its usual size would be found already
WARMTH = frozenset({"link_temperature", "motor_temperature", "ambient_temperature", "elapsed"})


def parting_plan(
    campaign: Campaign, estimate: Estimate, rivals: Sequence[Scored], scale: float, seed: int
) -> NextPlan | None:
    """Measurements that distinguish candidates.

    Raises
    ------
    PlanError
        The campaign's robot lets no measurement be planned.
    """
    pool = _pool_of(campaign, estimate, seed)
    return propose_parting(pool, estimate, rivals, scale, _states(estimate, [s.candidate for s in rivals]))


@dataclass(frozen=True)
class Undecided:
    """A pair of effects that explain the same.

    Attributes
    ----------
    without
        The fit without either.
    two
        Both, as scored on that fit.
    scale
        Standard deviation of the whitened residual.
    evidence
        Of the first over the second so far, twice the logarithm of the odds.
    """

    without: Estimate
    two: tuple[Scored, Scored]
    scale: float
    evidence: float


def separating_plan(
    campaign: Campaign, pairs: Sequence[Undecided], seed: int, most: int, states: Sequence[str] = STATES
) -> tuple[NextPlan, Deciding] | None:
    """Measurements that decide as many of several pairs as can be, and what they are expected to decide.

    Measurements that need a rest before them and those that need none are compared by the number of pairs that they
    are expected to decide for each measurement (:mod:`clampid.diagnosis.deciding`). None where none decides any.

    Parameters
    ----------
    most
        How many at most.
    states
        In which the robot can be measured, the more convenient first.

    Raises
    ------
    PlanError
        The campaign's robot lets no measurement be planned.
    """
    wanted = {state for pair in pairs for state in _states(pair.without, [s.candidate for s in pair.two])}
    best: tuple[NextPlan, Deciding] | None = None
    for state in (s for s in states if s in wanted):
        pools = [_pool_of(campaign, p.without, seed)([s.candidate for s in p.two], state) for p in pairs]
        opened = [_open_pair(pair, pool) for pair, pool in zip(pairs, pools, strict=True)]
        pool = pools[0]
        found = decide_most(
            opened, bound=SAME, power=POWER, batch=pool.batch, most=min(pool.most, most), cost=pool.cost
        )
        if not found.chosen or (best is not None and not _saves_one(found, best[1])):
            continue
        likely = list(found.likely(POWER))
        before, after = float(found.before[likely].min()), float(found.after[likely].min())
        parts = "; ".join(" and ".join(s.candidate.label for s in pairs[k].two) for k in likely)
        plan = pool.plan(found.chosen, parting_aim(parts, before, after))
        words = pool.words(found.chosen)
        best = NextPlan("parting", found.chosen, len(pool), state, pool.what, words, plan, before, after), found
    return best


def _open_pair(pair: Undecided, pool: Pool) -> OpenPair:
    seen = seen_of(pair.without, [s.candidate for s in pair.two])
    prior = np.zeros((seen.nuisance.shape[1],) * 2)  # it is among the rows
    values = [s.value for s in pair.two]
    rivals = Rivals(seen.nuisance / pair.scale, [D / pair.scale for D in seen.columns], values, prior)
    return OpenPair(rivals, (pool.nuisance / pair.scale, [D / pair.scale for D in pool.columns]), pair.evidence)


def _saves_one(new: Deciding, best: Deciding) -> bool:
    """Whether a less convenient proposal saves at least one measurement for each pair that is decided."""
    return new.decided > 0.0 and (best.decided <= 0.0 or 1.0 / new.decided <= 1.0 / best.decided - 1.0)


def showing_plan(
    campaign: Campaign, estimate: Estimate, weak: Sequence[Weak], scale: float, seed: int
) -> NextPlan | None:
    """Measurements that test parameters which the rows test too weakly; see `parting_plan`."""
    pool = _pool_of(campaign, estimate, seed)
    return propose_testing(pool, estimate, weak, scale, _states(estimate, [w.scored.candidate for w in weak]))


def _states(estimate: Estimate, candidates: Sequence[Candidate]) -> tuple[str, ...]:
    """``warm`` only, if neither fit nor candidates depend on temperature or time."""
    names = {slot.effect for slot in estimate.slots} | {c.name for c in candidates}
    needs = {signal for name in names for signal in estimate.problem.effects[name].needs}
    return STATES if needs & WARMTH or estimate.problem.kind.points else STATES[:1]


def _pool_of(campaign: Campaign, estimate: Estimate, seed: int) -> PoolOf:
    # Each brings collision checking along, which few need.
    stage: Stage = estimate.problem.stage
    if kind_of(stage).points:
        if "poses" not in campaign.tables:
            raise PlanError("poses are planned for an instrument that measures points, and these rows are distances")

        from clampid.diagnosis.next_poses import poses_to_choose

        return partial(poses_to_choose, campaign, estimate, seed=seed)
    if kind_of(stage).moving:
        from clampid.diagnosis.next_runs import runs_to_choose

        return partial(runs_to_choose, campaign, estimate, seed=seed)
    from clampid.diagnosis.next_sweeps import sweeps_to_choose

    return partial(sweeps_to_choose, campaign, estimate, seed=seed)


def weak_ones(
    scores: CandidateScores, estimate: Estimate, effects: Mapping[str, Effect], names: Sequence[str] = ()
) -> list[Weak]:
    """Parameters of which these rows would not find the usual size with 90 % probability.

    Parameters
    ----------
    scores
        Scores of the candidates, with the null distribution that decides.
    names
        ``effect`` or ``effect@joint3``: these only, even if a usual size would be found already; then the aim is half
        of the present limit. Empty: all.

    Raises
    ------
    EffectError
        A name is no effect, or none that could be added in this stage.
    """
    wanted = [_asked(name, scores, effects) for name in names]
    factor: dict[int, float] = {}
    out: dict[Slot, Weak] = {}
    shapes: dict[str, Mapping[Slot, float]] = {}
    for s in sorted(scores.named, key=lambda s: len(s.candidate.terms)):
        c = s.candidate
        if c.prior is not None or effects[c.name].event is not None:
            continue
        if wanted and not any(_matches(s, name, place) for name, place in wanted):
            continue
        if shapes.setdefault(c.name, c.shapes) != c.shapes and len(c.terms) == 1:
            continue  # the same at other values of its shapes
        freedom = max(s.freedom, 1)
        if freedom not in factor:
            factor[freedom] = noncentrality(freedom, scores.named_null)
        for k, slot in enumerate(c.slots):
            parameter = parameter_of(slot, effects, estimate.problem.rows.robot)
            limit = float(s.unit_limit[k] * np.sqrt(factor[freedom]))
            found = np.isfinite(limit) and limit <= parameter.size and s.state != "absorbed"
            if slot in out or (found and not wanted):
                continue
            aim = BETTER * limit if found else parameter.size
            out[slot] = Weak(s, k, factor[freedom], parameter, aim)
    return list(out.values())


def _asked(name: str, scores: CandidateScores, effects: Mapping[str, Effect]) -> tuple[str, str]:
    """Effect, and place or nothing."""
    effect, _, place = name.partition("@")
    known = {s.candidate.name for s in scores.named}
    if effect not in known:
        also = "it is in the model already, or does not act here" if effect in effects else "there is no such effect"
        raise EffectError(
            f"{name}: expected an effect that could be added, found none: {also}; there are {', '.join(sorted(known))}"
        )
    if not any(_matches(s, effect, place) for s in scores.named):
        places = sorted({p for s in scores.named if effect == s.candidate.name for p in s.candidate.places})
        raise EffectError(f"{name}: expected one of its places, {', '.join(places)}, found {place!r}")
    return effect, place


def _matches(s: Scored, effect: str, place: str) -> bool:
    c = s.candidate
    return effect == c.name and (not place or c.places == (place,))
