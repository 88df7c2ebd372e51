"""Extend a plan during a run by measurements that separate effects with the same explanation, up to a budget."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from clampid.diagnosis.next_measurement import COOLING, NextPlan
from clampid.effect import EffectError, Stage
from clampid.fitting.solve import FitError
from clampid.loop.live_fit import campaign_so_far
from clampid.loop.separating import Separating
from clampid.models.model import ModelError
from experiments.campaign import Campaign
from experiments.errors import CampaignError
from experiments.plans.errors import PlanError
from experiments.plans.model import Kind, Plan
from experiments.runs.extension import extended

__all__ = ["Adaptive", "rested"]

STAGE: Mapping[Kind, Stage] = {"free_air": "free_air", "wrist": "free_air", "clamping": "clamped", "poses": "poses"}


class Adaptive:
    """When a plan is done, decides what is measured next, and gives the reason.

    Parameters
    ----------
    plan
        The plan that the run began with.
    before
        What the campaign's folder contained before the run.
    budget
        Visits, runs or sweeps that may be added.
    say
        Called with each line for the user.
    seed
        Of the diagnosis.
    """

    def __init__(
        self, plan: Plan, before: Campaign | None, budget: int, say: Callable[[str], None], seed: int = 0
    ) -> None:
        self._length, self._before, self._budget, self._say = _length(plan), before, budget, say
        self._separating = Separating(seed, budget)

    def more(self, plan: Plan, entries: Sequence[Mapping[str, Any]]) -> tuple[Plan | None, str]:
        """The extended plan, or None if nothing more is to be measured, and the reason."""
        left = self._budget - (_length(plan) - self._length)
        try:
            campaign = _within(campaign_so_far(plan, entries, self._before), plan)
            found = self._separating.next(campaign, STAGE[plan.kind], left)
            grown = None if found.proposed is None else extended(plan, rested(found.proposed), left)
        except (FitError, EffectError, CampaignError, ModelError) as error:
            judged = f"diagnose cannot judge what was measured: {error}"
            why = f"the budget of {self._budget} is used up" if left <= 0 else judged
            return self._answer(None, f"nothing more is measured: {why}.")
        except PlanError as error:
            return self._answer(None, f"nothing more is measured: what separates them cannot be run here: {error}.")
        return self._answer(grown, found.why)

    def _answer(self, plan: Plan | None, words: str) -> tuple[Plan | None, str]:
        line = f"Adaptive: {words}"
        self._say(line)
        return plan, line


def rested(proposed: NextPlan) -> Plan:
    """The proposed plan. If the robot has to be cold, it rests before the first visit.

    Raises
    ------
    PlanError
        Nothing can be planned.
    """
    made = proposed.plan
    if made is None:
        raise PlanError("expected a plan, found none")
    if proposed.state != "cold" or not made.visits:
        return made
    first, *others = made.visits
    return replace(made, visits=(replace(first, wait=COOLING), *others), duration=made.duration + COOLING)


def _within(campaign: Campaign, plan: Plan) -> Campaign:
    """The campaign with the joint limits of the plan, so that proposals stay within them."""
    ranges = zip(campaign.robot.joints, plan.limits.lower, plan.limits.upper, strict=True)
    joints = tuple(replace(joint, lower=float(lower), upper=float(upper)) for joint, lower, upper in ranges)
    return replace(campaign, robot=replace(campaign.robot, joints=joints))


def _length(plan: Plan) -> int:
    return len(plan.visits) + len(plan.runs) + len(plan.sweeps)
