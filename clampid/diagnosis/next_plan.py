"""What to measure next in a stage, from its own pool of poses, runs or sweeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from clampid.diagnosis.candidate_scores import CandidateScores
from clampid.diagnosis.next_measurement import ENOUGH, STATES, NextPlan
from clampid.diagnosis.parting import Rivals, Separation, part_each
from clampid.diagnosis.pools import Pool, seen_of
from clampid.diagnosis.propose import PoolOf, Weak, parting_aim, propose_parting, propose_testing
from clampid.diagnosis.testability import noncentrality
from clampid.effect import Effect, EffectError, Stage
from clampid.evidence.candidates import Candidate
from clampid.evidence.score import Scored
from clampid.fitting.solve import Estimate
from clampid.slots import Slot
from clampid.stages.fit_problem import parameter_of
from clampid.stages.rows import Array
from clampid.stages.stage_kind import kind_of
from experiments.campaign import Campaign
from experiments.plans.errors import PlanError

__all__ = ["parting_plan", "separating_plan", "showing_plan", "weak_ones"]

BETTER = 0.5  # of the present limit: what is to be reached where a parameter of its usual size would be found already
WARMTH = frozenset({"link_temperature", "motor_temperature", "ambient_temperature", "elapsed"})


def parting_plan(
    campaign: Campaign, estimate: Estimate, rivals: Sequence[Scored], scale: float, seed: int
) -> NextPlan | None:
    """Measurements that part candidates.

    Raises
    ------
    PlanError
        The campaign's robot lets no measurement be planned.
    """
    pool = _pool_of(campaign, estimate, seed)
    return propose_parting(pool, estimate, rivals, scale, _states(estimate, [s.candidate for s in rivals]))


def separating_plan(
    campaign: Campaign,
    pairs: Sequence[tuple[Estimate, Sequence[Scored], float]],
    seed: int,
    most: int,
    states: Sequence[str] = STATES,
) -> tuple[NextPlan, tuple[int, ...]] | None:
    """Measurements that part the two of each of several pairs, and the numbers of the pairs that they are for.

    As few as part any pair, and so chosen that they part as many pairs as possible. None where none parts any. Where as
    many as are allowed do not suffice for one pair, they are proposed all the same.

    Parameters
    ----------
    pairs
        Of each: the fit without either, the two candidates, and the standard deviation of the whitened residual.
    most
        How many at most.
    states
        In which the robot can be measured.

    Raises
    ------
    PlanError
        The campaign's robot lets no measurement be planned.
    """
    wanted = {state for fit, two, _ in pairs for state in _states(fit, [s.candidate for s in two])}
    best: tuple[NextPlan, tuple[int, ...]] | None = None
    for state in (s for s in states if s in wanted):
        rivals, pools = [], []
        for fit, two, scale in pairs:
            candidates = [s.candidate for s in two]
            pool, seen = _pool_of(campaign, fit, seed)(candidates, state), seen_of(fit, candidates)
            prior = np.zeros((seen.nuisance.shape[1],) * 2)  # it is among the rows
            values = [s.value for s in two]
            rivals.append(Rivals(seen.nuisance / scale, [D / scale for D in seen.columns], values, prior))
            pools.append((pool.nuisance / scale, [D / scale for D in pool.columns]))
        found = _fewest(rivals, pools, pool, min(pool.most, most))
        if not found.chosen:
            continue
        parts = "; ".join(" and ".join(s.candidate.label for s in pairs[k][1]) for k in found.pairs)
        before, after = float(found.before.min()), float(found.after.min())
        new = NextPlan(
            aim="parting",
            chosen=found.chosen,
            tried=len(pool),
            state=state,
            what=pool.what,
            words=pool.words(found.chosen),
            plan=pool.plan(found.chosen, parting_aim(parts, before, after)),
            before=before,
            after=after,
        )
        if best is None or _preferred(new, found.pairs) > _preferred(*best):
            best = new, found.pairs
    return best


def _fewest(
    rivals: Sequence[Rivals], pools: Sequence[tuple[Array, Sequence[Array]]], pool: Pool, most: int
) -> Separation:
    """The smallest number of batches that parts any pair, for as many pairs as it parts; else all that are allowed."""
    for allowed in (*range(pool.batch, most, pool.batch), most):
        found = part_each(rivals, pools, enough=ENOUGH, batch=pool.batch, most=allowed, cost=pool.cost)
        if not found.pairs or found.parted:
            break
    return found


def _preferred(proposed: NextPlan, pairs: Sequence[int]) -> tuple[bool, int, int, float]:
    """What is compared of two proposals: whether it helps, with how few measurements, and for how many pairs."""
    return proposed.helps, -len(proposed.chosen), len(pairs), proposed.after if not proposed.helps else 0.0


def showing_plan(
    campaign: Campaign, estimate: Estimate, weak: Sequence[Weak], scale: float, seed: int
) -> NextPlan | None:
    """Measurements in which parameters show that are tested too weakly; see `parting_plan`."""
    pool = _pool_of(campaign, estimate, seed)
    return propose_testing(pool, estimate, weak, scale, _states(estimate, [w.scored.candidate for w in weak]))


def _states(estimate: Estimate, candidates: Sequence[Candidate]) -> tuple[str, ...]:
    """``warm`` alone where neither fit nor candidates know of any warmth."""
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
        What was seen of the candidates, with the null that decides.
    names
        ``effect`` or ``effect@joint3``: these only, whether a usual size would be found or not; then half of the
        present limit is aimed at. All otherwise.

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
