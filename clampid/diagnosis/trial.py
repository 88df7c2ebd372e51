"""A candidate on trial: its fall of the held-out error, and the places that BIC justifies."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from clampid.diagnosis.candidate_scores import (
    CONFUSABLE,
    CandidateScores,
    Wandering,
    of_other_families,
    rivals_of,
    simplest_of,
    variants_of,
)
from clampid.diagnosis.confirm import first_without_parts, same_effect, stability
from clampid.diagnosis.entries import confusable_with
from clampid.diagnosis.falls import MOSTLY, FallTest, tested_everywhere
from clampid.diagnosis.folds import Folds
from clampid.diagnosis.held_out import HELD_OUT_RATE, HeldOut, held_out_of
from clampid.diagnosis.impossible import impossible_values
from clampid.diagnosis.linear_refit import Step, at_fit, is_costlier, linear_refit, step_towards
from clampid.diagnosis.next_measurement import SAME
from clampid.diagnosis.pruning import Refit, bic_gap, pruned
from clampid.diagnosis.scoring import probed_beside_what_stands_out, scores_of
from clampid.diagnosis.tried import Along, GivenAmbiguity, Left, Taken, Tried, Undecided
from clampid.effect import Effect, Stage
from clampid.evidence.candidates import Candidate
from clampid.evidence.score import Scored, canonical
from clampid.fitting.accuracy import Floor
from clampid.fitting.solve import Estimate
from clampid.fitting.wander import Level, larger
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
ROUND_SHARE = 0.15  # of the work left that a part of a round takes: the number of rounds is unknown


@dataclass(frozen=True)
class Bench:
    """Inputs of every trial of a stage.

    Attributes
    ----------
    refit
        Fits the stage with other terms, from an earlier fit's values and given start values.
    verification
        Rows of a table that no fit sees, where there is one.
    floor
        The noise floor.
    block
        How many consecutive visits of poses the tests flip together.
    called_for
        Effects that other rows of this arm have shown: among indistinguishable candidates they are preferred.
    folds
        Parts of runs to hold out instead of whole folds.
    elsewhere
        Other stages of which there are rows.
    wander
        By how much readings are known to wander at least; None if they are not.
    seen
        Terms and granted candidates → how the readings wander beside that fit: poses may be searched twice.
    on_its_rows
        A fit of all rows that count for the effects of another; that one itself, if it has these rows.
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
    wander: Level | None = None
    seen: dict[tuple[object, ...], Wandering | None] = field(default_factory=dict)
    on_its_rows: Callable[[FittedStage], FittedStage] = lambda fitted: fitted

    @substep("scoring the candidates", ROUND_SHARE)
    def scores(self, fitted: FittedStage, number: int, granted: Sequence[Candidate] = ()) -> CandidateScores:
        """The scores on a fit's residual, with its own stream of flips."""
        fit, seed = (tuple(fitted.model.terms), *(c.label for c in granted)), self.seed + number
        seen = self.seen.get(fit) if fitted.estimate.problem.kind.points else None
        found = scores_of(fitted.estimate, self.effects, self.flips, seed, granted, self.block, self.wander, seen)
        self.seen[fit] = found.wandering
        return self.in_its_folds(found, fitted)

    def in_its_folds(self, scores: CandidateScores, fitted: FittedStage) -> CandidateScores:
        """The scores, with the parts of runs that are held out, if any are, instead of their own folds."""
        return scores if self.folds is None else replace(scores, folds=self.folds.fold[fitted.estimate.whitened.entry])

    def beside_what_stands_out(self, left: Left) -> Left:
        """What a fit leaves, its probes judged by the noise beside what stands out."""
        found = probed_beside_what_stands_out(*left[:2], self.flips, self.seed, left.granted, self.block)
        return left._replace(estimate=found[0], scores=found[1])

    def held_out(self, fitted: FittedStage) -> HeldOut:
        """A fit's held-out errors."""
        return self._held_out(fitted.estimate)

    def _held_out(self, estimate: Estimate) -> HeldOut:
        """An estimate's held-out errors, all of a search on the same parts."""
        return held_out_of(estimate, self.verification, self.floor, self.seed, self.block, self.folds)

    def alone(self, fitted: FittedStage, s: Scored) -> float | None:
        """Held-out rms that a candidate would reach, in the stage's unit, estimated without a fit."""
        estimate = linear_refit(fitted.estimate, at_fit(fitted.estimate, s))
        if estimate is None:
            return None
        return self._held_out(estimate).rms

    @substep("trying the best candidates", ROUND_SHARE)
    def decided(
        self, scores: CandidateScores, fitted: FittedStage, held_out: HeldOut, earlier: dict[str, Tried]
    ) -> tuple[Tried | Undecided | None, list[Tried]]:
        """The first candidate that is confirmed, or cannot be distinguished from others, and those refused before it.

        None instead of a candidate if none is significant, or too many significant ones were refused.

        Parameters
        ----------
        earlier
            Candidates that did not lower the held-out error of earlier fits, by label; those of this fit are added.
        """
        refused: list[Tried] = []
        while len(refused) < MOST_TRIALS:
            best = scores.best({t.best.candidate.label for t in refused})
            if best is None or scores.only_stands_in(best):
                break
            label = best.candidate.label
            if label in earlier and earlier[label].holds_for(best):
                refused.append(replace(earlier[label], best=best, scores=scores.remembered))
                continue
            found = self._tried(best, scores, fitted, held_out, refused)
            found = replace(found, scores=scores.remembered)
            if isinstance(found, Undecided):
                return found, refused
            found = replace(found, before=held_out.rms)
            if not found.reason:
                return replace(found, confusable=confusable_with(scores.named, found.best)), refused
            refused.append(found)
            if found.reason == NO_FALL:
                earlier[label] = replace(found, fitted=fitted, kept=[]).remembered  # its fit is as large as its rows
        return None, refused

    def _tried(
        self, best: Scored, scores: CandidateScores, fitted: FittedStage, held_out: HeldOut, refused: Sequence[Tried]
    ) -> Tried | Undecided:
        """Fit the model with a candidate, and test whether the held-out error falls as the score predicts.

        Undecided, without a fit, if others explain as much. Also undecided if the only objection is that
        indistinguishable candidates are first in some parts of the rows.
        """
        without = {t.best.candidate.label for t in refused}
        rivals = rivals_of(scores.space, scores.named, best, without)
        known = next((s for s in (best, *rivals) if self.called_for.issuperset(s.candidate.terms)), None)
        if known is not None:
            best, rivals = known, []
        if rivals:
            simplest = simplest_of(scores.named, best)
            if simplest is not best:
                rivals = rivals_of(scores.space, scores.named, simplest, without) or rivals
            return self._undecided(simplest, rivals, scores, fitted, held_out)
        step = _step(best, scores, fitted)
        if step is not None and step.falls and step.linear and best.assumed <= MOSTLY and self._plain(best):
            new = self._held_out(step.near)
            p_held_out = held_out.p_above(new, new.noise, self.seed)
            if p_held_out > RISES:  # one Gauss-Newton step towards it is the fit where nothing is curved
                return Tried(best, scores, fitted, [], new, p_held_out, 0.0, NO_FALL)
        # Scores only know shapes on a grid, so that which of several variants it is shows in their fits.
        variants: list[tuple[Scored, Step | None]] = [
            (s, _step(s, scores, fitted)) for s in variants_of(scores.named, best)
        ]
        others = [(s, own) for s, own in variants if not is_costlier(s, own, best, step)]
        if known is None:
            others += self._not_linear(scores, fitted, best, step, refused)
        fits = [self._fitted_along(s, near, fitted, held_out) for s, near in ((best, step), *others)]
        labels = {t.best.candidate.label for t in refused}
        if known is None and self._cause_first(fits).impossible:
            alike = [(s, _step(s, scores, fitted)) for s in scores.like(best, labels)]
            fits += [self._fitted_along(s, near, fitted, held_out) for s, near in alike]
        return self._judged(fits, scores, held_out, labels)

    def _undecided(
        self, best: Scored, rivals: Sequence[Scored], scores: CandidateScores, fitted: FittedStage, held_out: HeldOut
    ) -> Tried | Undecided:
        """Candidates that explain the same, if any of them lowers the held-out error.

        An effect that raises it is not missing. The false-alarm rate is not divided among them, because they lower the
        same errors.
        """
        refusal: Tried | None = None
        for s in (best, *rivals):
            step = _step(s, scores, fitted)
            if step is not None and step.falls and step.linear and s.assumed <= MOSTLY and self._plain(s):
                trial, kept = fitted, list[Term]()
                new = self._held_out(step.near)
                p, falls = self.falls(scores).of_step(held_out, new, s, fitted.estimate)
            else:  # one step is not the fit: only this decides
                _, trial, kept, new, _ = along = self._fitted_along(s, step, fitted, held_out)
                p, falls = self._fall(along, scores, held_out)
            if falls:
                return Undecided([best, *rivals], scores)
            refusal = refusal or Tried(s, scores, trial, kept, new, p, 0.0, NO_FALL)
        return refusal or Undecided([best, *rivals], scores)

    def _plain(self, s: Scored) -> bool:
        """Whether all held-out rows test it, wherever they are."""
        return tested_everywhere(self.effects[s.candidate.name])

    def falls(self, scores: CandidateScores) -> FallTest:
        """The test of a fall of the held-out error beside the noise of these scores."""
        return FallTest(self.effects, self.verification, self.seed, scores.wander, scores.noise_of_fit)

    def _fall(self, along: Along, scores: CandidateScores, held_out: HeldOut) -> tuple[float, bool]:
        """As :meth:`clampid.diagnosis.falls.FallTest.of_fit`."""
        best, trial, kept, new, _ = along
        return self.falls(scores).of_fit(best, trial.estimate, kept, held_out, new)

    def _judged(
        self, fits: Sequence[Along], scores: CandidateScores, held_out: HeldOut, refused: Collection[str]
    ) -> Tried | Undecided:
        """The decision on a candidate, the first, and its alternatives from their fits and held-out errors.

        The candidate must be the best of all names, except those ``refused`` by a trial, without most parts of the
        rows; or the best of the significant names without nearly all parts. Other names may explain more by chance.
        What needs an impossible value, as of a spring, gives way to what lowers the error without.
        """
        able = [fit for fit in fits if fit.kept] or list(fits)
        if any(fit.impossible for fit in able):
            able = [fit for fit in able if not fit.impossible and self._fall(fit, scores, held_out)[1]] or able
        chosen, level = self._likeliest(able)
        (best, trial, kept, new, _), (p_held_out, falls) = chosen, self._fall(chosen, scores, held_out)
        if not kept:
            return Tried(best, scores, trial, kept, new, p_held_out, 0.0, IMPOSSIBLE)
        if falls and level:
            return Undecided([best, *(fit.scored for fit in level)], scores)
        others = [fit for fit in fits if not fit.scored.candidate.is_variant_of(best.candidate)]
        if not falls:
            again = stability(first_without_parts(scores.space, scores.named, scores.folds, self.seed), [best])
            return Tried(fits[0].scored, scores, trial, kept, new, p_held_out, again, NO_FALL)
        may_be = [best, *(fit.scored for fit in others)]  # the fits have decided between these
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

    def _likeliest(self, fits: Sequence[Along]) -> tuple[Along, list[Along]]:
        """The fit with the best held-out error, and fits of other effects that are neither worse nor less likely.

        At equal held-out errors an effect that needs many more parameters is no rival.
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

    def _cause_first(self, fits: Sequence[Along]) -> Along:
        """The fit with the least held-out error; instead of a symptom its cause, if that is as good."""
        least = min(fits, key=lambda fit: fit.held_out.rms)
        causes = [fit for fit in fits if fit.scored.candidate.name in least.scored.candidate.describes]
        level = [
            c for c in causes if c.held_out.p_above(least.held_out, least.held_out.noise, self.seed) > HELD_OUT_RATE
        ]
        return min(level, key=lambda fit: fit.held_out.rms, default=least)

    def _not_linear(
        self, scores: CandidateScores, fitted: FittedStage, best: Scored, step: Step | None, refused: Sequence[Tried]
    ) -> list[tuple[Scored, Step]]:
        """Correlated candidates of other families if their score, or that of the best, is unreliable: fits decide."""
        others = of_other_families(scores.named, best, {t.best.candidate.label for t in refused})
        steps = [(s, _step(s, scores, fitted)) for s in others]
        straight = step is None or step.linear
        curved = [(s, own) for s, own in steps if own is not None and not (straight and own.linear)]
        return [(s, own) for s, own in curved if own.may_reach(step)]

    def _fitted_along(self, s: Scored, step: Step | None, fitted: FittedStage, held_out: HeldOut) -> Along:
        """The fit with a candidate, without those of its places that BIC does not justify.

        A candidate that significantly raises the held-out error is refused as a whole; its places are not selected,
        because each is a candidate too.
        """
        # From none of it, a search would not know in which direction its shape is to go.
        start = step.near.values() if step is not None and step.falls else s.candidate.shapes
        trial = self.refit([*fitted.model.terms, *s.candidate.terms], fitted, start)
        if len(s.candidate.terms) > 1 and self._plain(s):
            whole = self.held_out(trial)
            if not held_out.exceed(whole) and whole.p_above(held_out, whole.noise, self.seed) <= HELD_OUT_RATE:
                return Along(s, trial, list(s.candidate.terms), whole, impossible=False)
        trial, kept = pruned(trial, s.candidate.terms, fitted.model.terms, self.refit)
        impossible = not impossible_values(trial.estimate) <= impossible_values(fitted.estimate)
        return Along(s, trial, kept, self.held_out(trial), impossible)

    def confirm_given_ambiguity(
        self,
        undecided: Undecided,
        fitted: FittedStage,
        held_out: HeldOut,
        number: int,
        earlier: dict[str, Tried],
    ) -> GivenAmbiguity:
        """Effects that are missing whichever of some indistinguishable candidates is the true one.

        The first of them is fitted and the others are granted to the model, so that errors which any of them could
        explain are not evidence. Fitting all of them would be slow, along a valley of the cost, without a gain. Effects
        confirmed in this way are then fitted without the candidates. A variant of one of them would decide for it.

        Parameters
        ----------
        held_out
            Errors of the fit without any of them.
        earlier
            As of :meth:`decided`.
        """
        groups, whole = [undecided], fitted
        wander: Level | None = None
        while len(groups) < GROUPS:
            whole, granted = self.with_undecided(groups, fitted, whole)
            scores = self.scores(whole, 2 * number - 1, granted)
            wander = larger(wander, scores.wander)
            left = Left(whole.estimate, scores, self.held_out(whole), granted)
            found, _ = self.decided(scores, whole, left.held_out, earlier)
            if found is None:
                return GivenAmbiguity(None, groups, [], left, wander)
            if isinstance(found, Tried):
                if any(group.refined_by(found.best.candidate) for group in groups):
                    break
                alone = self._fitted_with(found, fitted, held_out)
                found, refused = (None, [alone]) if alone.reason else (alone, [])
                return GivenAmbiguity(found, [undecided] if refused else [], refused, None, wander)
            groups.append(found)
        return GivenAmbiguity(None, groups, [], None, wander)

    def with_undecided(
        self, groups: Sequence[Undecided], fitted: FittedStage, last: FittedStage
    ) -> tuple[FittedStage, list[Candidate]]:
        """The fit with the first of each group, from the ``last`` fit, and the other linear ones, not fitted."""
        members = [s.candidate for group in groups for s in group.members]
        firsts = {group.members[0].candidate.label for group in groups}
        granted = [c for c in members if c.label not in firsts and self._linear(c)]
        fitted_too = [c for c in members if c not in granted]
        terms = dict.fromkeys(term for c in fitted_too for term in c.terms)
        shapes = {slot: value for c in reversed(fitted_too) for slot, value in c.shapes.items()}
        step = step_towards(last.estimate, at_fit(last.estimate, groups[-1].members[0]))
        near = step.near.values() if step is not None and step.falls else last.model.values()
        return self.refit([*fitted.model.terms, *terms], last, {**shapes, **near}), granted

    def taken(self, undecided: Undecided, fitted: FittedStage, held_out: HeldOut, after: int) -> Taken:
        """The fit with the first of some candidates whose predictions are the same everywhere."""
        group = undecided.taken(self.effects)
        whole, _ = self.with_undecided([group], fitted, fitted)
        return Taken(group, fitted, held_out, whole, self.held_out(whole), after)

    def _linear(self, candidate: Candidate) -> bool:
        """Whether its columns describe it completely: its amplitudes have no own prior, and it is no event."""
        return candidate.prior is None and self.effects[candidate.name].event is None

    def _fitted_with(self, tried: Tried, fitted: FittedStage, held_out: HeldOut) -> Tried:
        """An effect confirmed together with undecided candidates, fitted without them; refused if no help alone."""
        shapes = {k: v for k, v in tried.fitted.model.values().items() if k in tried.best.candidate.shapes}
        alone = self.refit([*fitted.model.terms, *tried.kept], fitted, shapes)
        new = self.held_out(alone)
        lowers = held_out.exceed(new) or not self._plain(tried.best)  # held-out rows may not test a local effect
        return replace(tried, fitted=alone, held_out=new, before=held_out.rms, reason="" if lowers else ONLY_BESIDE)


def _step(s: Scored, scores: CandidateScores, fitted: FittedStage) -> Step | None:
    """A step towards a candidate, whose columns are whitened as the fit is and not as the scores are."""
    return step_towards(fitted.estimate, s if scores.noise_of_fit else at_fit(fitted.estimate, s))
