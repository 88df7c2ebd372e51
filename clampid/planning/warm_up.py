"""Plans of a warm-up and cool-down: motion of chosen joints alternates with measurements of a reference point.

Between two measurements the chosen joints swing to and fro about the reference posture. An interruption is a rest of a
stated length after a stated time of motion. The cool-down is a rest with measurements at the same interval.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from clampid.planning.returns import MAX_VISITS, ReturnWishes
from clampid.planning.scene import Scene
from clampid.planning.visiting import Stop, plan_of_visits, visits_of
from clampid.stages.rows import Array
from experiments.plans.errors import PlanError
from experiments.plans.limits import Limits, course_of
from experiments.plans.model import Cell, Plan, Steady

__all__ = ["WarmUp", "plan_warm_up"]

REFERENCE_POSE = 1  # number of the pose that is measured; swings have the numbers after it


@dataclass(frozen=True)
class WarmUp:
    """The wishes for a warm-up.

    Attributes
    ----------
    joints
        Numbers of the joints that move, from 0.
    together
        Whether all of them move at once; otherwise one after the other, each for the whole time.
    swing
        Amplitude to either side of the reference posture, rad.
    hours
        Duration of motion and measurements, h.
    repetitions
        Number of measurements of the reference point after which it ends, instead of ``hours``; None: by ``hours``.
    every
        Time of motion between two measurements, s.
    interrupt
        Time of motion before a rest, and duration of the rest, both s; None: no interruptions.
    cool
        Rest at the end, h.
    steady
        Criterion for an earlier end; None: none.
    """

    joints: tuple[int, ...]
    together: bool = True
    swing: float = 0.5
    hours: float = 3.0
    repetitions: int | None = None
    every: float = 300.0
    interrupt: tuple[float, float] | None = None
    cool: float = 0.0
    steady: Steady | None = None

    def check(self) -> None:
        """Check that all numbers are in range.

        Raises
        ------
        PlanError
            One is not; the message names the first.
        """
        for name, value, low, high in (
            ("hours", self.hours, 0.0, 168.0),
            ("every", self.every, 0.0, 86400.0),
            ("swing", self.swing, 0.0, np.pi),
        ):
            if not low < value <= high:
                raise PlanError(f"{name}: expected above {low:g} and at most {high:g}, found {value:g}")
        if not 0.0 <= self.cool <= 168.0:
            raise PlanError(f"cool-down: expected hours from 0 to 168, found {self.cool:g}")
        if self.repetitions is not None and not 1 <= self.repetitions <= MAX_VISITS:
            raise PlanError(f"repetitions: expected 1 to {MAX_VISITS}, found {self.repetitions}")
        if self.interrupt is not None and not all(0.0 < v <= 604800.0 for v in self.interrupt):
            raise PlanError(f"interrupt: expected hours above 0 and at most 168, found {self.interrupt}")
        if self.steady is not None and self.cool:
            raise PlanError("cool-down: expected none after a warm-up that ends when it is steady: plan it by itself")
        if not self.joints:
            raise PlanError("joints: expected one or more, found none")


def plan_warm_up(
    cell: Cell, limits: Limits, scene: Scene, wanted: ReturnWishes, warm: WarmUp, posture: Array,
    assumed: tuple[str, ...] = (),
) -> Plan:  # fmt: skip
    """Plan a warm-up about a reference posture, which is measured before, in between, and while the robot cools.

    Parameters
    ----------
    cell, limits, scene
        The cell, its limits and its obstacles.
    wanted
        Wishes for targets, speed and approach.
    warm
        The wishes for the warm-up.
    posture
        Reference posture ``(n,)``, rad.
    assumed
        Assumptions made so far, in words.

    Raises
    ------
    PlanError
        A number is out of range, a swing leaves the joint ranges, or it touches something.
    """
    warm.check()
    wanted.approach.check()
    wanted.point(cell)
    stops = list(_stops(cell, limits, wanted, warm, np.asarray(posture, dtype=np.float64)))
    if len(stops) > MAX_VISITS:
        raise PlanError(f"every: expected at most {MAX_VISITS} visits, found {len(stops)}")
    record: dict[str, float | int | str] = {
        "program": "warm-up",
        "joints": ", ".join(str(j + 1) for j in warm.joints) + ("" if warm.together else ", one at a time"),
        "speed": wanted.approach.share,
        "swing_rad": warm.swing,
        "hours": warm.hours,
        "every_s": warm.every,
    }
    record |= {} if warm.repetitions is None else {"repetitions": warm.repetitions}
    record |= {} if warm.interrupt is None else {"interrupt_after_s": warm.interrupt[0], "rest_s": warm.interrupt[1]}
    record |= {"cool_down_h": warm.cool} if warm.cool else {}
    visits = visits_of(cell, limits, scene, stops, wanted.approach)
    return plan_of_visits(cell, limits, visits, wanted.measure_time, record, assumed, warm.steady)


def _stops(cell: Cell, limits: Limits, wanted: ReturnWishes, warm: WarmUp, posture: Array) -> Iterator[Stop]:
    """The stops in their order: swings, measurements of the reference posture, and rests."""
    reference = Stop(REFERENCE_POSE, posture, posture - wanted.approach.angle, wanted.targets)
    pause = wanted.measure_time * len(wanted.targets)
    yield reference
    for number, joints in enumerate(
        [warm.joints] if warm.together else [(j,) for j in warm.joints], REFERENCE_POSE + 1
    ):
        amplitude = np.zeros(cell.robot.n)
        amplitude[list(joints)] = warm.swing
        low, high = posture - amplitude, posture + amplitude
        course = course_of(cell.robot, limits, np.array([low, high]), speed_share=wanted.approach.share)
        one = 2 * float(course.duration[0])  # there and back
        swings = max(round(warm.every / one), 1)
        block = swings * one + pause
        blocks = max(round(warm.hours * 3600.0 / block), 1) if warm.repetitions is None else warm.repetitions
        moved = 0.0
        for k in range(blocks):
            yield Stop(number, high, low, (), times=swings, slow=False)
            yield reference
            moved += block
            if warm.interrupt is not None and moved >= warm.interrupt[0] and k < blocks - 1:
                yield Stop(REFERENCE_POSE, posture, reference.via, wanted.targets, wait=warm.interrupt[1])
                moved = 0.0
    for _ in range(round(warm.cool * 3600.0 / warm.every) if warm.cool else 0):
        yield Stop(REFERENCE_POSE, posture, reference.via, wanted.targets, wait=max(warm.every - pause, 0.0))
