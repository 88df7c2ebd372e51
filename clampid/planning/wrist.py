"""Plans the wrist: swings designed from T in which a motor turns while its joint stands still, and the reverse.

With θ_joint = Tᵀ θ_motor, joint j stands still while its motor turns wherever the others move so that q_j = 0 and
(T⁻ᵀ q)_j ≠ 0; joint j moves with its motor still wherever m_j = 0 and (Tᵀ m)_j ≠ 0. Only there can friction on the
arm's side be distinguished from the motor's own. Before each swing all wrist joints are moved a little to one side, so
that the sign of the dry friction of a standing joint is known. Source: the thesis, appendix (T, wrist programs).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clampid.catalogue import catalogue
from clampid.planning.choose import factor, greedy
from clampid.planning.expected import prior_precision
from clampid.planning.logs import LogBench, TorqueNoise
from clampid.planning.program import LogWishes, finished_program
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

__all__ = ["SWING_STOPS", "Fact", "directions", "facts", "plan_wrist"]

SWING_STOPS = 5  # of each swing, see _knots
CENTRES = 3
CENTRED = 0.15  # of the range: how far from the middle a wrist joint may be at the centre of a swing
SETTING = 0.12  # rad: the small move that puts dry friction on a known side
SEEN_S = 1.2  # s, at least, that it takes: a log of 10 Hz must show it without doubt
LARGEST_SWING = 2.5  # rad, of a swing
SMALLEST = 0.2
BRISK = 0.5  # share of its top speed for a joint that only serves to turn the others' motors
SHORT_SWING_SHARE = 0.4
"""Of the room, for swings that are worth less but take less time: noise is correlated for seconds."""
COMBINED = 3  # random combinations per joint and kind
LEAST_SHARE_OF_SPEED = 1e-3  # of the fastest in a swing: less is no motion to learn from


@dataclass(frozen=True, order=True)
class Fact:
    """What a swing shows of joint ``joint`` (from 0): its motor turns while it stands still, or the reverse."""

    kind: str
    joint: int

    @property
    def words(self) -> str:
        """For people."""
        k = self.joint + 1
        return (
            f"motor {k} turning with joint {k} still"
            if self.kind == "motor"
            else f"joint {k} moving with motor {k} still"
        )


def facts(robot: RobotDescription, direction: Array) -> tuple[Fact, ...]:
    """What a motion along ``direction`` ``(n,)``, in joint angles, shows."""
    T = np.asarray(robot.transmission)
    joint = direction / np.max(np.abs(direction))
    motor = joint @ np.linalg.inv(T)
    own = motor * np.abs(np.diag(T))  # what each motor would turn its own joint by
    still = 1e-9 * np.max(np.abs(own))
    found = []
    for j in coupled_joints(robot):
        if joint[j] == 0.0 and abs(own[j]) > LEAST_SHARE_OF_SPEED:
            found.append(Fact("motor", j))
        if abs(own[j]) <= still and abs(joint[j]) > LEAST_SHARE_OF_SPEED:
            found.append(Fact("joint", j))
    return tuple(found)


def directions(robot: RobotDescription, rng: np.random.Generator) -> list[Array]:
    """Directions of swings, joint angles ``(n,)``: single joints, single motors, combinations that keep one still."""
    T, n = np.asarray(robot.transmission), robot.n
    wrist = coupled_joints(robot)
    found = [np.eye(n)[k] for k in wrist] + [T[k] for k in wrist]
    for j in wrist:
        others = [k for k in wrist if k != j]
        for _ in range(COMBINED):
            mix = np.zeros(n)
            mix[others] = rng.standard_normal(len(others))
            found.append(mix)  # joint j stands still
            found.append((mix / np.abs(np.diag(T))) @ T)  # motor j does
    return [d / np.max(np.abs(d)) for d in found]


@dataclass(frozen=True)
class _Swing:
    """One candidate: about ``centre`` ``(n,)`` by ``reach`` ``(n,)``, rad, friction set to ``side``.

    ``share`` ``(n,)`` of the joints' and their motors' top speeds is not exceeded.
    """

    centre: Array
    reach: Array
    side: float
    share: Array
    seen: tuple[Fact, ...]


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
    """Plan a wrist campaign; parameters as in `clampid.planning.free_air.plan_free_air`, in 600 s by default.

    Every fact that the transmission allows is shown by at least one swing; what it does not allow is said.

    Raises
    ------
    PlanError
        No joint is coupled with another, a number is out of range, the time is too short, or there is no room.
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
    return finished_program(
        "wrist", limits, bench, runs, record, assumed=(*assumed, *around.assumed), impossible=_impossible(robot)
    )


def _standard(robot: RobotDescription) -> tuple[str, ...]:
    """Friction of the coupled joints, and the gravity that acts in them."""
    wrist = coupled_joints(robot)
    names = [f"{kind}@joint{j + 1}" for kind in WRIST for j in wrist]
    return (*names, ARM_SIDE, *(f"{LINK_WEIGHT}@link{k + 1}" for k in range(wrist[0], robot.n)))


def _impossible(robot: RobotDescription) -> tuple[str, ...]:
    """What the transmission does not allow, in words."""
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
        for fact, way in ((Fact("motor", j), back[j, others]), (Fact("joint", j), T[others, j])):
            if not way.any():
                out.append(f"{fact.words}: the transmission does not allow it")
    return tuple(out)


