"""Plans of the clamping experiment: postures to clamp, joints to drive, amplitudes and numbers of steps.

The gain of a sweep is the information of its rows on springs, clearances and friction, with the unknown clamped posture
eliminated. Its cost is its duration. The wrench on the clamp is computed for every step, with springs stiffer than
described by a margin. A sweep that exceeds a limit is refused here, and stopped when it is run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from clampid.planning.choose import factors_of, greedy, log_det
from clampid.planning.clamping_bench import ClampingBench, cost_of, duration_of
from clampid.planning.expected import expected_of
from clampid.planning.logs import TorqueNoise
from clampid.planning.press import Press
from clampid.planning.sampling import configurations
from clampid.planning.scene import Scene
from clampid.stages.rows import Array
from clampid.standard_sets import STANDARD
from clampid.threads import single_threaded
from experiments.plans.errors import PlanError
from experiments.plans.limits import Limits
from experiments.plans.model import Cell, Plan, Sweep
from experiments.plans.press import SINGULAR, flange_jacobian, holding_torque, wrenches
from experiments.plans.validate import sweep_fault, validate_plan

__all__ = ["ClampingWishes", "careful_limits", "clamping_order", "plan_clamping", "planned_sweep", "postures_for"]


POSTURES = 16  # candidate postures to clamp
POSTURES_TRIED = 600  # configurations from which the candidate postures are chosen
STEPS_PER_QUARTER = (8, 16, 32)  # steps in a quarter of a loop
MAX_SWEEPS = 24  # each sweep adds unknown constants to the fit
MAX_CLAMPINGS = 3
LOOPS_PER_SWEEP = 2
FRICTION_SHARE = 0.15  # of the rated torque: friction and preload of clamping may add this to each motor's reading


@dataclass(frozen=True, eq=False)
class ClampingWishes:
    """The wishes for a plan of clamped sweeps.

    Attributes
    ----------
    time
        Time budget, s, with the time for clamping.
    effects
        Effects whose parameters are to be identified.
    joints
        Numbers of the joints to drive, from 0; None: all.
    postures
        Postures in which the flange can be clamped ``(k, n)``, rad; None: chosen among many.
    seed
        Seed of the candidate postures.
    """

    time: float = 7200.0
    effects: Sequence[str] = STANDARD["clamped"]
    joints: Sequence[int] | None = None
    postures: Array | None = None
    seed: int = 0


@single_threaded
def plan_clamping(
    cell: Cell,
    limits: Limits,
    noise: TorqueNoise,
    press: Press,
    wished: ClampingWishes | None = None,
    *,
    scene: Scene | None = None,
    assumed: Sequence[str] = (),
) -> Plan:
    """Plan a clamping campaign.

    Parameters
    ----------
    cell, limits, noise, press
        The cell, the limits by :func:`~clampid.planning.press.press_limits`, the torque noise, and how hard to press.
    wished
        Which sweeps are wanted.
    scene
        Obstacles; by default the floor only.
    assumed
        Assumptions made so far, in words, for the plan.

    Raises
    ------
    PlanError
        A sweep would exceed a limit in every posture, the time is too short, or a number is out of range.
    EffectError
        An effect is unknown.
    """
    wished = wished or ClampingWishes()
    time, effects = wished.time, wished.effects
    _check(cell, press, time)
    driven = tuple(range(cell.robot.n)) if wished.joints is None else tuple(wished.joints)
    blank = Plan("clamping", cell, limits, 0.0, stiffness=press.margin * press.stiffness)
    around = scene or Scene.floor_only(cell)
    given = wished.postures
    postures = postures_for(cell, limits, around, wished.seed) if given is None else np.asarray(given, dtype=float)
    allowed = _allowed(blank, press, postures, driven)
    best: tuple[float, list[Sweep], Array, int] | None = None
    bench = ClampingBench(cell, noise, press, effects)
    for steps in STEPS_PER_QUARTER:
        sweeps = [planned_sweep(blank, press, posture, joint, steps) for posture, joint in allowed]
        informations = bench.evaluate(sweeps)
        for order in _choices(bench, sweeps, informations, driven, press, time):
            information = np.sum([informations[k] for k in order], axis=0)
            value = log_det(bench.prior + information * bench.scale)
            if best is None or value > best[0]:
                rows = sum(sweeps[k].offset.size for k in order) * cell.robot.n
                best = (value, [sweeps[k] for k in order], information, rows)
    if best is None:
        sweeps = [planned_sweep(blank, press, posture, joint, STEPS_PER_QUARTER[0]) for posture, joint in allowed]
        raise PlanError(_too_short(bench, sweeps, bench.evaluate(sweeps), driven, press, time))
    chosen = clamping_order(best[1])
    plan = replace(
        blank,
        duration=duration_of(chosen, press),
        sweeps=tuple(chosen),
        expected=expected_of(bench.problem, best[2], best[3], noise.words),
        assumed=(
            *assumed,
            *around.assumed,
            f"drives may be {press.margin:g} times as stiff as described; the clamp is set for that",
            f"clamping takes {press.clamping_time:g} s",
        ),
        wished=MappingProxyType(
            {
                "time_s": time,
                "effects": ", ".join(effects),
                "amplitude": ", ".join(f"{a:g}" for a in press.amplitude),
                "seed": wished.seed,
            }
        ),
    )
    validate_plan(plan)
    return plan


def _check(cell: Cell, press: Press, time: float) -> None:
    """Raise :class:`PlanError` for numbers that no plan can have."""
    if not time > 0 or not np.isfinite(time):
        raise PlanError(f"time: expected seconds above 0, found {time:g}")
    if press.amplitude.shape != (cell.robot.n,) or np.any(press.amplitude <= 0) or np.any(press.amplitude > 1):
        raise PlanError(
            f"amplitude: expected one share of the rated torque above 0 and at most 1, or {cell.robot.n}, found "
            f"{press.amplitude.tolist()}"
        )
    if not press.margin >= 1 or not press.dwell > 0 or not press.clamping_time >= 0:
        raise PlanError(
            "expected a stiffness margin of 1 or more, a dwell above 0 s and a clamping time not below 0 s, found "
            f"{press.margin:g}, {press.dwell:g} and {press.clamping_time:g}"
        )
    if cell.robot.n < 6:
        raise PlanError(
            f"{cell.robot.name}: expected six joints or more to bound the wrench on a clamp, found {cell.robot.n}"
        )


def postures_for(cell: Cell, limits: Limits, scene: Scene, seed: int) -> Array:
    """Candidate postures to clamp ``(k, n)``, rad: clear of obstacles, far from singular, far from each other.

    Parameters
    ----------
    cell, limits, scene
        The cell, its limits and its obstacles.
    seed
        Seed of the configurations from which they are chosen.

    Raises
    ------
    PlanError
        There are none.
    """
    q = configurations(limits, POSTURES_TRIED, scene.clear, seed, why="clear of floor and obstacles")
    condition = np.array([np.linalg.cond(flange_jacobian(cell.robot, row)) for row in q])
    good = q[condition < SINGULAR]
    if not len(good):
        raise PlanError(f"{cell.robot.name}: expected postures far from singular, found none among {len(q)}")
    # Postures with little gravity torque first: sweeps from there cross zero torque, and with it the clearance.
    load = holding_torque(cell.robot, good, cell.gravity, cell.tool_mass, cell.tool_com)
    weight = np.max(np.abs(load) / np.array([j.rated_torque or 1.0 for j in cell.robot.joints]), axis=1)
    good = good[np.argsort(weight * condition[condition < SINGULAR])[: 6 * POSTURES]]
    chosen = [good[0]]
    half = (limits.upper - limits.lower) / 2
    while len(chosen) < min(POSTURES, len(good)):
        apart = np.min([np.linalg.norm((good - c) / half, axis=1) for c in chosen], axis=0)
        chosen.append(good[int(np.argmax(apart))])
    return np.array(chosen)


def planned_sweep(blank: Plan, press: Press, posture: Array, joint: int, steps: int) -> Sweep:
    """A sweep of one joint in equal steps: forward, back, beyond and to the start again, twice.

    Parameters
    ----------
    blank
        The plan without sweeps; its ``stiffness`` gives the wrenches on the clamp.
    press
        How hard to press.
    posture
        Clamped posture ``(n,)``, rad.
    joint
        Number of the driven joint, from 0.
    steps
        Steps in a quarter of a loop.
    """
    robot = blank.cell.robot
    turn = np.abs(np.linalg.inv(np.asarray(robot.transmission)).T[joint, joint])  # own motor per joint angle
    reach = press.amplitude[joint] * press.rated[joint] / (press.stiffness[joint] * turn)
    up = np.arange(1, steps + 1) / steps
    offset = np.round(reach * np.tile(np.concatenate([up, 1 - up, -up, up - 1]), LOOPS_PER_SWEEP), 9)
    stiff = blank.stiffness if blank.stiffness is not None else press.stiffness
    _, force, moment = wrenches(robot, stiff, posture, joint, offset)
    return Sweep(1, joint, posture, offset, press.dwell, force, moment)


def _allowed(blank: Plan, press: Press, postures: Array, driven: Sequence[int]) -> list[tuple[Array, int]]:
    """Postures and joints whose sweeps keep the limits.

    Raises
    ------
    PlanError
        A joint has no such posture.
    """
    found = []
    careful = [careful_limits(blank, press, posture) for posture in postures]
    for joint in driven:
        faults = [
            (sweep_fault(plan, planned_sweep(blank, press, posture, joint, STEPS_PER_QUARTER[0])), posture)
            for plan, posture in zip(careful, postures, strict=True)
        ]
        mine = [(p, joint) for fault, p in faults if fault is None]
        if not mine:
            raise PlanError(
                f"joint {joint + 1}: expected a posture in which a sweep to {press.amplitude[joint]:g} of the rated "
                f"torque keeps the limits, less what friction may add, found none among {len(postures)}; in the first, "
                f"{faults[0][0]}; less amplitude or a stronger clamp would do"
            )
        found += mine
    return found


def careful_limits(blank: Plan, press: Press, posture: Array) -> Plan:
    """The plan with its limits reduced by what friction and preload may add to torques and wrench in a posture."""
    limits, ratio = blank.limits, np.abs(np.diag(np.asarray(blank.cell.robot.transmission)))
    n = blank.cell.robot.n
    signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * n)).reshape(n, -1).T
    W = (signs * FRICTION_SHARE * press.rated / ratio) @ np.linalg.pinv(flange_jacobian(blank.cell.robot, posture))
    force, moment = (float(np.linalg.norm(part, axis=1).max()) for part in (W[:, :3], W[:, 3:]))
    torque = press.rated if limits.motor_torque is None else limits.motor_torque
    return replace(
        blank,
        limits=replace(
            limits,
            motor_torque=np.maximum(torque - FRICTION_SHARE * press.rated, 0.0),
            force=max((limits.force or 0.0) - force, 0.0),
            moment=max((limits.moment or 0.0) - moment, 0.0),
        ),
    )


def _choices(
    bench: ClampingBench,
    sweeps: list[Sweep],
    informations: list[Array],
    driven: Sequence[int],
    press: Press,
    time: float,
) -> list[list[int]]:
    """Indices of the best sweeps in one, two and three clampings; only those that fit into ``time``, s."""
    factors = factors_of([matrix * bench.scale for matrix in informations])
    cost = np.array([cost_of(sweep) for sweep in sweeps])
    out = []
    for clampings, taken in _clamped_in_turn(bench, sweeps, informations):
        budget = time - clampings * press.clamping_time
        if budget <= 0:
            break
        first = _each_once(sweeps, factors, bench.prior, taken, driven)
        if first is None or cost[first].sum() > budget:
            continue
        inside = np.array(taken)
        start = [taken.index(k) for k in first]
        picked = greedy(
            factors[inside], bench.prior, count=MAX_SWEEPS, cost=cost[inside], budget=budget, start=start, repeat=True
        )
        out.append([int(inside[k]) for k in picked])
    return out


def _clamped_in_turn(
    bench: ClampingBench, sweeps: list[Sweep], informations: list[Array]
) -> Iterator[tuple[int, list[int]]]:
    """One, two and three clampings, each with the indices of all sweeps that can be made in them."""
    groups: dict[tuple[float, ...], list[int]] = {}
    for k, sweep in enumerate(sweeps):
        groups.setdefault(tuple(sweep.posture), []).append(k)
    taken: list[int] = []
    for clampings in range(1, min(MAX_CLAMPINGS, len(groups)) + 1):
        known = bench.prior + sum((informations[k] * bench.scale for k in taken), np.zeros_like(bench.prior))
        # The next clamping is the one whose sweeps together add most information to that of the earlier clampings.
        best = max(groups, key=lambda g: log_det(known + sum(informations[k] * bench.scale for k in groups[g])))
        taken = [*taken, *groups.pop(best)]
        yield clampings, taken


def _too_short(
    bench: ClampingBench,
    sweeps: list[Sweep],
    informations: list[Array],
    driven: Sequence[int],
    press: Press,
    time: float,
) -> str:
    """The message of an error: number of clampings, and time, s, that it takes to drive each joint once."""
    for clampings, taken in _clamped_in_turn(bench, sweeps, informations):
        able = {sweeps[k].joint: cost_of(sweeps[k]) for k in taken}
        if set(driven) <= able.keys():
            need = clampings * press.clamping_time + sum(able[j] for j in driven)
            many = "one clamping" if clampings == 1 else f"{clampings} clampings"
            return f"time: expected at least {need:.0f} s, for {many} and a sweep of each joint, found {time:g} s"
    return (
        f"expected at most {MAX_CLAMPINGS} postures in which every joint may be driven within the limits, found none; "
        "less amplitude or a stronger clamp would do"
    )


def _each_once(
    sweeps: list[Sweep], factors: Array, prior: Array, among: list[int], driven: Sequence[int]
) -> list[int] | None:
    """Indices of the most informative sweep of each joint; None if a joint cannot be driven in any posture."""
    first = []
    for joint in driven:
        able = [k for k in among if sweeps[k].joint == joint]
        if not able:
            return None
        gain = [log_det(prior + factors[k] @ factors[k].T) for k in able]
        first.append(able[int(np.argmax(gain))])
    return first


def clamping_order(sweeps: Sequence[Sweep]) -> list[Sweep]:
    """The sweeps with numbers of their clampings, in order of clampings and then of the wrench on the clamp.

    The sweeps with the largest wrench come last: if the clamp slips, most sweeps have been measured.
    """
    postures = list(dict.fromkeys(tuple(sweep.posture) for sweep in sweeps))
    numbered = [replace(sweep, clamping=postures.index(tuple(sweep.posture)) + 1) for sweep in sweeps]
    return sorted(numbered, key=lambda s: (s.clamping, float(s.force.max() + s.moment.max()), s.joint))
