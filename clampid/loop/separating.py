"""What to measure next, so that effects that explain the same are told apart: the decision, and its reason in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from clampid.diagnosis.diagnose import diagnose
from clampid.diagnosis.next_measurement import ENOUGH, SAME, NextPlan
from clampid.diagnosis.next_plan import separating_plan
from clampid.diagnosis.result import StageDiagnosis
from clampid.effect import Stage
from clampid.loop.confusable import Confusable, confusable_pairs, evidence_apart
from clampid.loop.live_fit import fit_of
from clampid.models.model import StageModel
from clampid.slots import Term
from experiments.campaign import Campaign

__all__ = ["Next", "Separating"]


@dataclass(frozen=True)
class Next:
    """What is measured next, and why.

    Attributes
    ----------
    proposed
        None: nothing more.
    why
        Sentences for a person.
    """

    proposed: NextPlan | None
    why: str


class Separating:
    """Chooses measurements, and says what became of the pairs that earlier ones were for.

    Parameters
    ----------
    seed
        Of diagnose.
    """

    def __init__(self, seed: int = 0) -> None:
        self._seed = seed
        self._open: list[tuple[Term, Term]] = []

    def next(self, campaign: Campaign, stage: Stage, left: int) -> Next:
        """What to measure next, at most so much, given all that was measured.

        Raises
        ------
        FitError, EffectError, CampaignError, ModelError
            The rows cannot be judged.
        PlanError
            The campaign's robot lets no measurement be planned.
        """
        model = fit_of(campaign)
        found = diagnose(model, campaign, seed=self._seed, stages=(stage,)).stages[stage]
        others = {s: m for s, m in model.stages.items() if s != stage}
        decided = self._decided(found, others)
        if left <= 0:
            return Next(None, _joined(decided, "nothing more is measured: the budget is used up."))
        alike = ""
        if found.verdict == "ambiguous":
            alike = " and ".join(
                dict.fromkeys(str(c.get("name", c["effect"])) for c in found.candidates if c["alternative"])
            )
            if found.next_plan is not None and found.next_plan.plan is not None:
                count = min(len(found.next_plan.chosen), left)
                return Next(
                    found.next_plan,
                    _joined(decided, f"{count} more, because {alike} explain the same. {_sentence(found.next_plan)}."),
                )
        pairs, other_way = self._pairs(found, others)
        decided += other_way
        wanted = [(p.without, (p.first, p.second), p.scale) for p in pairs]
        found_plan = separating_plan(campaign, wanted, self._seed, left) if pairs else None
        if found_plan is None:
            return Next(None, _joined(decided, _nothing(found, alike, pairs)))
        best, numbers = found_plan
        mine = [pairs[k] for k in numbers]
        self._open = list(dict.fromkeys([*(p.terms for p in mine), *self._open]))
        words = f"{len(best.chosen)} more, because {_apart(mine)}. {_expected(best)}"
        return Next(best, _joined(decided, words))

    def _pairs(self, found: StageDiagnosis, others: Mapping[Stage, StageModel]) -> tuple[list[Confusable], list[str]]:
        """Pairs that nothing decides yet, and sentences on those in which the absent effect is the likelier."""
        if found.fitted is None or found.scores is None:
            return [], []
        searched = {s.candidate.name for s in found.scores.named}
        pairs = confusable_pairs(found.fitted, searched, others)
        clear = [p for p in pairs if p.apart <= -SAME]
        return [p for p in pairs if p not in clear], [_verdict(*p.terms, p.apart) for p in clear]

    def _decided(self, found: StageDiagnosis, others: Mapping[Stage, StageModel]) -> list[str]:
        """Sentences on pairs that were open and are no longer."""
        if found.fitted is None:
            return []
        apart = {pair: evidence_apart(found.fitted, *pair, others) for pair in self._open}
        self._open = [pair for pair, value in apart.items() if abs(value) < SAME]
        return [_verdict(*pair, value) for pair, value in apart.items() if abs(value) >= SAME]


def _sentence(proposed: NextPlan) -> str:
    return f"{proposed.sentence[:1].upper()}{proposed.sentence[1:]}"


def _joined(decided: Sequence[str], words: str) -> str:
    return " ".join([*decided, f"{words[:1].upper()}{words[1:]}" if decided else words])


def _apart(pairs: Sequence[Confusable]) -> str:
    """What several pairs are open for."""
    said = [f"{p.terms[0].label} and {p.terms[1].label} explain the same (evidence {abs(p.apart):.1f})" for p in pairs]
    return f"{', '.join(said)}; evidence {SAME:.0f} decides"


def _verdict(first: Term, second: Term, apart: float) -> str:
    """What became of a pair; ``apart``: by how much the first is likelier."""
    kept, gone = (first, second) if apart > 0 else (second, first)
    if not np.isfinite(apart):
        return f"{kept.label} it is: {gone.label} would need a value that it cannot have."
    return (
        f"{kept.label} it is, and not {gone.label}: their evidence differs by {abs(apart):.0f}, and {SAME:.0f} decide."
    )


def _expected(proposed: NextPlan) -> str:
    """What a proposal is, and what it brings."""
    now, then, enough = (f"{np.sqrt(square):.2g} σ" for square in (proposed.before, proposed.after, ENOUGH))
    known = f"{enough} is enough in 9 of 10 campaigns" if proposed.helps else f"{enough} would be enough, in 9 of 10"
    return f"The closest pair differs by {now}. {proposed.count} ({proposed.words}) raise this to {then}; {known}."


def _nothing(found: StageDiagnosis, alike: str, pairs: Sequence[Confusable]) -> str:
    """Why nothing more is measured."""
    if alike:
        proposed = found.next_plan
        none = "nothing is proposed" if proposed is None else proposed.nothing
        return f"nothing more is measured: {alike} explain the same, and {none}."
    if not pairs:
        return f"nothing more is measured: no two effects explain the same (verdict: {found.verdict})."
    names = "; ".join(" and ".join(term.label for term in pair.terms) for pair in pairs)
    return f"nothing more is measured: no further measurement that this robot can take separates {names}."
