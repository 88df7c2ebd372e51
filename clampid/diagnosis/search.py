"""The search of one stage: score, confirm, add, refit, and start again, until nothing more is confirmed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from clampid.diagnosis.candidate_scores import CandidateScores
from clampid.diagnosis.confirmed import Confirmed, with_needed_only
from clampid.diagnosis.folds import Folds, folds_of, parts_of_runs, runs_determine_each_other
from clampid.diagnosis.held_out import HeldOut
from clampid.diagnosis.scoring import scored_beside_probes
from clampid.diagnosis.trial import Bench
from clampid.diagnosis.tried import Left, Taken, Tried, Undecided
from clampid.evidence.score import Scored
from clampid.fitting.wander import Level, larger
from clampid.identification.fitted_stage import FittedStage

__all__ = ["Searched", "search"]

SEARCH_ROUNDS = 8


@dataclass(frozen=True)
class Searched:
    """The result of a search.

    Attributes
    ----------
    before
        Held-out errors of the first fit, on the rows that count in the last one.
    first_look
        Scores on the residual of the first fit.
    steps
        Confirmed steps.
    taken
        Groups of candidates that these rows cannot distinguish, one of which was added to the model.
    undecided
        Such groups without a member in the model.
    refused
        Candidates refused in the last round, as listed.
    fitted, held_out, scores
        The last fit, its held-out errors, and the scores on its residual.
    rest
        What the fit with one of each undecided group leaves, the others granted; None where it is not known.
    wander
        By how much readings wander, at most, with everything found in the model; None if they do not.
    """

    before: HeldOut
    first_scores: CandidateScores
    steps: list[Confirmed]
    taken: list[Taken]
    undecided: list[Undecided]
    refused: list[dict[str, Any]]
    fitted: FittedStage
    held_out: HeldOut
    scores: CandidateScores
    rest: Left | None
    wander: Level | None

    @property
    def left(self) -> Left | None:
        """What the last fit leaves; with undecided groups, what is left beside them."""
        return self.rest if self.undecided else Left(self.fitted.estimate, self.scores, self.held_out)

    @property
    def least_wander(self) -> float:
        """Variance of the level that readings had at least where something was found; infinite if nothing was."""
        groups = [*(t.group for t in self.taken), *self.undecided]
        scores = [*(s.tried.scores for s in self.steps), *(g.scores for g in groups)]
        return min((0.0 if s.wander is None else s.wander.variance for s in scores), default=math.inf)


def search(bench: Bench, fitted: FittedStage) -> Searched | Folds:
    """Search for missing effects; returns parts of runs to hold out instead if whole runs would not test a candidate.

    If there is no candidate by the noise of the fit, they are tried by the noise that is left beside the significant
    probes. If these rows cannot distinguish candidates whose predictions are the same everywhere, one of them is added
    and the search goes on; otherwise their residual would hide other effects. In poses none is added: models that agree
    on these poses give other flange positions elsewhere.
    """
    first, rows, effects = fitted, fitted.estimate.problem.rows, bench.effects
    if bench.folds is None and not runs_determine_each_other(fitted.estimate, bench.seed):
        return Folds(*parts_of_runs(rows), because=())
    scores = bench.scores(fitted, 0)
    if bench.folds is None:
        finer = folds_of(fitted.estimate, scores.space, _on_trial(scores), effects)
        if finer is not None:
            return finer
    before, first_scores = bench.held_out(fitted), scores.remembered
    held_out = before
    steps: list[Confirmed] = []
    taken: list[Taken] = []
    undecided: list[Undecided] = []
    refused: list[dict[str, Any]] = []
    dropped: set[str] = set()
    rest: Left | None = None
    wander: Level | None = None
    earlier: dict[str, Tried] = {}
    earlier_beside: dict[str, Tried] = {}
    for number in range(1, SEARCH_ROUNDS + 1):
        tried, others = bench.decided(scores, fitted, held_out, earlier)  # a ranking is valid for one step
        beside = _beside_probes(bench, scores, fitted, 2 * number - 2) if tried is None else None
        if beside is not None:
            tried, more = bench.decided(beside, fitted, held_out, earlier_beside)
            others += more
        finer = bench.folds or folds_of(fitted.estimate, scores.space, _on_trial(scores, others), effects)
        if finer is not None and finer is not bench.folds:
            return finer
        refused = [t.refusal(effects) for t in others]
        if isinstance(tried, Undecided) and not rows.kind.points and tried.alike(effects, bench.elsewhere):
            taken.append(bench.taken(tried, fitted, held_out, len(steps)))
            fitted, held_out = taken[-1].fitted, taken[-1].held_out
        else:
            if isinstance(tried, Undecided):
                scores, beside = scores.remembered, None  # others are about to be made
                given = bench.confirm_given_ambiguity(tried, fitted, held_out, number, earlier)
                tried, undecided, rest, wander = given.found, given.groups, given.rest, larger(wander, given.wander)
                refused += [t.refusal(effects) for t in given.refused]
            if tried is None:
                break
            steps = with_needed_only(bench, [*steps, Confirmed(tried, fitted, held_out, tuple(refused))], dropped)
            fitted, held_out = steps[-1].tried.fitted, steps[-1].tried.held_out
        wider = bench.on_its_rows(fitted)  # motors at rest count with a friction that has a state
        if wider is not fitted:
            fitted, held_out = wider, bench.held_out(wider)
            before = bench.held_out(bench.refit(first.model.terms, replace(first, rows=wider.rows), {}))
        scores = scores.remembered  # the whole is as large as its rows, and the next is about to be made
        scores = bench.scores(fitted, 2 * number)
    if not undecided:  # else these scores are from before, and `given.wander` is that beside the undecided groups
        wander = larger(wander, scores.wander)
    return Searched(before, first_scores, steps, taken, undecided, refused, fitted, held_out, scores, rest, wander)


def _beside_probes(bench: Bench, scores: CandidateScores, fitted: FittedStage, number: int) -> CandidateScores | None:
    """The scores by the noise beside the significant probes, with a stream of flips; None if that is as before."""
    found = scored_beside_probes(
        fitted.estimate, scores, bench.effects, flips=bench.flips, seed=bench.seed + number, block=bench.block
    )
    return None if found is None else bench.in_its_folds(found, fitted)


def _on_trial(scores: CandidateScores, refused: Sequence[Tried] = ()) -> list[Scored]:
    """The candidates on trial: the best name of some scores, and those that were refused after it."""
    best = scores.best()
    return [*([] if best is None else [best]), *(t.best for t in refused)]
