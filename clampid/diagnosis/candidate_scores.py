"""The scores of effects and of probes on a fit's residual: which stand out, and which explain the same as another."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from scipy import stats

from clampid.diagnosis.next_measurement import SAME
from clampid.effect import EffectError
from clampid.evidence.candidates import Candidate
from clampid.evidence.flips import Flips
from clampid.evidence.score import Scored, canonical, explained_together, followed
from clampid.evidence.space import Space
from clampid.fitting.wander import Level
from clampid.stages.rows import Integers

__all__ = [
    "ABLE",
    "ALIASED",
    "CONFUSABLE",
    "DICTIONARY_FALSE_ALARMS",
    "FEWEST_FLIPS",
    "IMPOSSIBLE",
    "CandidateScores",
    "Wandering",
    "best_of",
    "of_other_families",
    "refuse_few_flips",
    "rivals_of",
    "simplest_of",
    "standing_out_of",
    "variants_of",
]

# Of each dictionary: with names and probes 2 % a stage, below the 3 % that are promised.
DICTIONARY_FALSE_ALARMS = 0.01
CONFUSABLE = 0.8  # squared canonical correlation above which both are named: apart they are a fifth of what either is
SHARED = 0.5  # above which they have more in common than not, so that one may be taken for the other if not linear
ALIASED = 0.999  # above which they are one
STANDS_IN = 0.9  # of what the best probe explains, less than this may be another effect's share
IMPOSSIBLE = 100.0  # reasonable sizes; no effect has as many
VERY_STRONG = 10.0  # twice the log of the odds: evidence against a further number (Kass and Raftery, 1995)
# Names whose evidence differs by less are taken in the order of the dictionary, not as rounding says.
SAME_EVIDENCE = 1e-3
BY_CHANCE = 0.01
MOST_RIVALS = 4  # of a candidate, that are named or fitted beside it
ABLE = ("testable", "weak")


FEWEST_FLIPS = math.ceil(1.0 / DICTIONARY_FALSE_ALARMS) - 1
"""With fewer, the least p that they can give is above the level, and nothing is ever found to be missing."""


def refuse_few_flips(flips: int) -> None:
    """Refuse fewer sign flips than the level of the test needs.

    Raises
    ------
    EffectError
        With the number that would do.
    """
    if flips < FEWEST_FLIPS:
        raise EffectError(
            f"flips: expected at least {FEWEST_FLIPS}, found {flips}: with so few, p cannot fall below 1/{flips + 1}, "
            f"and the test's level is {DICTIONARY_FALSE_ALARMS:g}, so that no effect could be confirmed"
        )


class Wandering(NamedTuple):
    """What is known of a fit whose readings wander.

    ``level``: by how much. ``shown``: labels of the names that the fit does not absorb, by noise that does not wander.
    What it absorbs, but for rounding and for noise in its columns (a scale, of measured positions), it absorbs.
    """

    level: Level
    shown: frozenset[str]


@dataclass(frozen=True)
class CandidateScores:
    """The scores of both dictionaries on a fit's residual, with their null distributions.

    ``wandering``: how the noise that they are judged by wanders (:mod:`clampid.diagnosis.wandering`); None if it does
    not. ``noise_of_fit``: whether this noise is that by which the fit is weighted.
    """

    space: Space
    named: list[Scored]
    free: list[Scored]
    named_null: Flips
    free_null: Flips
    probe: Scored | None
    folds: Integers
    wandering: Wandering | None = None
    noise_of_fit: bool = True

    @property
    def wander(self) -> Level | None:
        """By how much readings wander; None if they do not."""
        return None if self.wandering is None else self.wandering.level

    def best(self, rejected: Collection[str] = ()) -> Scored | None:
        """The best significant name, except those whose labels are rejected; None if there is none."""
        best = best_of([s for s in self.named if s.candidate.label not in rejected], self.named_null)
        return (
            best if best is not None and self.named_null.p_familywise(best.log_p) <= DICTIONARY_FALSE_ALARMS else None
        )

    def standing_out(self, rejected: Collection[str] = ()) -> list[Scored]:
        """All significant names whose BIC justifies their parameters, except those whose labels are rejected."""
        return [s for s in standing_out_of(self.named, self.named_null) if s.candidate.label not in rejected]

    def like(self, best: Scored, rejected: Collection[str]) -> list[Scored]:
        """The best other significant names that have much in common with ``best``, and explain nearly as much."""
        much = [s for s in self.standing_out(rejected) if s.explained >= STANDS_IN * best.explained]
        apart = [s for s in much if not set(s.candidate.terms) & set(best.candidate.terms)]
        found = [s for s in apart if not s.candidate.is_variant_of(best.candidate) and canonical(best, s) > SHARED]
        return sorted(found, key=lambda s: -s.bic)[:MOST_RIVALS]

    @property
    def clearest(self) -> list[list[Scored]]:
        """What explains most: the best significant name, and the best significant probes of all readings.

        A probe of one motor's torque explains no other motor's, so of each motor the best one counts.
        """
        named, probe = self.best(), self.probe if self.fires else None
        probes = [] if probe is None else [probe]
        explained = {channel for s in probes for channel in s.candidate.columns.channels}
        for s in sorted(standing_out_of(self.free, self.free_null), key=lambda s: -s.bic):
            if explained.isdisjoint(s.candidate.columns.channels):
                probes.append(s)
                explained.update(s.candidate.columns.channels)
        return [found for found in ([] if named is None else [named], probes) if found]

    def seen_by(self, probe: Scored) -> CandidateScores:
        """The same with another probe as the one whose variables a verdict names."""
        return replace(self, probe=probe)

    @property
    def remembered(self) -> CandidateScores:
        """The part that a verdict needs later, without arrays of the size of the rows."""
        named = [replace(s, candidate=s.candidate.remembered) for s in self.named]
        space, folds = self.space.remembered, self.folds[:0].copy()
        return replace(self, space=space, named=named, free=[], folds=folds)

    @property
    def fires(self) -> bool:
        """Whether the best probe is significant."""
        return self.probe is not None and self.free_null.p_familywise(self.probe.log_p) <= DICTIONARY_FALSE_ALARMS

    def only_stands_in(self, best: Scored) -> bool:
        """Whether a name only absorbs a part of another error, which a probe describes better.

        It explains much less than the probe, and nothing once the probe is in the model. (With errors of several
        joints a name may explain one and the probe another; and a flexible probe may explain much of two effects that
        need two names.) Or the name can follow nearly any error, and the probe is a simple one.
        """
        if not self.fires or self.probe is None or self.probe.bic - best.bic <= SAME:
            return False
        if best.candidate.sized_by is not None and self.probe.candidate.prior is None:
            return True
        less = best.explained < STANDS_IN * self.probe.explained
        if not less or explained_together(self.space, best, self.probe) - self.probe.explained >= SAME:
            return False
        return not any(
            explained_together(self.space, best, s) - best.cost - s.cost >= self.probe.bic - SAME
            for s in self.named
            if s is not best and s.freedom and s.state in ABLE and s.bic > 0 and s.candidate.prior is None
        )


def best_of(scored: Sequence[Scored], null: Flips) -> Scored | None:
    """The first significant candidate whose BIC justifies its parameters; if there is none, the first of all.

    The noise of some rows is larger than the score assumes. A candidate that acts there explains much by chance, as its
    own sign flips show, and must not precede a significant one.
    """
    able = [s for s in scored if s.freedom and s.state in ABLE]
    chosen = standing_out_of(able, null) or able
    most = max((s.bic for s in chosen), default=0.0)
    return next((s for s in chosen if s.bic >= most - SAME_EVIDENCE), None)


def standing_out_of(scored: Sequence[Scored], null: Flips) -> list[Scored]:
    """The significant ones of some scores whose BIC justifies their parameters."""
    able = [s for s in scored if s.freedom and s.state in ABLE]
    return [s for s in able if s.bic > 0 and null.p_familywise(s.log_p) <= DICTIONARY_FALSE_ALARMS]


def rivals_of(space: Space, named: Sequence[Scored], best: Scored, rejected: Collection[str]) -> list[Scored]:
    """Other effects, or the same at other places, that explain the residual as well as the best one."""
    found: dict[tuple[str, tuple[str, ...]], Scored] = {}
    behind: list[Scored] = []
    mine, there = set(best.candidate.terms), set(best.candidate.places)
    for other in sorted(named, key=lambda s: -s.bic):
        theirs = set(other.candidate.terms)
        if (
            other is best
            or other.state not in ABLE
            or theirs <= mine
            or mine <= theirs
            or other.candidate.label in rejected
        ):
            continue
        overlaps = other.candidate.family == best.candidate.family and there & set(other.candidate.places)
        if overlaps or other.candidate.is_variant_of(best.candidate):
            continue  # one effect there, whichever of its variants and wherever else, is one verdict
        if other.explained < best.explained - SAME - other.freedom:
            continue
        if other.bic < best.bic - SAME:
            continue  # what needs more numbers explains what the simpler one does, and is no rival for it
        if canonical(best, other) <= CONFUSABLE or explained_together(space, best, other) - other.explained >= SAME:
            continue
        if other.freedom > best.freedom and other.bic < best.bic - VERY_STRONG:
            behind.append(other)
        else:
            found.setdefault((other.candidate.family, other.candidate.places), other)
    # What has more numbers and is so far behind is no rival either, but for what gives the same by the rows as the best
    # one or a rival of it: they say nothing against its numbers. Of a family only its simplest variant may be one:
    # further numbers imitate anything.
    for other in behind:
        if _has_simpler_variant(named, other):
            continue
        if any(followed(one, other) > ALIASED for one in (best, *found.values())):
            found.setdefault((other.candidate.family, other.candidate.places), other)
    kept = [
        s for s in found.values() if not any(set(o.candidate.terms) < set(s.candidate.terms) for o in found.values())
    ]
    return kept[:MOST_RIVALS]


def _has_simpler_variant(named: Sequence[Scored], s: Scored) -> bool:
    """Whether a variant of a candidate at the same places has fewer parameters."""
    return any(o.candidate.is_variant_of(s.candidate) and o.state in ABLE and o.freedom < s.freedom for o in named)


def variants_of(named: Sequence[Scored], best: Scored) -> list[Scored]:
    """Other variants of the best candidate, at the same places, whose columns have much in common with it."""
    mine = best.candidate
    own = [s for s in named if s.candidate.name != mine.name and s.candidate.is_variant_of(mine)]
    return _alike(own, best, lambda c: c.name)


def simplest_of(named: Sequence[Scored], best: Scored) -> Scored:
    """The best candidate, or its variant with the fewest parameters if the others explain no more than by chance.

    Where no fit decides between variants, a drift is named only if it is significant in addition to its offset, at a
    level of 1 %.
    """
    own = [s for s in named if s.candidate.is_variant_of(best.candidate) and s.state in ABLE and s.bic > 0]
    simpler = [
        s
        for s in own
        if s.freedom < best.freedom
        and canonical(best, s) > ALIASED
        and best.explained - s.explained < float(stats.chi2.isf(BY_CHANCE, best.freedom - s.freedom))
    ]
    return min(simpler, key=lambda s: (s.freedom, -s.bic), default=best)


def of_other_families(named: Sequence[Scored], best: Scored, rejected: Collection[str]) -> list[Scored]:
    """The most correlated candidates of other families: the best of each family, at any score."""
    mine = best.candidate
    others = [s for s in named if s.candidate.family != mine.family and not s.candidate.is_variant_of(mine)]
    return _alike([s for s in others if s.candidate.label not in rejected], best, lambda c: c.family, SHARED)


def _alike(
    scored: Sequence[Scored], best: Scored, kind: Callable[[Candidate], str], above: float = CONFUSABLE
) -> list[Scored]:
    """The first of each kind among the candidates correlated with the best one whose BIC justifies their parameters."""
    found: dict[str, Scored] = {}
    for other in sorted(scored, key=lambda s: -s.bic):
        if other.state in ABLE and other.bic > 0 and canonical(best, other) > above:
            found.setdefault(kind(other.candidate), other)
    return list(found.values())
