"""A dry run of a plan: every motion with its time and limits, without a robot."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from experiments.plans.model import Plan, table_of
from experiments.plans.motion import Array, shortest
from experiments.runs.context import SLOW
from experiments.runs.robot import share_of

__all__ = ["Motion", "hours_or_minutes", "motions"]

SEARCHED = 3  # places of each joint that a search for the posture of least torque usually looks at
NOT_PLANNED = "not checked by the plan: asked for"


@dataclass(frozen=True, eq=False)
class Motion:
    """One motion, or a rest.

    Attributes
    ----------
    name
        Of the visit, run or sweep.
    to
        ``(n,)`` rad.
    share
        Of the top speeds.
    start, duration
        s from the beginning; the duration includes what is measured at its end.
    travel
        Of the joint that turns most, rad.
    limit
        The nearest limit, in words, with the share of it that is used.
    measured
        Which table gets rows at its end; empty: none.
    """

    name: str
    to: Array
    share: float
    start: float
    duration: float
    travel: float
    limit: str
    measured: str


def hours_or_minutes(seconds: float) -> str:
    """A duration for a person."""
    return f"{seconds / 60:.1f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def motions(plan: Plan) -> Iterator[Motion]:
    """Every motion in order; the first one begins somewhere that no plan knows, and takes no time here."""
    clock, here = 0.0, None
    for name, to, duration, share, extra, table, limit in _steps(plan):
        travel = 0.0 if here is None else float(np.max(np.abs(to - here)))
        takes = extra + (_shortest(plan, here, to, share) if duration is None else duration)
        yield Motion(name, to, share, clock, takes, travel, limit or _range(plan, to), table)
        clock, here = clock + takes, to


def _shortest(plan: Plan, here: Array | None, to: Array, share: float) -> float:
    """Of a motion that the plan gives no time, s."""
    if here is None or not np.any(to != here):
        return 0.0
    return float(shortest((to - here)[None], share * plan.limits.speed, plan.limits.acceleration)[0][0])


_Step = tuple[str, Array, float | None, float, float, str, str]


def _steps(plan: Plan) -> Iterator[_Step]:
    robot = plan.cell.robot
    before = plan.start
    for visit in plan.visits:
        name = f"pose {visit.pose}, visit {visit.visit}"
        if before is None:
            yield f"{name}: way there", visit.via, None, SLOW, 0.0, "", NOT_PLANNED
        else:
            share = share_of(robot, visit.via - before, float(visit.duration[0]), float(visit.ramp[0]))
            yield f"{name}: way there", visit.via, float(visit.duration[0]), share, 0.0, "", ""
        share = share_of(robot, visit.q - visit.via, float(visit.duration[1]), float(visit.ramp[1]))
        extra = visit.length(plan.measure_time) - float(np.sum(visit.duration))
        many = f"{name}: {visit.times} swings" if visit.times > 1 else name
        yield many, visit.q, float(visit.duration[1]), share, extra, visit.table if visit.targets else "", ""
        before = visit.q
    for number, run in enumerate(plan.runs, 1):
        course = run.course
        first = number == 1
        yield (
            f"run {number}: way there",
            course.knots[0],
            None,
            SLOW if first else run.speed_share,
            course.dwell,
            "",
            (NOT_PLANNED if first else ""),
        )
        for move, to in enumerate(course.knots[1:]):
            duration, ramp = float(course.duration[move]), float(course.ramp[move])
            share = share_of(robot, to - course.knots[move], duration, ramp)
            yield f"run {number}, move {move + 1}", to, duration, share, course.dwell, table_of(plan.kind)[0], ""
    clamping = 0
    for number, sweep in enumerate(plan.sweeps, 1):
        if sweep.clamping != clamping:
            clamping = sweep.clamping
            yield f"place {clamping} of the clamp: way there", sweep.posture, None, SLOW, 0.0, "", NOT_PLANNED
            if plan.least_torque is not None:
                seconds = SEARCHED * robot.n * 4 * (sweep.dwell + 0.1)
                limit = f"{np.degrees(plan.least_torque.within.max()):.2f} deg about it at most"
                yield f"place {clamping}: posture of least torque", sweep.posture, seconds, 0.02, 0.0, "", limit
        for step, offset in enumerate(sweep.offset):
            to = np.array(sweep.posture)
            to[sweep.joint] += offset
            yield f"sweep {number}, step {step + 1}", to, 0.1, 0.02, sweep.dwell, "clamped", _load(plan, number, step)


def _range(plan: Plan, q: Array) -> str:
    """How near a posture is to the end of a joint's range."""
    lower, upper = plan.limits.lower, plan.limits.upper
    used = np.abs(q - (lower + upper) / 2) / ((upper - lower) / 2)
    j = int(np.argmax(used))
    return f"{used[j]:.0%} of joint {j + 1}'s range"


def _load(plan: Plan, number: int, step: int) -> str:
    """The expected wrench on the clamp as a share of its limits."""
    sweep, limits = plan.sweeps[number - 1], plan.limits
    if limits.force is None or limits.moment is None:
        return ""
    shares = {"force": float(sweep.force[step]) / limits.force, "moment": float(sweep.moment[step]) / limits.moment}
    what = max(shares, key=lambda name: shares[name])
    return f"{shares[what]:.0%} of the clamp's {what}"
