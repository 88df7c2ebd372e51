"""Further measurements that separate effects, while two of them explain the same, up to a budget."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clampid.diagnosis.diagnose import diagnose
from clampid.diagnosis.next_measurement import COOLING, ENOUGH, SAME, NextPlan
from clampid.diagnosis.next_plan import parting_plan
from clampid.diagnosis.result import StageDiagnosis
from clampid.effect import EffectError, Stage
from clampid.fitting.solve import FitError
from clampid.loop.confusable import Confusable, confusable_pairs, evidence_apart
from clampid.loop.live_fit import campaign_so_far, fit_of
from clampid.models.model import ModelError, StageModel
from clampid.slots import Term
from experiments.campaign import Campaign
from experiments.errors import CampaignError
from experiments.plans.errors import PlanError
from experiments.plans.model import Kind, Plan
from experiments.runs.extension import extended

__all__ = ["Adaptive", "Next", "rested"]

STAGE: Mapping[Kind, Stage] = {"free_air": "free_air", "wrist": "free_air", "clamping": "clamped", "poses": "poses"}


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


class Adaptive:
    """Decides, when a plan is done, what is measured next; says what it decided and why.

    Parameters
    ----------
    plan
        The plan that the run began with.
    before
        What the campaign's folder held before.
    budget
        Visits, runs or sweeps that may be added.
    say
        Takes a line for a person.
    seed
        Of diagnose.
    """

    def __init__(
        self, plan: Plan, before: Campaign | None, budget: int, say: Callable[[str], None], seed: int = 0
    ) -> None:
        self._length, self._before, self._budget, self._say, self._seed = _length(plan), before, budget, say, seed
        self._open: list[tuple[Term, Term]] = []

    def more(self, plan: Plan, entries: Sequence[Mapping[str, Any]]) -> tuple[Plan | None, str]:
        """The plan that goes on, or None where nothing more is to be measured, and why."""
        left = self._budget - (_length(plan) - self._length)
        try:
            campaign = _within(campaign_so_far(plan, entries, self._before), plan)
            chosen = self.next(campaign, STAGE[plan.kind], left)
            grown = None if chosen.proposed is None else extended(plan, rested(chosen.proposed), left)
        except (FitError, EffectError, CampaignError, ModelError) as error:
            return self._told(None, f"nothing more is measured: diagnose cannot judge what was measured: {error}.")
        except PlanError as error:
            return self._told(None, f"nothing more is measured: what separates them cannot be run here: {error}.")
        return self._told(grown, chosen.why)

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
            return Next(None, _joined(decided, f"nothing more is measured: the budget of {self._budget} is used up."))
        alike = ""
        if found.verdict == "ambiguous":
            alike = " and ".join(
                dict.fromkeys(str(c.get("name", c["effect"])) for c in found.candidates if c["alternative"])
            )
            if found.next_plan is not None and found.next_plan.plan is not None:
                count = min(len(found.next_plan.chosen), left)
                return Next(
                    found.next_plan,
                    _joined(decided, f"{count} more, because {alike} explain the same. {_brings(found.next_plan)}"),
                )
        pairs, other_way = self._pairs(found, others)
        decided += other_way
        proposals = [(pair, self._proposal(campaign, pair, left)) for pair in pairs]
        able = [(pair, p) for pair, p in proposals if p is not None and p.plan is not None]
        if not able:
            return Next(None, _joined(decided, _nothing(found, alike, [pair for pair, _ in proposals])))
        pair, best = min(able, key=lambda one: (not one[1].helps, len(one[1].chosen), -one[1].after))
        self._open = [pair.terms, *(t for t in self._open if t != pair.terms)]
        words = f"{len(best.chosen)} more, because {_apart(pair)}. {_brings(best)}"
        return Next(best, _joined(decided, words))

    def _pairs(
        self, found: StageDiagnosis, others: Mapping[Stage, StageModel]
    ) -> tuple[list[Confusable], list[str]]:
        """Pairs that nothing decides yet, and sentences on those in which the absent effect is the likelier."""
        if found.fitted is None or found.scores is None:
            return [], []
        searched = {s.candidate.name for s in found.scores.named}
        pairs = confusable_pairs(found.fitted, searched, others)
        clear = [p for p in pairs if p.apart <= -SAME]
        return [p for p in pairs if p not in clear], [_verdict(*p.terms, p.apart) for p in clear]

    def _proposal(self, campaign: Campaign, pair: Confusable, left: int) -> NextPlan | None:
        """Measurements that separate a pair."""
        return parting_plan(campaign, pair.without, [pair.first, pair.second], pair.scale, self._seed, left)

    def _decided(self, found: StageDiagnosis, others: Mapping[Stage, StageModel]) -> list[str]:
        """Sentences on pairs that were open and are no longer."""
        if found.fitted is None:
            return []
        apart = {pair: evidence_apart(found.fitted, *pair, others) for pair in self._open}
        self._open = [pair for pair, value in apart.items() if abs(value) < SAME]
        return [_verdict(*pair, value) for pair, value in apart.items() if abs(value) >= SAME]

    def _told(self, plan: Plan | None, words: str) -> tuple[Plan | None, str]:
        said = f"Adaptive: {words}"
        self._say(said)
        return plan, said


def rested(proposed: NextPlan) -> Plan:
    """The proposed plan; where the robot is to be cold, it rests before the first visit is measured."""
    made = proposed.plan
    if made is None:
        raise PlanError("expected a plan, found none")
    if proposed.state != "cold" or not made.visits:
        return made
    first, *others = made.visits
    return replace(made, visits=(replace(first, wait=COOLING), *others), duration=made.duration + COOLING)


def _joined(decided: Sequence[str], words: str) -> str:
    return " ".join([*decided, f"{words[:1].upper()}{words[1:]}" if decided else words])


def _apart(pair: Confusable) -> str:
    first, second = (term.label for term in pair.terms)
    return (
        f"{first} and {second} explain the same: their evidence differs by {abs(pair.apart):.1f}, and {SAME:.0f} decide"
    )


def _verdict(first: Term, second: Term, apart: float) -> str:
    """What became of a pair; ``apart``: by how much the first is likelier."""
    kept, gone = (first, second) if apart > 0 else (second, first)
    if not np.isfinite(apart):
        return f"{kept.label} it is: {gone.label} would need a value that it cannot have."
    return (
        f"{kept.label} it is, and not {gone.label}: their evidence differs by {abs(apart):.0f}, and {SAME:.0f} decide."
    )


def _brings(proposed: NextPlan) -> str:
    """What a proposal is, and what is expected of it."""
    if proposed.helps:
        return f"{proposed.sentence[:1].upper()}{proposed.sentence[1:]}."
    now, then, enough = (f"{np.sqrt(square):.2g} σ" for square in (proposed.before, proposed.after, ENOUGH))
    return (
        f"{proposed.count} ({proposed.words}): the two differ by {now}, these raise this to {then}; {enough} would be "
        "enough in 9 of 10 campaigns."
    )


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


def _within(campaign: Campaign, plan: Plan) -> Campaign:
    """The campaign of a robot that reaches no farther than the plan lets it: what is proposed keeps to that."""
    ranges = zip(campaign.robot.joints, plan.limits.lower, plan.limits.upper, strict=True)
    joints = tuple(replace(joint, lower=float(lower), upper=float(upper)) for joint, lower, upper in ranges)
    return replace(campaign, robot=replace(campaign.robot, joints=joints))


def _length(plan: Plan) -> int:
    return len(plan.visits) + len(plan.runs) + len(plan.sweeps)
