"""Outcomes of a trial: one candidate with its fit, several that the rows cannot distinguish, or one of those taken."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from clampid.diagnosis.candidate_scores import ALIASED, CandidateScores
from clampid.diagnosis.entries import entry_of
from clampid.diagnosis.held_out import HeldOut
from clampid.effect import Effect, Stage
from clampid.evidence.candidates import Candidate
from clampid.evidence.score import Scored, canonical, explained_together
from clampid.fitting.solve import Estimate
from clampid.fitting.wander import Level
from clampid.identification.fitted_stage import FittedStage
from clampid.slots import Term
from clampid.stages.stage_kind import acts_with, stages_with

__all__ = ["Along", "GivenAmbiguity", "Left", "Taken", "Tried", "Undecided"]

ONE = 1.0  # what chance explains by one number, in units of the residual's variance


class Along(NamedTuple):
    """A candidate, its fit from the step towards it, the terms that BIC justifies, and its held-out errors.

    ``impossible``: whether the fit has an impossible value that the fit without the candidate does not have.
    """

    scored: Scored
    fitted: FittedStage
    kept: list[Term]
    held_out: HeldOut
    impossible: bool


@dataclass(frozen=True)
class Tried:
    """A candidate with its fit and its held-out errors.

    Attributes
    ----------
    before
        The held-out rms without it, in the stage's unit.
    reason
        Why it is refused; empty if it is not.
    confusable
        If it is not refused, other effects that are most correlated with it, as the contract lists them.
    """

    best: Scored
    scores: CandidateScores
    fitted: FittedStage
    kept: list[Term]
    held_out: HeldOut
    p_held_out: float
    stability: float
    reason: str
    before: float = math.nan
    confusable: list[dict[str, Any]] = field(default_factory=list)

    def entry(self, effects: dict[str, Effect], before: float, estimate: Estimate) -> dict[str, Any]:
        """As the contract lists it, the held-out rms without it given, and the fit that has its parameters."""
        null, after = self.scores.named_null, self.held_out.rms
        return {
            **entry_of(self.best, null, effects, (before, after), estimate, self.kept),
            "stability": self.stability,
            "p_held_out": self.p_held_out,
            "confusable_with": self.confusable,
        }

    def holds_for(self, again: Scored) -> bool:
        """Whether the held-out error need not be asked again: the rows say no more for it than when it was refused.

        Its amplitudes, in their standard errors, are longer by less than one of these.
        """
        return math.sqrt(max(again.explained, 0.0)) <= math.sqrt(max(self.best.explained, 0.0)) + ONE

    @property
    def remembered(self) -> Tried:
        """The same without the columns of its candidate, which are as long as the rows."""
        return replace(self, best=replace(self.best, candidate=self.best.candidate.remembered))

    def refusal(self, effects: dict[str, Effect], reason: str = "") -> dict[str, Any]:
        """The same of one that is refused, with its reason or another; its parameters are the score's."""
        scale = self.scores.space.scale
        entry = entry_of(self.best, self.scores.named_null, effects, (self.before, self.held_out.rms), scale=scale)
        outcome = {"stability": self.stability, "p_held_out": self.p_held_out, "reason": reason or self.reason}
        return {**entry, **outcome}


@dataclass(frozen=True)
class Undecided:
    """Candidates that the rows cannot distinguish, the best first, and the scores that found them."""

    members: list[Scored]
    scores: CandidateScores

    def alike(self, effects: Mapping[str, Effect], elsewhere: Collection[Stage]) -> bool:
        """Whether their predictions are the same everywhere: they explain the same, and no other stage reads them."""
        first, *others = self.members
        for s in others:
            both = explained_together(self.scores.space, first, s)
            if canonical(first, s) <= ALIASED or both - min(first.explained, s.explained) > ONE:
                return False
        return not any(set(elsewhere) & set(stages_with(effects[s.candidate.name])) for s in self.members)

    def refined_by(self, candidate: Candidate) -> bool:
        """Whether another candidate is a variant of one of them at its places, as higher harmonics of a ripple are."""
        return any(candidate.is_variant_of(s.candidate) for s in self.members)

    def taken(self, effects: Mapping[str, Effect]) -> Undecided:
        """The same, with one that does not act in poses first, if there is any: torques should not move the flange."""
        order = sorted(self.members, key=lambda s: acts_with(effects[s.candidate.name], "points"))
        return replace(self, members=order)


class Taken(NamedTuple):
    """Undecided candidates with the same predictions everywhere, of which a model has the first.

    ``base`` and ``before``: the model and its held-out errors without it; ``after``: number of steps before it.
    """

    group: Undecided
    base: FittedStage
    before: HeldOut
    fitted: FittedStage
    held_out: HeldOut
    after: int


class Left(NamedTuple):
    """What a fit leaves: scores of its residual, its held-out errors, and the candidates that were granted to it."""

    estimate: Estimate
    scores: CandidateScores
    held_out: HeldOut
    granted: Sequence[Candidate] = ()


class GivenAmbiguity(NamedTuple):
    """Effects that are missing whichever of some indistinguishable candidates is the true one.

    Attributes
    ----------
    found, groups, refused
        The confirmed effect, and no group; or None, the groups of indistinguishable candidates, and effects that lower
        the error only together with them.
    rest
        What the fit with one of each group leaves, the others granted; None where an effect was found, or no more
        groups were looked for.
    wander
        By how much readings wander with the candidates in the model (:mod:`clampid.diagnosis.wandering`); None if not.
    """

    found: Tried | None
    groups: list[Undecided]
    refused: list[Tried]
    rest: Left | None
    wander: Level | None
