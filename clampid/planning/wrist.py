"""Plans of wrist logs: swings in which a motor turns while its joint is at rest, or a joint while its motor is at rest.

The wrist's transmission couples its joints, θ_joint = Tᵀ θ_motor. Joint j is at rest while its motor turns if the other
joints move so that q_j = 0 and (T⁻ᵀ q)_j ≠ 0. Joint j moves with its motor at rest if m_j = 0 and (Tᵀ m)_j ≠ 0. Only
such decoupled motions separate arm-side friction from the motor's own. Before each swing all wrist joints move a little
to one side, so that the sign of the dry friction of a joint at rest is known. Source: the thesis, appendix (T, wrist
programs).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clampid.catalogue import catalogue
from clampid.planning.choose import factors_of, greedy
from clampid.planning.expected import prior_precision
from clampid.planning.logs import LogBench, TorqueNoise
from clampid.planning.program import LogWishes, plan_of_runs
from clampid.planning.sampling import configurations
from clampid.planning.scene import Scene
from clampid.stages.layout import coupled_joints
from clampid.stages.rows import Array
from clampid.standard_sets import ARM_SIDE, LINK_WEIGHT, WRIST
from clampid.threads import single_threaded
from experiments.plans.errors import PlanError
from experiments.plans.limits import Limits, course_of
from experiments.plans.model import Cell, Plan, Run
from experiments.plans.motion import Course
from kinematics.description import RobotDescription

__all__ = ["SWING_STOPS", "Decoupled", "decoupled_motions", "plan_wrist", "swing_directions"]

SWING_STOPS = 5  # stops of each swing, see _knots
CENTRES = 3  # postures about which joints swing
CENTRE_RANGE_SHARE = 0.15  # of a wrist joint's range, about its middle, in which the centres of swings lie
FRICTION_MOVE = 0.12  # rad: the small move that gives dry friction a known sign
FRICTION_MOVE_TIME = 1.2  # s: its least duration, so that a log of 10 Hz shows it clearly
LARGEST_SWING, SMALLEST_SWING = 2.5, 0.2  # rad: amplitudes
AUXILIARY_SPEED_SHARE = 0.5  # of the top speed, for joints that only move to turn the motors of others
SHORT_SWING_SHARE = 0.4
"""Of the largest amplitude. Short swings carry less information in less time; noise is correlated over seconds."""
RANDOM_COMBINATIONS = 3  # for each joint and kind of decoupled motion
LEAST_SPEED_SHARE = 1e-3  # of the fastest joint in a swing: slower joints count as at rest


@dataclass(frozen=True, order=True)
class Decoupled:
    """A decoupled motion of a joint and its motor.

    Attributes
    ----------
    kind
        ``motor``: the motor turns with its joint at rest; ``joint``: the joint moves with its motor at rest.
    joint
        Number of the joint, from 0.
    """

    kind: str
    joint: int

    @property
    def words(self) -> str:
        """The motion in words for people."""
        k = self.joint + 1
        return (
            f"motor {k} turning with joint {k} still"
            if self.kind == "motor"
            else f"joint {k} moving with motor {k} still"
        )


def decoupled_motions(robot: RobotDescription, direction: Array) -> tuple[Decoupled, ...]:
    """The decoupled motions in a motion along ``direction`` ``(n,)``, in joint angles."""
    T = np.asarray(robot.transmission)
    joint = direction / np.max(np.abs(direction))
    motor = joint @ np.linalg.inv(T)
    own = motor * np.abs(np.diag(T))  # motion of each joint by its own motor alone
    still = 1e-9 * np.max(np.abs(own))
    found = []
    for j in coupled_joints(robot):
        if joint[j] == 0.0 and abs(own[j]) > LEAST_SPEED_SHARE:
            found.append(Decoupled("motor", j))
        if abs(own[j]) <= still and abs(joint[j]) > LEAST_SPEED_SHARE:
            found.append(Decoupled("joint", j))
    return tuple(found)


def swing_directions(robot: RobotDescription, rng: np.random.Generator) -> list[Array]:
    """Directions of swings ``(n,)`` in joint angles, with largest entry 1.

    They are single joints, single motors, and random combinations that keep one joint or one motor at rest.
    """
    T, n = np.asarray(robot.transmission), robot.n
    wrist = coupled_joints(robot)
    found = [np.eye(n)[k] for k in wrist] + [T[k] for k in wrist]
    for j in wrist:
        others = [k for k in wrist if k != j]
        for _ in range(RANDOM_COMBINATIONS):
            mix = np.zeros(n)
            mix[others] = rng.standard_normal(len(others))
            found.append(mix)  # joint j is at rest
            found.append((mix / np.abs(np.diag(T))) @ T)  # motor j is at rest
    return [d / np.max(np.abs(d)) for d in found]


@dataclass(frozen=True)
class _Swing:
    """A candidate swing.

    Attributes
    ----------
    centre
        Posture about which the joints swing ``(n,)``, rad.
    reach
        Largest deviation from it ``(n,)``, rad.
    side
        Sign of the small move before the swing, ±1.
    share
        Largest shares of the top speeds of joints and motors ``(n,)``.
    seen
        The decoupled motions in the swing.
    """

    centre: Array
    reach: Array
    side: float
    share: Array
    seen: tuple[Decoupled, ...]


@single_threaded
def plan_wrist(
    cell: Cell,
    limits: Limits,
    noise: TorqueNoise,
    wished: LogWishes | None = None,
    *,
    scene: Scene | None = None,
    assumed: Sequence[str] = (),
) -> Plan:
    """Plan a campaign of wrist logs, with at least one swing for every decoupled motion that the transmission allows.

    The plan states which decoupled motions the transmission does not allow.

    Parameters
    ----------
    cell, limits, noise
        The cell, its limits, and the noise of the torques.
    wished
        Time, speeds, effects and rate that are wanted; by default 600 s.
    scene
        Obstacles; by default the floor only.
    assumed
        Assumptions made so far, in words, for the plan.

    Raises
    ------
    PlanError
        No joint is coupled with another, a number is out of range, the time is too short, or there is no room.
    EffectError
        An effect is unknown.
    """
    wished = wished or LogWishes(time=600.0)
    wished.check()
    speeds = tuple(wished.speeds)
    robot = cell.robot
    wrist = coupled_joints(robot)
    if not wrist:
        known = "couples no joint with another" if robot.transmission_known else "is not known, and taken as uncoupled"
        raise PlanError(
            f"{robot.name}: its transmission {known}: no motor can turn with its joint still, nor a joint with "
            "its motor still, so there is no wrist program; use a log in free air (clampid plan free-air)"
        )
    around = scene or Scene.floor_only(cell)
    asked = tuple(wished.effects) if wished.effects else _standard(robot)
    bench = LogBench(cell, catalogue(), asked, noise, wished.rate, fastest=max(speeds))
    swings = _candidates(cell, limits, around, speeds, np.random.default_rng(wished.seed), wished.seed)
    chosen = _choose(cell, limits, bench, swings, wished.dwell, wished.time)
    runs = tuple(_run(cell, limits, part, wished.dwell) for part in _by_centre([swings[k] for k in chosen]))
    record = wished.record(asked)
    return plan_of_runs(
        "wrist", limits, bench, runs, record, assumed=(*assumed, *around.assumed), impossible=_impossible(robot)
    )


def _standard(robot: RobotDescription) -> tuple[str, ...]:
    """Standard effects of a wrist plan: friction of the coupled joints, and the weights that load them."""
    wrist = coupled_joints(robot)
    names = [f"{kind}@joint{j + 1}" for kind in WRIST for j in wrist]
    return (*names, ARM_SIDE, *(f"{LINK_WEIGHT}@link{k + 1}" for k in range(wrist[0], robot.n)))


def _impossible(robot: RobotDescription) -> tuple[str, ...]:
    """Sentences on the decoupled motions that the transmission does not allow."""
    T, wrist = np.asarray(robot.transmission), coupled_joints(robot)
    back = np.linalg.inv(T).T  # motors by joints
    out = []
    rest = [str(j + 1) for j in range(robot.n) if j not in wrist]
    if rest:
        out.append(
            f"joints {', '.join(rest)}: motor and joint only turn together, so that arm-side friction is not "
            "separable from the motor's"
        )
    for j in wrist:
        others = np.arange(robot.n) != j
        for fact, way in ((Decoupled("motor", j), back[j, others]), (Decoupled("joint", j), T[others, j])):
            if not way.any():
                out.append(f"{fact.words}: the transmission does not allow it")
    return tuple(out)


def _candidates(
    cell: Cell, limits: Limits, scene: Scene, speeds: tuple[float, ...], rng: np.random.Generator, seed: int
) -> list[_Swing]:
    """Candidate swings about a few centres, in all directions and at all speeds, that are free of collisions.

    Raises
    ------
    PlanError
        There are none.
    """
    robot = cell.robot
    wrist = list(coupled_joints(robot))
    lower, upper = limits.lower.copy(), limits.upper.copy()
    middle, half = (lower[wrist] + upper[wrist]) / 2, CENTRE_RANGE_SHARE * (upper[wrist] - lower[wrist]) / 2
    lower[wrist], upper[wrist] = middle - half, middle + half
    near = replace(limits, lower=lower, upper=upper)
    pool = configurations(near, 40, scene.clear, seed, why="clear of floor and obstacles, wrist near its middle")
    room = _with_room(cell, limits, scene, pool)
    found = []
    shares = [np.full(robot.n, share) for share in speeds]
    both = (*np.eye(robot.n), *np.asarray(robot.transmission))  # single joints, single motors
    able = {fact.joint for direction in both for fact in decoupled_motions(robot, direction)}
    auxiliary = [j for j in wrist if j not in able]
    if auxiliary and max(speeds) < AUXILIARY_SPEED_SHARE:
        # A joint that moves through the transmission alone is slow, and creeping motion does not count. So the joints
        # that only turn the motors of others move faster.
        shares.append(np.where(np.isin(np.arange(robot.n), auxiliary), AUXILIARY_SPEED_SHARE, max(speeds)))
    # Signs of the small move before a swing that are free of collisions, for each centre.
    sides = [[side for side in (-1.0, 1.0) if scene.way_clear(c - _away(robot, side), c)] for c in room]
    for direction in swing_directions(robot, rng):
        seen = decoupled_motions(robot, direction)
        for centre, open_sides in zip(room, sides, strict=True):
            reach = _reach(limits, scene, centre, direction)
            if reach is None:
                continue
            for part in (1.0, SHORT_SWING_SHARE):
                if part * np.max(np.abs(reach)) < SMALLEST_SWING:
                    continue
                found += [_Swing(centre, part * reach, side, share, seen) for share in shares for side in open_sides]
    if not found:
        raise PlanError(f"{robot.name}: expected room for wrist swings of {SMALLEST_SWING:g} rad, found none")
    return found


def _with_room(cell: Cell, limits: Limits, scene: Scene, pool: Array) -> list[Array]:
    """The first few postures ``(n,)``, rad, of a pool about which every wrist joint can swing.

    Raises
    ------
    PlanError
        There are none.
    """
    wrist = coupled_joints(cell.robot)
    found = []
    for centre in pool:
        if all(_reach(limits, scene, centre, np.eye(cell.robot.n)[k]) is not None for k in wrist):
            found.append(centre)
        if len(found) == CENTRES:
            return found
    if not found:
        raise PlanError(f"{cell.robot.name}: expected a posture about which every wrist joint can swing, found none")
    return found


def _reach(limits: Limits, scene: Scene, centre: Array, direction: Array) -> Array | None:
    """Largest swing ``(n,)``, rad, along ``direction`` to both sides, free of collisions; None if it is too small."""
    room = np.minimum(limits.upper - centre, centre - limits.lower)
    moves = direction != 0
    amplitude = min(LARGEST_SWING, float(np.min(room[moves] / np.abs(direction[moves]))))
    while amplitude >= SMALLEST_SWING:
        reach = amplitude * direction
        if scene.way_clear(centre - reach, centre + reach):
            return np.asarray(reach)
        amplitude *= 0.7
    return None


def _away(robot: RobotDescription, side: float) -> Array:
    """The small move ``(n,)``, rad, that gives the dry friction of all wrist joints the sign ``side``."""
    away = np.zeros(robot.n)
    away[list(coupled_joints(robot))] = FRICTION_MOVE * side
    return away


def _knots(robot: RobotDescription, swing: _Swing) -> Array:
    """Stops of a swing after its centre ``(5, n)``, rad: before the small move, after it, forward, back, centre."""
    away, c = _away(robot, swing.side), swing.centre
    return np.array([c - away, c, c + swing.reach, c - swing.reach, c])


def _course(cell: Cell, limits: Limits, swing: _Swing, dwell: float) -> Course:
    """The timed course of a swing with stops of ``dwell``, s."""
    knots = np.vstack([swing.centre, _knots(cell.robot, swing)])
    course = course_of(cell.robot, replace(limits, speed=swing.share * limits.speed), knots, dwell=dwell)
    slower = np.ones(len(course.duration))
    slower[:2] = np.maximum(FRICTION_MOVE_TIME / course.duration[:2], 1.0)
    return replace(course, duration=course.duration * slower, ramp=course.ramp * slower)


def _choose(
    cell: Cell, limits: Limits, bench: LogBench, swings: list[_Swing], dwell: float, budget: float
) -> list[int]:
    """Indices of swings: the best one for each decoupled motion, then by information per time within the budget, s.

    Raises
    ------
    PlanError
        The budget does not suffice for every decoupled motion.
    """
    courses = [_course(cell, limits, swing, dwell) for swing in swings]
    size = np.outer(bench.size, bench.size)
    informations = []
    for start in range(0, len(courses), 60):  # logs of a few thousand rows at once
        informations += [t.information.sum(axis=0) * size for t in bench.evaluate(courses[start : start + 60])]
    factors = factors_of(informations)
    cost = np.array([course.length - dwell for course in courses])
    budget -= CENTRES * dwell  # each run begins with one additional stop
    prior = prior_precision(bench.problem) * size
    shown: list[int] = []
    for fact in sorted({f for swing in swings for f in swing.seen}):
        # The most informative swing with this motion, given those already taken.
        if not any(fact in swings[k].seen for k in shown):
            able = [k for k, swing in enumerate(swings) if fact in swing.seen]
            known = prior + sum((informations[k] for k in shown), np.zeros_like(prior))
            picked = greedy(factors[able], known, count=1, cost=cost[able])
            shown.append(able[picked[0] if picked else int(np.argmin(cost[able]))])
    if cost[shown].sum() > budget:
        raise PlanError(
            f"time: expected at least {cost[shown].sum() + CENTRES * dwell:.0f} s, to show once everything that the "
            f"transmission allows, found {budget + CENTRES * dwell:g} s"
        )
    return greedy(factors, prior, cost=cost, budget=budget, start=shown, repeat=True)


def _by_centre(swings: Sequence[_Swing]) -> list[list[_Swing]]:
    """Groups of swings with the same centre, one for each run; slow swings come first."""
    groups: dict[tuple[float, ...], list[_Swing]] = {}
    for swing in swings:
        groups.setdefault(tuple(swing.centre), []).append(swing)
    return [sorted(group, key=lambda swing: float(swing.share.sum())) for group in groups.values()]


def _run(cell: Cell, limits: Limits, swings: Sequence[_Swing], dwell: float) -> Run:
    """The run of some swings with the same centre, one after the other."""
    courses = [_course(cell, limits, swing, dwell) for swing in swings]
    knots = np.vstack([courses[0].knots[:1], *(course.knots[1:] for course in courses)])
    duration, ramp = (np.concatenate([getattr(c, name) for c in courses]) for name in ("duration", "ramp"))
    return Run(Course(knots, duration, ramp, dwell), float(max(swing.share.max() for swing in swings)))
