"""Plans of repeated visits to given postures: paths, approaches, visits, and the complete plan.

The direction of approach is part of the measurement: with backlash and friction, a posture approached from the other
side is a different one. Therefore every visit ends with a short last move with stated signs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from clampid.planning.reach import reaching
from clampid.planning.sampling import DIGITS
from clampid.planning.scene import Scene
from clampid.stages.rows import Array
from experiments.plans.errors import PlanError
from experiments.plans.limits import Limits, course_of
from experiments.plans.model import Cell, Plan, Steady, Visit
from experiments.plans.validate import validate_plan

__all__ = ["Approach", "Stop", "approach_signs", "path_through", "plan_of_visits", "visits_of"]

IK_STARTS = 60  # postures from which the inverse kinematics of the first place is started
LARGEST_POSTURE_STEP = 1.4  # rad (m) of any joint between postures of neighbouring places: more is another branch
LEAST_SPEED_SHARE = 0.01  # of the top speeds: controllers take no smaller override


@dataclass(frozen=True)
class Approach:
    """The last move to a posture.

    Attributes
    ----------
    angle
        Angle (travel) of every joint, rad (m).
    seconds
        Its least duration, s; None: as fast as the limits allow.
    share
        Share of the top speeds for all moves.
    """

    angle: float = 0.05
    seconds: float | None = None
    share: float = 1.0

    def check(self) -> None:
        """Check that all numbers are in range.

        Raises
        ------
        PlanError
            One is not; the message names the first.
        """
        if not 0.0 < self.angle < 1.0:
            raise PlanError(f"approach: expected rad above 0 and below 1, found {self.angle:g}")
        if self.seconds is not None and not 0.0 < self.seconds <= 60.0:
            raise PlanError(f"last move: expected seconds above 0 and at most 60, found {self.seconds:g}")
        if not 0.0 < self.share <= 1.0:
            raise PlanError(f"speed: expected a share of the top speeds above 0 and at most 1, found {self.share:g}")


@dataclass(frozen=True)
class Stop:
    """One visit, before its moves are timed.

    Attributes
    ----------
    pose
        Number of the posture, from 1.
    q
        Posture ``(n,)``, rad.
    via
        Start of its last move ``(n,)``, rad.
    targets, times, wait
        As of a :class:`~experiments.plans.model.Visit`.
    slow
        Whether the last move has the least duration of the approach; else it is as fast as the other moves.
    """

    pose: int
    q: Array
    via: Array
    targets: tuple[str, ...]
    times: int = 1
    wait: float = 0.0
    slow: bool = True


def approach_signs(q: Array, before: Array) -> Array:
    """Signs ``(n,)`` of the move from ``before`` to ``q`` ``(n,)``, rad; +1 for joints that do not move."""
    travel = np.asarray(q) - before
    return np.where(np.abs(travel) > 10.0**-DIGITS, np.sign(travel), 1.0)


def path_through(
    cell: Cell, limits: Limits, scene: Scene, places: Array, z_axis: Array, point: Array, room: float
) -> Array:
    """Postures ``(m, n)``, rad, that bring a tool point to one place after the other on one branch of the robot.

    Parameters
    ----------
    cell, limits, scene
        The cell, its limits and its obstacles.
    places
        Places ``(m, 3)``, m, base frame.
    z_axis
        Direction of the flange's z axis ``(3,)``, base frame; not of unit length.
    point
        Tool point ``(3,)``, m, flange frame.
    room
        Distance of every joint to its limits, rad, for approaches from either side.

    Raises
    ------
    PlanError
        No branch reaches all places within the limits and clear of obstacles.
    """
    length = float(np.linalg.norm(z_axis))
    if not length > 0.0 or not np.all(np.isfinite(places)):
        raise PlanError("expected finite places, and a direction for the flange's z axis that is not zero")
    lower, upper = limits.lower + room, limits.upper - room
    starts = lower + (upper - lower) * np.random.default_rng(0).random((IK_STARTS, cell.robot.n))
    axis, normal = z_axis / length, np.array([0.0, 0.0, 1.0])

    def inside(q: Array) -> bool:
        return bool(np.all((q >= lower) & (q <= upper)))

    first = reaching(cell.robot, places[0], axis, starts, point=point, normal=normal)
    if not len(first):
        raise PlanError(f"expected places that the robot reaches, found place 1 at {_words(places[0])} m out of reach")
    first = first[np.all((first >= lower) & (first <= upper), axis=1)]
    order = np.argsort(np.abs((first - (lower + upper) / 2) / (upper - lower)).max(axis=1))
    farthest, blocked = 0, False
    for start in first[order]:
        path = [np.round(start, DIGITS)]
        for place in places[1:]:
            found = reaching(cell.robot, place, axis, path[-1][None], point=point, normal=normal)
            if not len(found) or not inside(found[0]) or np.max(np.abs(found[0] - path[-1])) > LARGEST_POSTURE_STEP:
                break
            path.append(np.round(found[0], DIGITS))
        clear = scene.clear(np.array(path))
        reached = len(path) if clear.all() else int(np.argmin(clear))
        if reached == len(places):
            return np.array(path)
        farthest, blocked = max((farthest, blocked), (reached, reached < len(path)))
    why = "not clear of floor, arm and obstacles" if blocked else "out of reach or of joint limits"
    raise PlanError(
        f"expected a posture for each of {len(places)} places, without a change of branch, found place {farthest + 1} "
        f"at {_words(places[farthest])} m {why}"
    )


def visits_of(cell: Cell, limits: Limits, scene: Scene, stops: Sequence[Stop], approach: Approach) -> tuple[Visit, ...]:
    """Visits with timed moves, all of them checked for collisions.

    Parameters
    ----------
    cell, limits, scene
        The cell, its limits and its obstacles.
    stops
        The stops in their order.
    approach
        Speed of the moves, and duration of the last one to each stop.

    Raises
    ------
    PlanError
        A move touches something, or the approach is out of range.
    """
    approach.check()
    known: dict[tuple[tuple[float, ...], ...], bool] = {}
    count: dict[int, int] = {}
    visits: list[Visit] = []
    before: Array | None = None
    for stop in stops:
        origin = stop.via if before is None else before
        for a, b in ((origin, stop.via), (stop.via, stop.q)):
            ends = (tuple(min(tuple(a), tuple(b))), tuple(max(tuple(a), tuple(b))))
            if ends not in known:
                known[ends] = bool(scene.clear(np.array([a, b])).all()) and scene.way_clear(a, b)
            if not known[ends]:
                raise PlanError(
                    f"the way to pose {stop.pose}: expected it clear of floor, arm and obstacles, found it not"
                )
        knots = np.array([origin, stop.via, stop.q])
        course = course_of(cell.robot, limits, knots, speed_share=approach.share)
        duration, ramp = np.array(course.duration), np.array(course.ramp)
        if stop.slow and approach.seconds is not None and duration[1] < approach.seconds:
            ramp[1] *= approach.seconds / duration[1]
            duration[1] = approach.seconds
        count[stop.pose] = count.get(stop.pose, 0) + 1
        visits.append(
            Visit(
                "poses", stop.pose, count[stop.pose], np.asarray(stop.via), np.asarray(stop.q), duration, ramp,
                stop.targets, stop.times, stop.wait,
            )
        )  # fmt: skip
        before = stop.q
    return tuple(visits)


def plan_of_visits(
    cell: Cell, limits: Limits, visits: tuple[Visit, ...], measure_time: float,
    wished: Mapping[str, float | int | str], assumed: Sequence[str], steady: Steady | None = None,
) -> Plan:  # fmt: skip
    """The plan of these visits, checked against its own limits.

    Parameters
    ----------
    cell, limits
        The cell and its limits.
    visits
        The visits.
    measure_time
        Time for each target, s.
    wished
        The wishes, for the record.
    assumed
        Assumptions, in words.
    steady
        When the program ends early; None: never.

    Raises
    ------
    PlanError
        A move exceeds a limit, or the measuring time is out of range.
    """
    if not 0.0 <= measure_time < 3600.0:
        raise PlanError(f"measuring time: expected seconds from 0 to 3600, found {measure_time:g}")
    said = list(assumed)
    top = limits.speed
    peaks = [np.max(np.abs(v.q - v.via) / top) / (v.duration[1] - v.ramp[1]) for v in visits if np.any(v.q != v.via)]
    if peaks and min(peaks) < LEAST_SPEED_SHARE:
        said.append(
            f"the slowest move has {min(peaks):.2%} of the top speeds; a link that takes whole per cents does it at 1 %"
        )
    plan = Plan(
        kind="poses",
        cell=cell,
        limits=limits,
        duration=sum(v.length(measure_time) for v in visits) - float(visits[0].duration[0]),
        visits=visits,
        measure_time=measure_time,
        steady=steady,
        assumed=tuple(said),
        wished=MappingProxyType(dict(wished)),
    )
    validate_plan(plan)
    return plan


def _words(place: Array) -> str:
    """Coordinates of a place for messages."""
    return ", ".join(f"{v:.4g}" for v in place)
