"""Extends a plan: further visits, runs or sweeps follow those that it has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from experiments.plans.errors import PlanError
from experiments.plans.limits import course_of
from experiments.plans.model import Plan, Visit
from experiments.plans.motion import Array
from experiments.plans.validate import validate_plan

__all__ = ["extended"]


def extended(plan: Plan, more: Plan, most: int) -> Plan:
    """The plan followed by at most ``most`` visits, runs or sweeps of another plan, and their share of the time.

    Raises
    ------
    PlanError
        The other one is of another kind or cell, or the two together are beyond the limits.
    """
    if more.kind != plan.kind or more.cell.robot.name != plan.cell.robot.name:
        raise PlanError(f"further measurements: expected {plan.kind} of {plan.cell.robot.name}, found {more.kind}")
    taken = [min(len(part), most) for part in (more.visits, more.runs, more.sweeps)]
    share = sum(taken) / max(len(more.visits) + len(more.runs) + len(more.sweeps), 1)
    last = max((sweep.clamping for sweep in plan.sweeps), default=0)
    made = replace(
        plan,
        visits=(*plan.visits, *_behind(plan, more.visits[:most])),
        runs=(*plan.runs, *more.runs[:most]),
        sweeps=(*plan.sweeps, *(replace(s, clamping=last + s.clamping) for s in more.sweeps[:most])),
        duration=plan.duration + share * more.duration,
    )
    validate_plan(made, "further measurements")
    return made


def _behind(plan: Plan, visits: tuple[Visit, ...]) -> list[Visit]:
    """Visits with numbers of poses of their own, each reached from the one before."""
    if not visits:
        return []
    numbers: dict[str, int] = {}
    for visit in plan.visits:
        numbers[visit.table] = max(numbers.get(visit.table, 0), visit.pose)
    before: Array | None = plan.visits[-1].q if plan.visits else plan.start
    made = []
    for visit in visits:
        duration, ramp = np.array(visit.duration), np.array(visit.ramp)
        if before is not None:
            way = course_of(plan.cell.robot, plan.limits, np.array([before, visit.via]))
            duration[0], ramp[0] = way.duration[0], way.ramp[0]
        targets = tuple(t for t in visit.targets if t in plan.cell.targets) or tuple(plan.cell.targets)
        pose = numbers.get(visit.table, 0) + visit.pose
        made.append(replace(visit, pose=pose, duration=duration, ramp=ramp, targets=targets))
        before = visit.q
    return made