def _candidates(
    cell: Cell, limits: Limits, scene: Scene, speeds: tuple[float, ...], rng: np.random.Generator, seed: int
) -> list[_Swing]:
    robot = cell.robot
    wrist = list(coupled_joints(robot))
    lower, upper = limits.lower.copy(), limits.upper.copy()
    middle, half = (lower[wrist] + upper[wrist]) / 2, CENTRED * (upper[wrist] - lower[wrist]) / 2
    lower[wrist], upper[wrist] = middle - half, middle + half
    near = replace(limits, lower=lower, upper=upper)
    pool = configurations(near, 40, scene.clear, seed, why="clear of floor and obstacles, wrist near its middle")
    room = _with_room(cell, limits, scene, pool)
    found = []
    shares = [np.full(robot.n, share) for share in speeds]
    both = (*np.eye(robot.n), *np.asarray(robot.transmission))  # single joints, single motors
    able = {fact.joint for direction in both for fact in facts(robot, direction)}
    servants = [j for j in wrist if j not in able]
    if servants and max(speeds) < BRISK:
        # What follows through the transmission is slow, and creeping says nothing: those that only serve go faster.
        shares.append(np.where(np.isin(np.arange(robot.n), servants), BRISK, max(speeds)))
    # From each side from which friction can be set without touching anything.
    sides = [[side for side in (-1.0, 1.0) if scene.way_clear(c - _away(robot, side), c)] for c in room]
    for direction in directions(robot, rng):
        seen = facts(robot, direction)
        for centre, open_sides in zip(room, sides, strict=True):
            reach = _reach(limits, scene, centre, direction)
            if reach is None:
                continue
            for part in (1.0, SHORT_SWING_SHARE):
                if part * np.max(np.abs(reach)) < SMALLEST:
                    continue
                found += [_Swing(centre, part * reach, side, share, seen) for share in shares for side in open_sides]
    if not found:
        raise PlanError(f"{robot.name}: expected room for wrist swings of {SMALLEST:g} rad, found none")
    return found


def _with_room(cell: Cell, limits: Limits, scene: Scene, pool: Array) -> list[Array]:
    """The first few centres about which every wrist joint can swing."""
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
    """How far a swing can go along a direction both ways ``(n,)``, rad, without touching anything; None: too little."""
    room = np.minimum(limits.upper - centre, centre - limits.lower)
    moves = direction != 0
    amplitude = min(LARGEST_SWING, float(np.min(room[moves] / np.abs(direction[moves]))))
    while amplitude >= SMALLEST:
        reach = amplitude * direction
        if scene.way_clear(centre - reach, centre + reach):
            return np.asarray(reach)
        amplitude *= 0.7
    return None


def _away(robot: RobotDescription, side: float) -> Array:
    """From where friction is set to a side, as seen from a swing's centre ``(n,)``, rad."""
    away = np.zeros(robot.n)
    away[list(coupled_joints(robot))] = SETTING * side
    return away


def _knots(robot: RobotDescription, swing: _Swing) -> Array:
    """Stops of a swing after its centre: friction set to a side, forward, back, and to the centre again ``(5, n)``."""
    away, c = _away(robot, swing.side), swing.centre
    return np.array([c - away, c, c + swing.reach, c - swing.reach, c])


def _course(cell: Cell, limits: Limits, swing: _Swing, dwell: float) -> Course:
    knots = np.vstack([swing.centre, _knots(cell.robot, swing)])
    course = course_of(cell.robot, replace(limits, speed=swing.share * limits.speed), knots, dwell=dwell)
    slower = np.ones(len(course.duration))
    slower[:2] = np.maximum(SEEN_S / course.duration[:2], 1.0)
    return replace(course, duration=course.duration * slower, ramp=course.ramp * slower)


def _choose(
    cell: Cell, limits: Limits, bench: LogBench, swings: list[_Swing], dwell: float, budget: float
) -> list[int]:
    courses = [_course(cell, limits, swing, dwell) for swing in swings]
    size = np.outer(bench.size, bench.size)
    informations = []
    for start in range(0, len(courses), 60):  # logs of a few thousand rows at once
        informations += [t.information.sum(axis=0) * size for t in bench.evaluate(courses[start : start + 60])]
    parts = [factor(matrix) for matrix in informations]
    factors = np.zeros((len(parts), len(bench.size), max(p.shape[1] for p in parts)))
    for k, part in enumerate(parts):
        factors[k, :, : part.shape[1]] = part
    cost = np.array([course.length - dwell for course in courses])
    budget -= CENTRES * dwell  # each run begins with one stop more
    prior = prior_precision(bench.problem) * size
    shown: list[int] = []
    for fact in sorted({f for swing in swings for f in swing.seen}):
        # The best swing for a fact, given those already taken.
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
    """Swings that share a centre make a run, slow ones first."""
    groups: dict[tuple[float, ...], list[_Swing]] = {}
    for swing in swings:
        groups.setdefault(tuple(swing.centre), []).append(swing)
    return [sorted(group, key=lambda swing: float(swing.share.sum())) for group in groups.values()]


def _run(cell: Cell, limits: Limits, swings: Sequence[_Swing], dwell: float) -> Run:
    courses = [_course(cell, limits, swing, dwell) for swing in swings]
    knots = np.vstack([courses[0].knots[:1], *(course.knots[1:] for course in courses)])
    duration, ramp = (np.concatenate([getattr(c, name) for c in courses]) for name in ("duration", "ramp"))
    return Run(Course(knots, duration, ramp, dwell), float(max(swing.share.max() for swing in swings)))
