"""Choose what to measure next to separate effects that explain the same rows, and give the reason in words."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from clampid.diagnosis.deciding import Deciding
from clampid.diagnosis.diagnose import diagnose
from clampid.diagnosis.next_measurement import ENOUGH, POWER, SAME, STATES, NextPlan
from clampid.diagnosis.next_plan import Undecided, separating_plan
from clampid.diagnosis.result import StageDiagnosis
from clampid.display import number
from clampid.effect import Stage
from clampid.identification.fitted_stage import FittedStage
from clampid.loop.confusable import Confusable, confusable_pairs, evidence_apart, fitted_with
from clampid.loop.live_fit import fit_of
from clampid.models.model import StageModel
from clampid.slots import Term
from clampid.stages.stage_kind import kind_of
from experiments.campaign import Campaign

__all__ = ["Next", "Separating"]

CHANCE_GIVEN_UP = (1.0 - POWER) ** 2
"""If a pair is still open although the chance of that was below this, the model is wrong: it is given up."""


@dataclass(frozen=True)
class Next:
    """What is measured next, and why.

    Attributes
    ----------
    proposed
        The plan; None if nothing more is measured.
    why
        Sentences for the user.
    """

    proposed: NextPlan | None
    why: str


class Separating:
    """Chooses measurements, and reports what became of the pairs that earlier measurements were to separate.

    Parameters
    ----------
    seed
        Of the diagnosis.
    budget
        Measurements that may be added in all; only used in sentences.
    """

    def __init__(self, seed: int = 0, budget: int = 0) -> None:
        self._seed, self._budget = seed, budget
        self._open: list[tuple[Term, Term]] = []
        self._reported: set[tuple[Term, Term]] = set()
        self._in_vain: defaultdict[tuple[Term, Term], float] = defaultdict(lambda: 1.0)

    def next(self, campaign: Campaign, stage: Stage, left: int) -> Next:
        """What to measure next.

        Parameters
        ----------
        campaign
            All rows so far.
        stage
            The stage to which further measurements belong.
        left
            Measurements that may still be added.

        Raises
        ------
        FitError, EffectError, CampaignError, ModelError
            The rows cannot be judged.
        PlanError
            The campaign's robot lets no measurement be planned.
        """
        used_up = f"nothing more is measured: the budget of {self._budget} is used up."
        if left <= 0 and not self._open:
            return Next(None, used_up)
        model = fit_of(campaign)
        found = diagnose(model, campaign, seed=self._seed, stages=(stage,)).stages[stage]
        others = {s: m for s, m in model.stages.items() if s != stage}
        fitted = None if found.fitted is None else _with_one_of_each(found.fitted, found, others)
        pairs: list[Confusable] = []
        if fitted is not None and found.scores is not None:
            pairs = confusable_pairs(fitted, {s.candidate.name for s in found.scores.named}, others)
        decided = [] if fitted is None else self._newly_decided(fitted, pairs, others)
        if left <= 0:
            return Next(None, _joined(decided, used_up))
        if found.undecided and found.next_plan is not None and found.next_plan.plan is not None:
            words = f"{min(len(found.next_plan.chosen), left)} more, because {_alike(found)} explain the same."
            return Next(found.next_plan, _joined(decided, f"{words} {_sentence(found.next_plan)}."))
        pairs = [p for p in pairs if p.apart > -SAME and self._in_vain[p.terms] > CHANCE_GIVEN_UP]
        states = STATES if kind_of(stage).points else STATES[:1]
        wanted = [Undecided(p.without, (p.first, p.second), p.scale, p.apart) for p in pairs]
        chosen = separating_plan(campaign, wanted, self._seed, left, states)
        if chosen is None:
            return Next(None, _joined(decided, _nothing(found, pairs)))
        best, deciding = chosen
        self._open = list(dict.fromkeys([*(p.terms for p in pairs), *self._open]))
        for pair, chance in zip(pairs, deciding.chances.tolist(), strict=True):
            self._in_vain[pair.terms] *= 1.0 - min(chance, POWER)  # the model may be wrong, so no chance is certain
        words = f"{len(best.chosen)} more, because {_apart(pairs, deciding)}. {_expected(best)}"
        return Next(best, _joined(decided, words))

    def _newly_decided(
        self, fitted: FittedStage, pairs: Sequence[Confusable], others: Mapping[Stage, StageModel]
    ) -> list[str]:
        """Sentences on pairs that are no longer open, and on pairs whose absent effect is the likelier."""
        still = {p.terms for p in pairs if p.apart > -SAME}
        apart = {p.terms: p.apart for p in pairs if p.apart <= -SAME}
        gone = [two for two in self._open if two not in still and two not in apart]
        apart |= {two: evidence_apart(fitted, *two, others) for two in gone}
        new = {two: value for two, value in apart.items() if two not in self._reported}
        self._reported = {*apart} | (self._reported - still)
        self._open = [two for two in self._open if two in still]
        return [_verdict(*two, value) for two, value in new.items()]


def _sentence(proposed: NextPlan) -> str:
    return f"{proposed.sentence[:1].upper()}{proposed.sentence[1:]}"


def _with_one_of_each(fitted: FittedStage, found: StageDiagnosis, others: Mapping[Stage, StageModel]) -> FittedStage:
    """The fit with the first effect of each undecided group: without one, what they explain would count as noise."""
    first: dict[int, list[Term]] = {}
    for c in found.candidates:
        if c["alternative"]:
            first.setdefault(int(c["group"]), [Term(str(c["name"]), place) for place in c["where"]])
    more = [term for terms in first.values() for term in terms]
    return fitted_with(fitted, more, others) if more else fitted


def _joined(decided: Sequence[str], words: str) -> str:
    return " ".join([*decided, f"{words[:1].upper()}{words[1:]}" if decided else words])


def _apart(pairs: Sequence[Confusable], deciding: Deciding) -> str:
    """Pairs that the next measurements are likely to decide, with the chance, and how many others are open."""
    likely = deciding.likely(POWER)
    said = [
        f"{' and '.join(term.label for term in pairs[k].terms)} explain the same (evidence {abs(pairs[k].apart):.1f}; "
        f"chance that these decide it: {100.0 * deciding.chances[k]:.0f} %)"
        for k in likely
    ]
    others = len(pairs) - len(likely)
    more = f"; {others} other {'pair is' if others == 1 else 'pairs are'} open" if others else ""
    return f"{', '.join(said)}; evidence {SAME:.0f} decides{more}"


def _verdict(first: Term, second: Term, apart: float) -> str:
    """The decision on a pair; ``apart`` is the evidence for the first."""
    kept, gone = (first, second) if apart > 0 else (second, first)
    if abs(apart) < SAME:
        return (
            f"{first.label} and {second.label} no longer explain the same: evidence {abs(apart):.1f} for {kept.label}."
        )
    if not np.isfinite(apart):
        return f"{kept.label} it is: {gone.label} would need a value that it cannot have."
    return f"{kept.label} it is, and not {gone.label}: evidence {abs(apart):.0f}, and {SAME:.0f} decides."


def _alike(found: StageDiagnosis) -> str:
    """Names of the effects that the diagnosis cannot distinguish; empty if there are none."""
    names = (str(c.get("name", c["effect"])) for c in found.candidates if c["alternative"])
    return " and ".join(dict.fromkeys(names))


def _expected(proposed: NextPlan) -> str:
    """What is proposed, and how much better it separates the closest pair."""
    now, then, enough = (
        f"{number(float(np.sqrt(square)), 2)} σ" for square in (proposed.before, proposed.after, ENOUGH)
    )
    known = f"{enough} is enough in 9 of 10 campaigns" if proposed.helps else f"{enough} would be enough, in 9 of 10"
    return f"The closest pair differs by {now}. {proposed.count} ({proposed.words}) raise this to {then}; {known}."


def _nothing(found: StageDiagnosis, pairs: Sequence[Confusable]) -> str:
    """Why nothing more is measured."""
    if alike := _alike(found):
        proposed = found.next_plan
        none = "nothing is proposed" if proposed is None else proposed.nothing
        return f"nothing more is measured: {alike} explain the same, and {none}."
    if not pairs:
        return f"nothing more is measured: no two effects explain the same (verdict: {found.verdict})."
    names = "; ".join(" and ".join(term.label for term in pair.terms) for pair in pairs)
    return f"nothing more is measured: no further measurement that this robot can take separates {names}."
