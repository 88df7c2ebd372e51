"""Score tests of a fit's residual by all effects and all probes, each dictionary with its null distribution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from clampid.diagnosis.candidate_scores import (
    DICTIONARY_FALSE_ALARMS,
    IMPOSSIBLE,
    CandidateScores,
    Wandering,
    best_of,
    standing_out_of,
)
from clampid.diagnosis.drift import blocks_of_visits
from clampid.diagnosis.folds import stability_folds
from clampid.diagnosis.impossible import SURE
from clampid.diagnosis.noise_beside import with_noise_about_its_level, with_noise_beside
from clampid.diagnosis.probes import probes
from clampid.diagnosis.runs_apart import with_runs_apart
from clampid.diagnosis.wandering import level_beside, of_level, whitened_by
from clampid.effect import Effect
from clampid.evidence.candidates import Candidate, columns_of, named_candidates
from clampid.evidence.events import event_scores
from clampid.evidence.exchanges import by_exchanges
from clampid.evidence.flips import Flips, with_null
from clampid.evidence.orders import order_scores
from clampid.evidence.scan import scan
from clampid.evidence.score import Scored, score
from clampid.evidence.space import Space, space_of
from clampid.fitting.further_columns import Derivatives
from clampid.fitting.solve import Estimate
from clampid.fitting.wander import Level, larger
from clampid.slots import number_of
from clampid.stages.fit_problem import parameter_of
from clampid.stages.rows import Rows
from kinematics.description import RobotDescription

__all__ = ["probed_beside_what_stands_out", "scored_beside_probes", "scores_of"]

NOISE_ROUNDS = 4  # in which noise is learned beside what stands out, at most
WEIGHTLESS = 0.1  # of the weight's torque about the joint that bears most: wrists bear less, and none has a balancer


def scores_of(
    estimate: Estimate,
    effects: dict[str, Effect],
    flips: int,
    seed: int,
    granted: Sequence[Candidate] = (),
    block: int = 1,
    wander: Level | None = None,
    seen: Wandering | None = None,
) -> CandidateScores:
    """Score both dictionaries on a fit's residual, with their null distributions.

    If readings wander in addition to the significant candidates, all are scored again with wandering noise
    (:mod:`clampid.diagnosis.wandering`).

    Parameters
    ----------
    flips, seed
        How many sign flips make a null, and their stream; the probes' is the next one.
    granted
        Candidates that are not fitted; what they could explain is not counted as evidence of other candidates.
    block
        Of poses: how many consecutive visits the null flips together.
    wander
        By how much readings are known to wander at least; None if they are not.
    seen
        Of poses: what earlier scores of this fit have shown; None if they did not wander, or are the first.
    """
    known, about = Derivatives(), with_noise_about_its_level(estimate)
    estimate = about or estimate
    if seen is not None:
        slow = of_level(estimate, larger(seen.level, wander) or seen.level)
        return _beside_wandering(_scores_of(slow, effects, flips, seed, granted, block, known), seen)
    found = _scores_of(estimate, effects, flips, seed, granted, block, known)
    level = level_beside(estimate, found.clearest, wander)
    if level is None:
        return replace(found, noise_of_fit=about is None)
    if estimate.noise.autocorrelations:  # learned from what wanders, too
        short = whitened_by(estimate, estimate.noise.of_short_memory)
        of_short = level_beside(short, _scores_of(short, effects, flips, seed, granted, block, known).clearest, wander)
        if of_short is not None:
            estimate, level = short, of_short
    seen = Wandering(level, frozenset(s.candidate.label for s in found.named if s.freedom))
    del found  # as large as its rows and all that is active
    slow = of_level(estimate, level)
    return _beside_wandering(_scores_of(slow, effects, flips, seed, granted, block, known), seen)


def _beside_wandering(scores: CandidateScores, seen: Wandering) -> CandidateScores:
    """The scores by the noise of readings that wander, without the names that the fit absorbs."""
    named = [s if s.candidate.label in seen.shown else replace(s, state="absorbed") for s in scores.named]
    return replace(scores, named=named, wandering=seen, noise_of_fit=False)


class _Probed(NamedTuple):
    """The space of a fit's residual, and the probes' scores on it with their null distribution."""

    space: Space
    free: list[Scored]
    null: Flips


def _probed(estimate: Estimate, flips: int, seed: int, granted: Sequence[Candidate], block: int) -> _Probed:
    space = space_of(estimate, blocks_of_visits(estimate.problem.rows, block)).granting(columns_of(estimate, granted))
    space, free = _with_runs_apart(estimate, space, score(space, probes(estimate)))
    free, null = with_null(space, free, flips, seed + 1)
    return _Probed(space, free, null)


def _with_runs_apart(estimate: Estimate, space: Space, scored: list[Scored]) -> tuple[Space, list[Scored]]:
    """The space, and the scores of candidates on it, with runs of one motion apart if these explain what they share."""
    apart = with_runs_apart(estimate, space, scored)
    return apart, scored if apart is space else score(apart, [s.candidate for s in scored])


def probed_beside_what_stands_out(
    estimate: Estimate,
    scores: CandidateScores,
    flips: int,
    seed: int,
    granted: Sequence[Candidate] = (),
    block: int = 1,
) -> tuple[Estimate, CandidateScores]:
    """A log's fit with the noise that is left beside the significant candidates, and the probes' scores by that noise.

    With less noise more probes may be significant. So this is repeated until there are no more. The names' scores stay
    as they are: laws of effects are approximations, which less noise would tell apart. Nothing changes in other stages,
    nor if readings wander. Parameters as of :func:`scores_of`.
    """
    if scores.wander is not None:
        return estimate, scores
    best, beside = scores.best(), dict[str, Scored]()
    if best is not None:
        beside[best.candidate.label] = best
    for number in range(NOISE_ROUNDS):
        new = {s.candidate.label: s for s in standing_out_of(scores.free, scores.free_null)}
        if number and new.keys() <= beside.keys():
            break
        beside |= new
        again = with_noise_beside(estimate, list(beside.values()))
        if again is None:
            break
        space, free, null = _probed(again, flips, seed, granted, block)
        free = _as_significant(free, null, scores.free, scores.free_null)
        estimate, scores = again, replace(scores, space=space, free=free, free_null=null, probe=best_of(free, null))
    return estimate, scores


def scored_beside_probes(
    estimate: Estimate,
    scores: CandidateScores,
    effects: dict[str, Effect],
    flips: int,
    seed: int,
    block: int = 1,
) -> CandidateScores | None:
    """A log's scores by the noise that is left beside the significant probes; None if that is as before.

    A missing effect that is slow, compared with the time between rows, is learned as noise that lasts, and whitening
    removes most of it. Its name may then explain too little. Parameters as of :func:`scores_of`.
    """
    if scores.wander is not None:
        return None
    again = with_noise_beside(estimate, standing_out_of(scores.free, scores.free_null))
    if again is None:
        return None
    return replace(_scores_of(again, effects, flips, seed, (), block, Derivatives()), noise_of_fit=False)


def _as_significant(again: Sequence[Scored], null: Flips, before: Sequence[Scored], was: Flips) -> list[Scored]:
    """The scores ``again`` of the same probes, each at least as significant as ``before``.

    Flips of a residual that contains an error are as large as the error if only a few units show it. So with less noise
    an error may be less significant.
    """
    p = {s.candidate.label: was.p_familywise(s.log_p) for s in before}
    return [replace(s, log_p=min(s.log_p, null.log_p_at(p[s.candidate.label]))) for s in again]


def _scores_of(
    estimate: Estimate,
    effects: dict[str, Effect],
    flips: int,
    seed: int,
    granted: Sequence[Candidate],
    block: int,
    known: Derivatives,
) -> CandidateScores:
    """The same with the noise that the estimate has."""
    space, free, free_null = _probed(estimate, flips, seed, granted, block)
    fired = {s.candidate.name for s in free if s.freedom and free_null.p_familywise(s.log_p) <= DICTIONARY_FALSE_ALARMS}
    apart, named = _with_runs_apart(estimate, space, score(space, named_candidates(estimate, effects, fired, known)))
    if apart is not space:
        space, free = apart, score(apart, [s.candidate for s in free])
        free, free_null = with_null(space, free, flips, seed + 1)
    events = event_scores(estimate, space, effects) + order_scores(estimate, space, effects)
    named, named_null = with_null(space, named, flips, seed)
    named, named_null = named + events, named_null.joined(len(events), seed)
    named, named_null = _with_permuted(estimate, space, named, named_null, effects, seed)
    robot = estimate.problem.rows.robot
    named = [s if _plausible(s, effects, robot, space.scale) else replace(s, state="implausible") for s in named]
    named = [replace(s, state="absent") if _without_weight(s, effects, estimate.problem.rows) else s for s in named]
    folds = stability_folds(estimate.problem.rows)[estimate.whitened.entry]
    return CandidateScores(space, named, free, named_null, free_null, best_of(free, free_null), folds)


def _with_permuted(
    estimate: Estimate, space: Space, named: list[Scored], null: Flips, effects: dict[str, Effect], seed: int
) -> tuple[list[Scored], Flips]:
    """The scores and their null, with those by permutations: of names that few visits show, and of local errors.

    Half of the false-alarm rate is for them. A name that is tested in both ways has the smaller p-value.
    """
    few = by_exchanges(estimate, space, named, effects, seed + 3)
    local = scan(estimate, space, effects, len(null.maxima), seed)
    if not few and not local:
        return named, null
    both = float(np.log(2.0)) if few and local else 0.0
    permuted = [s.of_many(s.log_p + both, 0.0) for s in [*few.values(), *local]]
    permuted, null = null.sharing(permuted, seed + 2)
    for k, s in zip(few, permuted, strict=False):
        named[k] = min(named[k], s, key=lambda one: one.log_p)
    return [*named, *permuted[len(few) :]], null


def _without_weight(s: Scored, effects: Mapping[str, Effect], rows: Rows) -> bool:
    """Whether it would hold weight at joints that bear next to none in all rows, by the weight described."""
    if not effects[s.candidate.name].holds_weight:
        return False
    bears = np.abs(rows.signals["gravity_torque"]).max(axis=0, initial=0.0)
    joints = [number_of(place) for place in s.candidate.places]
    return bool(np.all(bears[joints] <= WEIGHTLESS * bears.max(initial=0.0)))


def _plausible(s: Scored, effects: Mapping[str, Effect], robot: RobotDescription, scale: float) -> bool:
    """Whether the score's estimates of the parameters have a possible size and sign."""
    value, spread = s.value, SURE * scale * s.spread
    parameters = [parameter_of(slot, effects, robot) for slot in s.candidate.slots]
    if any(abs(v) - sd > IMPOSSIBLE * p.size for p, v, sd in zip(parameters, value, spread, strict=True)):
        return False
    if len(s.candidate.terms) > 1:  # of several places, one step from zero may put a few on the wrong side
        return True
    # So it may of several parts of one whole, which are all of one sign and unit: these are judged by their mean.
    parts: dict[tuple[str, tuple[float, float]], list[int]] = {}
    for k, p in enumerate(parameters):
        parts.setdefault((p.unit, p.bounds), []).append(k)
    means = [(bounds, value[k].mean(), spread[k].mean()) for (_, bounds), k in parts.items()]
    return all(v + sd >= lower and v - sd <= upper for (lower, upper), v, sd in means)
