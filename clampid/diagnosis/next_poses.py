"""The next poses to measure where these cannot distinguish candidates: which, what they bring, and as a plan to run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from weakref import WeakKeyDictionary

import numpy as np

from clampid.diagnosis.next_measurement import COOLING, SAME, STATES, TEMPERATURES, NextPlan, NextPoses
from clampid.diagnosis.pools import Pool, cell_of
from clampid.diagnosis.propose import propose_parting
from clampid.evidence.candidates import Candidate
from clampid.evidence.score import Scored
from clampid.fitting.solve import Estimate
from clampid.planning.sampling import configurations
from clampid.planning.scene import Scene
from clampid.slots import Slot
from clampid.stages.pose_rows import pose_rows
from clampid.stages.rows import Array, Rows
from experiments.campaign import Campaign
from experiments.plans.limits import Limits, course_of
from experiments.plans.model import Plan, Visit
from experiments.plans.validate import validate_plan

__all__ = ["next_poses", "plan_of", "poses_of", "poses_to_choose"]

POOL, BATCH, MAX_POSES = 1000, 5, 40
WIDENED = 1.5  # times the ranges: of these, a third of each joint's angles fall to the ends of its range
APPROACH = 0.05  # rad (m): the last move of every joint to a pose
MEASURE_TIME = 3.0  # s for each point


def next_poses(
    campaign: Campaign, estimate: Estimate, rivals: Sequence[Scored], scale: float, seed: int
) -> NextPoses | None:
    """Choose poses that part candidates; None where none of them has a size, or there is no pose to choose from.

    Parameters
    ----------
    scale
        Standard deviation of the whitened residual.
    """
    found = propose_parting(partial(poses_to_choose, campaign, estimate, seed=seed), estimate, rivals, scale, STATES)
    return None if found is None else poses_of(campaign, found, seed)


def poses_of(campaign: Campaign, found: NextPlan, seed: int) -> NextPoses:
    """The poses of a proposal."""
    q, direction = _choices_of(campaign, seed)
    chosen = list(found.chosen)
    return NextPoses(q[chosen], direction[chosen], found.state, found.before, found.after)


def poses_to_choose(
    campaign: Campaign, estimate: Estimate, candidates: Sequence[Candidate], state: str, seed: int
) -> Pool:
    """Poses that could be measured next, each from a side, the robot ``warm`` or ``cold``."""
    q, direction = _choices_of(campaign, seed)
    nuisance, columns = _imagined_columns(campaign, estimate, candidates, q, direction, state)

    def plan(chosen: Sequence[int], wished: dict[str, float | int | str]) -> Plan:
        mine = list(chosen)
        return plan_of(campaign, NextPoses(q[mine], direction[mine], state, 0.0, 0.0), wished)

    def words(chosen: Sequence[int]) -> str:
        mine = q[list(chosen)]
        spans = (f"q{j + 1} {a:.0f} to {b:.0f}" for j, (a, b) in enumerate(np.degrees([mine.min(0), mine.max(0)]).T))
        return f"{', '.join(spans)} degrees; {TEMPERATURES[state]}"

    return Pool(nuisance, tuple(columns), np.ones(len(q)), ("pose", "poses"), BATCH, MAX_POSES, words, plan)


_drawn: WeakKeyDictionary[Campaign, dict[int, tuple[Array, Array]]] = WeakKeyDictionary()


def _choices_of(campaign: Campaign, seed: int) -> tuple[Array, Array]:
    """As `_choices`, drawn once for a campaign: both states and every pair of candidates choose from the same poses."""
    drawn = _drawn.setdefault(campaign, {})
    if seed not in drawn:
        drawn[seed] = _choices(campaign, seed)
        for array in drawn[seed]:
            array.flags.writeable = False
    return drawn[seed]


def _choices(campaign: Campaign, seed: int) -> tuple[Array, Array]:
    """Poses ``(K, n)``, rad, and the sides from which their joints come ``(K, n)``, ±1.

    Two of three lie inside the ranges. The others are drawn from wider ranges and moved to the ends where they lie
    outside: what distinguishes two models best often lies there (Atkinson & Fedorov 1975).
    """
    cell, limits, _ = cell_of(campaign)
    inner, scene = _inner(limits), Scene.floor_only(cell)

    def ended(q: Array) -> Array:
        return np.clip(q, inner.lower, inner.upper)

    half = (WIDENED - 1.0) / 2.0 * (inner.upper - inner.lower)
    wide = replace(inner, lower=inner.lower - half, upper=inner.upper + half)
    at_ends = ended(configurations(wide, POOL // 3, lambda q: scene.clear(ended(q)), seed, why="clear of the floor"))
    inside = configurations(inner, POOL - len(at_ends), scene.clear, seed, why="clear of the floor")
    q = np.vstack([inside, at_ends])
    return q, np.random.default_rng(seed).choice([-1.0, 1.0], q.shape)


def _inner(limits: Limits) -> Limits:
    """Limits within which a pose can be approached from either side."""
    return replace(limits, lower=limits.lower + 1.5 * APPROACH, upper=limits.upper - 1.5 * APPROACH)


def _imagined_columns(
    campaign: Campaign, estimate: Estimate, wanted: Sequence[Candidate], q: Array, direction: Array, state: str
) -> tuple[Array, list[Array]]:
    """Whitened columns ``(K, r, P)`` and ``(K, r, k)`` each of K poses of all targets that have not been measured."""
    rows = estimate.problem.rows
    pool = _imagined_rows(campaign, estimate, q, direction, state)
    slots: dict[Slot, float] = {}
    for c in wanted:
        slots |= dict.fromkeys(c.slots, 0.0) | dict(c.shapes)
    own = len(estimate.slots)
    trial = estimate.problem.with_rows(pool).with_slots((*estimate.slots, *slots))
    _, jacobian = trial.residual(np.r_[estimate.theta[:own], list(slots.values())])
    sigma = estimate.noise.sigma[rows.used.any(axis=1) & ~rows.ranged, : jacobian.shape[1]]
    jacobian = jacobian / np.median(sigma, axis=0)[:, None]
    count, index = len(q), {slot: own + k for k, slot in enumerate(slots)}
    blocks = jacobian.reshape(count, -1, jacobian.shape[2])
    return blocks[:, :, :own], [blocks[:, :, [index[slot] for slot in c.slots]] for c in wanted]


def _imagined_rows(campaign: Campaign, estimate: Estimate, q: Array, direction: Array, state: str) -> Rows:
    """Rows of poses that have not been measured, pose by pose all targets, where the model expects the points."""
    rows, frame = estimate.problem.rows, campaign.tables["poses"].sort_values("time_s")
    targets = list(dict.fromkeys(str(t) for t in frame["target"]))
    like = frame.iloc[[-1 if state == "warm" else 0]]
    table = like.iloc[np.zeros(len(q) * len(targets), dtype=int)].reset_index(drop=True)
    if state == "cold":  # after these, and a rest: temperatures are those of the start, the time is not
        table["time_s"] = float(frame["time_s"].iloc[-1]) + COOLING
    pose = np.repeat(np.arange(len(q)), len(targets))
    table["pose"], table["visit"], table["target"] = pose + 1, 1, np.tile(targets, len(q))
    for i in range(campaign.robot.n):
        table[f"q{i + 1}_rad"], table[f"dir{i + 1}"] = q[pose, i], direction[pose, i]
    # Elapsed time counts from the first row of the campaign: the measured table stays beside the imagined one.
    imagined = replace(campaign, tables=MappingProxyType({"poses": frame, "verification": table}))
    base = {int(s): rows.pose.base_reference[np.flatnonzero(rows.session == s)[0]] for s in rows.session[:1]}
    made = pose_rows([imagined], rows.layout, "verification", base)
    # What depends on the measured point takes the predicted one.
    residual, _ = estimate.problem.with_rows(made).residual(estimate.theta)
    points = made.measured[:, :3] - residual[:, :3]
    return replace(made, signals={**made.signals, "position": points})


def plan_of(campaign: Campaign, proposed: NextPoses, wished: Mapping[str, float | int | str] | None = None) -> Plan:
    """The poses as a plan that the runner can execute: in an order of short ways, each approached from its side.

    Raises
    ------
    PlanError
        The campaign's robot lets no such motion be.
    """
    cell, limits, assumed = cell_of(campaign)
    known = {"evidence_before": proposed.before, "evidence_after": proposed.after, "evidence_needed": SAME}
    order, left = [0], list(range(1, len(proposed.q)))
    while left:
        order.append(min(left, key=lambda k: float(np.max(np.abs(proposed.q[k] - proposed.q[order[-1]])))))
        left.remove(order[-1])
    visits, before = [], None
    for number, k in enumerate(order, 1):
        to = proposed.q[k]
        via = to - APPROACH * proposed.direction[k]
        course = course_of(cell.robot, limits, np.array([via if before is None else before, via, to]))
        targets = tuple(cell.targets) or ("flange",)
        visits.append(Visit("poses", number, 1, via, to, course.duration, course.ramp, targets))
        before = to
    moving = sum(float(v.duration.sum()) + MEASURE_TIME * len(v.targets) for v in visits)
    made = Plan(
        kind="poses",
        cell=cell,
        limits=limits,
        duration=moving,
        visits=tuple(visits),
        measure_time=MEASURE_TIME,
        assumed=(*assumed, f"the robot is {TEMPERATURES[proposed.state]}", "the floor is the only obstacle"),
        wished=known if wished is None else dict(wished),
    )
    validate_plan(made, "next poses")
    return made
