"""A candidate on trial: what it brings on rows that its fit has not seen, and which of its places pay."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from clampid.diagnosis.candidate_scores import (
    CONFUSABLE,
    CandidateScores,
    of_other_families,
    rivals_of,
    scores_of,
    simplest_of,
    variants_of,
)
from clampid.diagnosis.confirm import (
    cross_fitted_fall,
    event_p,
    first_without_parts,
    same_effect,
    stability,
    terms_p,
)
from clampid.diagnosis.entries import confusable_with
from clampid.diagnosis.folds import Folds
from clampid.diagnosis.held_out import HELD_OUT_RATE, HeldOut, either_p, held_out_of
from clampid.diagnosis.linear_refit import Step, linear_refit, step_towards
from clampid.diagnosis.next_measurement import SAME
from clampid.diagnosis.pruning import Refit, bic_gap, pruned
from clampid.diagnosis.tried import Taken, Tried, Undecided
from clampid.effect import Effect, Stage
from clampid.evidence.candidates import Candidate
from clampid.evidence.score import Scored, canonical
from clampid.fitting.accuracy import Floor
from clampid.fitting.solve import Estimate
from clampid.identification.fitted_stage import FittedStage
from clampid.progress import substep
from clampid.slots import Term
from clampid.stages.rows import Rows

__all__ = ["Bench"]

STABLE = 0.6  # the majority of five parts of the rows
OF_FEW = 0.8  # the same among the few names that stand out: of two, either is first in the majority by chance
GROUPS = 3  # of look-alikes, after which no more are looked for beside them
RISES = 0.5  # a p of the held-out error's fall above which it rather rises
NO_FALL = "the held-out error does not fall"
UNSTABLE = "without a fifth of the rows it is not first"
ONLY_BESIDE = "the held-out error falls only together with effects that these rows do not separate"
IMPOSSIBLE = "at no place is it possible: all of its values lie beyond their bounds"
MOST_TRIALS = 8  # of the candidates of one set of scores, after which no more are tried
ROUND_SHARE = 0.15  # of the work left that a part of a round takes: nobody knows how many rounds there will be
MOSTLY = 0.5  # of what a candidate explains, told by a prior and not by the rows


class _Along(NamedTuple):
    """A candidate, its fit from the step towards it, the terms that pay, and its errors on rows not fitted."""

    scored: Scored
    fitted: FittedStage
    kept: list[Term]
    held_out: HeldOut


@dataclass(frozen=True)
class Bench:
    """What every trial of a stage needs.

    Attributes
    ----------
    refit
        Fits the stage with other terms, from an earlier fit's values and given start values.
    verification
        Rows of a table that no fit sees, where there is one.
    floor
        What noise alone leaves.
    block
        How many consecutive visits of poses are one to the tests.
    called_for
        What other rows of this arm have shown to be there: of look-alikes, these rows say it is that.
    folds
        Parts of runs to hold out instead of whole folds.
    elsewhere
        Other stages of which there are rows.
    """

    effects: dict[str, Effect]
    refit: Refit
    verification: Rows | None
    floor: Floor
    seed: int
    flips: int
    block: int = 1
    called_for: frozenset[Term] = frozenset()
    folds: Folds | None = None
    elsewhere: frozenset[Stage] = frozenset()

    @substep("scoring the candidates", ROUND_SHARE)
    def scores(self, fitted: FittedStage, number: int, granted: Sequence[Candidate] = ()) -> CandidateScores:
        """The scores on what a fit leaves, with its own stream of flips."""
        found = scores_of(fitted.estimate, self.effects, self.flips, self.seed + number, granted, self.block)
        return found if self.folds is None else replace(found, folds=self.folds.fold[fitted.estimate.whitened.entry])

    def held_out(self, fitted: FittedStage) -> HeldOut:
        """A fit's errors on rows that it has not seen."""
        return held_out_of(fitted.estimate, self.verification, self.floor, self.seed, self.block, self.folds)

    def alone(self, fitted: FittedStage, s: Scored) -> float | None:
        """The rms, in the stage's unit, that a candidate would leave of rows that no fit has seen; it is not fitted."""
        estimate = linear_refit(fitted.estimate, s)
        if estimate is None:
            return None
        return held_out_of(estimate, self.verification, self.floor, self.seed, self.block, self.folds).rms

    @substep("trying the best candidates", ROUND_SHARE)
    def decided(
        self, scores: CandidateScores, fitted: FittedStage, held_out: HeldOut
    ) -> tuple[Tried | Undecided | None, list[Tried]]:
        """The first candidate that is confirmed, or cannot be distinguished from others, and those refused before it.

        None instead of a candidate where none stands out, or too many that did were refused.
        """
        refused: list[Tried] = []
        while len(refused) < MOST_TRIALS:
            best = scores.best({t.best.candidate.label for t in refused})
            if best is None or scores.only_stands_in(best):
                break
            found = self._tried(best, scores, fitted, held_out, refused)
            found = replace(found, scores=scores.remembered)
            if isinstance(found, Undecided):
                return found, refused
            if not found.reason:
                return replace(found, confusable=confusable_with(scores.named, found.best)), refused
            refused.append(found)
        return None, refused

    def _tried(
        self, best: Scored, scores: CandidateScores, fitted: FittedStage, held_out: HeldOut, refused: Sequence[Tried]
    ) -> Tried | Undecided:
        """Fit a candidate along, and see whether it does on other rows what it promised on these.

        Undecided, and not fitted, where others explain as much; undecided, too, where look-alikes are first instead of
        it without some of the rows, and that is all that speaks against it.
        """
        rivals = rivals_of(scores.space, scores.named, best, {t.best.candidate.label for t in refused})
        known = next((s for s in (best, *rivals) if self.called_for.issuperset(s.candidate.terms)), None)
        if known is not None:
            best, rivals = known, []
        if rivals:
            return self._undecided(simplest_of(scores.named, best), rivals, scores, fitted, held_out)
        step = step_towards(fitted.estimate, best)
        if step is not None and step.falls and step.linear and best.assumed <= MOSTLY and self._plain(best):
            new = held_out_of(step.near, self.verification, self.floor, self.seed, self.block, self.folds)
            p_held_out = held_out.p_above(new, new.noise, self.seed)
            if p_held_out > RISES:  # one Gauss-Newton step towards it is the fit where nothing is curved
                return Tried(best, scores, fitted, [], new, p_held_out, 0.0, NO_FALL)
        # Scores only know shapes on a grid, so that which of several variants it is shows in their fits.
        variants: list[tuple[Scored, Step | None]] = [
            (s, step_towards(fitted.estimate, s)) for s in variants_of(scores.named, best)
        ]
        others = [(s, own) for s, own in variants if not _needless(s, own, best, step)]
        if known is None:
            others += self._not_linear(scores, fitted, best, step, refused)
        fits = [self._fitted_along(s, near, fitted, held_out) for s, near in ((best, step), *others)]
        return self._judged(fits, scores, held_out, {t.best.candidate.label for t in refused})

    def _undecided(
        self, best: Scored, rivals: Sequence[Scored], scores: CandidateScores, fitted: FittedStage, held_out: HeldOut
    ) -> Tried | Undecided:
        """Candidates that explain the same, if any of them lowers the error of rows that no fit has seen.

        What raises it is not missing, whatever else it looks like. That any of them does is asked at one rate, not
        shared out: look-alikes lower the same errors.
        """
        refusal: Tried | None = None
        for s in (best, *rivals):
            step = step_towards(fitted.estimate, s)
            if step is not None and step.falls and step.linear and s.assumed <= MOSTLY and self._plain(s):
                trial, kept = fitted, list[Term]()
                new = held_out_of(step.near, self.verification, self.floor, self.seed, self.block)
                p, falls = self._confirmed(held_out, new, s, fitted.estimate)
            else:  # one step is not the fit: only this decides
                _, trial, kept, new = self._fitted_along(s, step, fitted, held_out)
                p, falls = self._falls(s, trial.estimate, kept, held_out, new)
            if falls:
                return Undecided([best, *rivals], scores)
            refusal = refusal or Tried(s, scores, trial, kept, new, p, 0.0, NO_FALL)
        return refusal or Undecided([best, *rivals], scores)

    def _plain(self, s: Scored) -> bool:
        """Whether rows that are not fitted tell of it wherever they are."""
        effect = self.effects[s.candidate.name]
        return effect.event is None and effect.scanned is None

    def _confirmed(self, held_out: HeldOut, new: HeldOut, s: Scored, without: Estimate) -> tuple[float, bool]:
        """One-sided p of the fall of the held-out error, and whether it falls at all and that is no chance."""
        p = held_out.p_above(new, new.noise, self.seed)
        if self.verification is not None and p > 0.5 * HELD_OUT_RATE:
            p = either_p(p, cross_fitted_fall(without, s, self.seed).p)
        return p, p <= HELD_OUT_RATE and held_out.exceed(new)

    def _falls(
        self, best: Scored, trial: Estimate, kept: Sequence[Term], held_out: HeldOut, new: HeldOut
    ) -> tuple[float, bool]:
        """One-sided p of the fall of the held-out error, and whether that confirms a candidate.

        No other sweep tells of an event; other blocks of its own do. Of what shows within a few degrees of one joint a
        verification table may have no row; other visits there do, and it must not raise that table's error.

        A verification table of a few visits hardly tells a fall from chance that all the poses together make certain.
        Half of the rate is for it, half for the poses, a fifth of them predicted by the others at a time; the error of
        the table, which everybody reads, has to fall in any case.

        The errors as they are printed are to fall as well: whitened errors of a log see what is brief, and alone they
        would call missing what raises the error that everybody reads.

        What is told by a prior, such as a tool other than declared that the links' masses can stand for, need not lower
        an error that the model without it reaches, too; it must not raise it.
        """
        effect = self.effects[best.candidate.name]
        if effect.event is not None:
            p = event_p(trial, effect.name, self.seed)
            return p, p <= HELD_OUT_RATE
        if effect.scanned is not None:
            p = event_p(trial, effect.name, self.seed)
            return p, p <= HELD_OUT_RATE and new.p_above(held_out, new.noise, self.seed) > HELD_OUT_RATE
        p = held_out.p_above(new, new.noise, self.seed)
        if self.verification is not None and p > 0.5 * HELD_OUT_RATE:
            p = either_p(p, terms_p(trial, kept, self.seed))
        by_prior = best.assumed > MOSTLY and new.p_above(held_out, new.noise, self.seed) > HELD_OUT_RATE
        return p, (p <= HELD_OUT_RATE and held_out.exceed(new)) or by_prior

    def _judged(
        self, fits: Sequence[_Along], scores: CandidateScores, held_out: HeldOut, refused: Collection[str]
    ) -> Tried | Undecided:
        """What the fits of a candidate, the first, and of others that may be it instead say of rows not fitted.

        It has to be first of all names that no trial has ``refused`` without most parts of the rows; or nearly always
        of those that stand out of their null. Others explain more of these rows by chance, whatever is missing.
        """
        (best, trial, kept, new), level = self._likeliest([fit for fit in fits if fit.kept] or fits)
        p_held_out, falls = self._falls(best, trial.estimate, kept, held_out, new)
        if not kept:
            return Tried(best, scores, trial, kept, new, p_held_out, 0.0, IMPOSSIBLE)
        if falls and level:
            return Undecided([best, *(fit.scored for fit in level)], scores)
        others = [fit for fit in fits if not fit.scored.candidate.is_variant_of(best.candidate)]
        if not falls:
            again = stability(first_without_parts(scores.space, scores.named, scores.folds, self.seed), [best])
            return Tried(fits[0].scored, scores, trial, kept, new, p_held_out, again, NO_FALL)
        may_be = [best, *(fit.scored for fit in others)]  # which of these it is the fits have told
        on_trial = [s for s in scores.named if s.candidate.label not in refused]
        first = first_without_parts(scores.space, on_trial, scores.folds, self.seed)
        again = stability(first, may_be)
        if again < STABLE:
            alike = [s for s in first if same_effect(s, best) or canonical(best, s) > CONFUSABLE]
            if len(alike) >= STABLE * len(first):
                rest = {s.candidate.label: s for s in alike if not same_effect(s, best)}
                return Undecided([best, *rest.values()], scores)
            among = first_without_parts(scores.space, scores.standing_out(refused), scores.folds, self.seed)
            if stability(among, may_be) < OF_FEW:
                return Tried(fits[0].scored, scores, trial, kept, new, p_held_out, again, UNSTABLE)
        return Tried(best, scores, trial, kept, new, p_held_out, again, "")

    def _likeliest(self, fits: Sequence[_Along]) -> tuple[_Along, list[_Along]]:
        """The fit that rows not fitted speak for, and those of other effects that are neither worse nor less likely.

        Where the errors of rows not fitted are level, an effect that needs many more numbers for the same is no rival.
        """
        best = self._cause_first(fits)
        new, mine = best.held_out, best.scored.candidate
        others = [fit for fit in fits if not fit.scored.candidate.is_variant_of(mine)]
        level = [best, *(fit for fit in others if fit.held_out.p_above(new, new.noise, self.seed) > HELD_OUT_RATE)]
        if len(level) < 2:
            return best, []
        odds = bic_gap([(fit.fitted.estimate, fit.kept) for fit in level], new.noise)
        first = 0 if odds[0] <= SAME else int(np.argmin(odds))
        return level[first], [level[k] for k in np.flatnonzero(odds <= SAME) if k != first]

    def _cause_first(self, fits: Sequence[_Along]) -> _Along:
        """The fit with the least error on rows not fitted; of what only states an outcome, its cause where as good."""
        least = min(fits, key=lambda fit: fit.held_out.rms)
        causes = [fit for fit in fits if fit.scored.candidate.name in least.scored.candidate.describes]
        level = [
            c for c in causes if c.held_out.p_above(least.held_out, least.held_out.noise, self.seed) > HELD_OUT_RATE
        ]
        return min(level, key=lambda fit: fit.held_out.rms, default=least)

    def _not_linear(
        self, scores: CandidateScores, fitted: FittedStage, best: Scored, step: Step | None, refused: Sequence[Tried]
    ) -> list[tuple[Scored, Step]]:
        """Look-alikes of other families, where theirs or the best's score is not what they explain: fits tell then."""
        others = of_other_families(scores.named, best, {t.best.candidate.label for t in refused})
        steps = [(s, step_towards(fitted.estimate, s)) for s in others]
        straight = step is None or step.linear
        curved = [(s, own) for s, own in steps if own is not None and not (straight and own.linear)]
        return [(s, own) for s, own in curved if own.may_reach(step)]

    def _fitted_along(self, s: Scored, step: Step | None, fitted: FittedStage, held_out: HeldOut) -> _Along:
        """A candidate fitted along, without those of its places that do not pay.

        What clearly raises the error of rows that no fit has seen is refused as it is: which of its places would pay
        is not asked. They are candidates of their own.
        """
        # From none of it, a search would not know in which direction its shape is to go.
        start = step.near.values() if step is not None and step.falls else s.candidate.shapes
        trial = self.refit([*fitted.model.terms, *s.candidate.terms], fitted, start)
        if len(s.candidate.terms) > 1 and self._plain(s):
            whole = self.held_out(trial)
            if not held_out.exceed(whole) and whole.p_above(held_out, whole.noise, self.seed) <= HELD_OUT_RATE:
                return _Along(s, trial, list(s.candidate.terms), whole)
        trial, kept = pruned(trial, s.candidate.terms, fitted.model.terms, self.refit)
        return _Along(s, trial, kept, self.held_out(trial))

    def confirm_given_ambiguity(
        self, undecided: Undecided, fitted: FittedStage, held_out: HeldOut, number: int
    ) -> tuple[Tried | None, list[Undecided], list[Tried]]:
        """What is missing whichever of some candidates, that these rows cannot distinguish, is the true one.

        The first of them is fitted along and the others are granted to the model, so that what any of them could
        explain is not evidence. To fit them all along a valley, in which one grows as another falls, takes long and
        brings nothing. What is confirmed beside them is fitted without them.

        Parameters
        ----------
        held_out
            Errors of the fit without any of them.

        Returns
        -------
        found, groups, refused
            What is confirmed beside them, and no group; else none, these and further candidates that cannot be told
            apart, and what lowers the error only beside them.
        """
        groups, whole = [undecided], fitted
        while len(groups) < GROUPS:
            whole, scores = self._along(groups, fitted, whole, number)
            found, _ = self.decided(scores, whole, self.held_out(whole))
            if isinstance(found, Tried):
                alone = self._fitted_with(found, fitted, held_out)
                return (None, [undecided], [alone]) if alone.reason else (alone, [], [])
            if found is None:
                break
            groups.append(found)
        return None, groups, []

    def _along(
        self, groups: Sequence[Undecided], fitted: FittedStage, last: FittedStage, number: int
    ) -> tuple[FittedStage, CandidateScores]:
        """The first of each group fitted along, from the ``last`` fit, and the scores on what is then left."""
        whole, granted = self.with_undecided(groups, fitted, last)
        return whole, self.scores(whole, 2 * number - 1, granted)

    def with_undecided(
        self, groups: Sequence[Undecided], fitted: FittedStage, last: FittedStage
    ) -> tuple[FittedStage, list[Candidate]]:
        """The first of each group fitted along, from the ``last`` fit, and the others that are linear, not fitted."""
        members = [s.candidate for group in groups for s in group.members]
        firsts = {group.members[0].candidate.label for group in groups}
        granted = [c for c in members if c.label not in firsts and self._linear(c)]
        fitted_too = [c for c in members if c not in granted]
        terms = dict.fromkeys(term for c in fitted_too for term in c.terms)
        shapes = {slot: value for c in reversed(fitted_too) for slot, value in c.shapes.items()}
        step = step_towards(last.estimate, groups[-1].members[0])
        near = step.near.values() if step is not None and step.falls else last.model.values()
        return self.refit([*fitted.model.terms, *terms], last, {**shapes, **near}), granted

    def taken(self, undecided: Undecided, fitted: FittedStage, held_out: HeldOut, after: int) -> Taken:
        """The first of some candidates fitted along, where it makes no difference which of them it is."""
        group = undecided.taken(self.effects)
        whole, _ = self.with_undecided([group], fitted, fitted)
        return Taken(group, fitted, held_out, whole, self.held_out(whole), after)

    def _linear(self, candidate: Candidate) -> bool:
        """Whether its columns say all of it: no prior limits its amplitudes, and it is no event."""
        return candidate.prior is None and self.effects[candidate.name].event is None

    def _fitted_with(self, tried: Tried, fitted: FittedStage, held_out: HeldOut) -> Tried:
        """What was confirmed beside undecided candidates, fitted without them; refused if it brings nothing alone."""
        shapes = {k: v for k, v in tried.fitted.model.values().items() if k in tried.best.candidate.shapes}
        alone = self.refit([*fitted.model.terms, *tried.kept], fitted, shapes)
        new = self.held_out(alone)
        lowers = held_out.exceed(new) or not self._plain(tried.best)  # rows not fitted tell nothing of what is local
        return replace(tried, fitted=alone, held_out=new, reason="" if lowers else ONLY_BESIDE)


def _needless(s: Scored, own: Step | None, best: Scored, step: Step | None) -> bool:
    """Whether a variant has more numbers than the best and does not pay for them, and its score says all of it.

    Fitted, it would leave less of these rows, and of others half the time by chance.
    """
    scores_decide = all(
        one.candidate.prior is None and not one.candidate.shapes and near is not None and near.linear
        for one, near in ((s, own), (best, step))
    )
    return scores_decide and s.freedom > best.freedom and s.bic < best.bic
