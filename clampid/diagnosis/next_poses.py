"""The next poses to measure where these cannot tell candidates apart: which, what they bring, and as a plan to run."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pandas as pd

from clampid.diagnosis.next_measurement import ENOUGH, SAME, TEMPERATURES, NextPoses
from clampid.diagnosis.parting import part
from clampid.diagnosis.score import Scored
from clampid.fitting.solve import Estimate
from clampid.planning.sampling import configurations
from clampid.planning.scene import Scene
from clampid.slots import Slot
from clampid.stages.pose_rows import pose_rows
from clampid.stages.rows import Array, Rows
from experiments.campaign import Campaign
from experiments.plans.limits import Limits, course_of, limits_of
from experiments.plans.model import Cell, Plan, Visit
from experiments.plans.validate import validate_plan

__all__ = ["next_poses", "plan_of"]

POOL, BATCH, MOST = 200, 5, 40
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
    wanted = [s for s in rivals if s.freedom]
    cell, limits, _ = _cell(campaign)
    if len(wanted) < 2:
        return None
    rng = np.random.default_rng(seed)
    q = configurations(_inner(limits), POOL, Scene.floor_only(cell).clear, seed, why="clear of the floor")
    direction = rng.choice([-1.0, 1.0], q.shape)
    own = estimate.whitened.jacobian
    now = [s.candidate.columns.dense(len(own)) for s in wanted]
    best: NextPoses | None = None
    for state in ("warm", "cold"):
        nuisance, columns = _imagined_columns(campaign, estimate, wanted, q, direction, state)
        found = part(
            own / scale,
            [D / scale for D in now],
            [s.value for s in wanted],
            estimate.prior_precision / scale**2,
            nuisance / scale,
            [D / scale for D in columns],
            enough=ENOUGH,
            batch=BATCH,
            most=MOST,
        )
        chosen = list(found.chosen)
        new = NextPoses(q[chosen], direction[chosen], state, found.before, found.after)
        if best is None or (new.helps and (not best.helps or len(new.q) < len(best.q))):
            best = new
    return best


def _inner(limits: Limits) -> Limits:
    """Limits within which a pose can be approached from either side."""
    return replace(limits, lower=limits.lower + 1.5 * APPROACH, upper=limits.upper - 1.5 * APPROACH)


def _cell(campaign: Campaign) -> tuple[Cell, Limits, tuple[str, ...]]:
    cell = Cell(
        robot=campaign.robot,
        reference=campaign.robot.name,
        gravity=np.asarray(campaign.gravity, dtype=float),
        tool_mass=campaign.tool.mass,
        tool_com=np.asarray(campaign.tool.com, dtype=float),
        targets=dict(campaign.targets),
        instrument=campaign.instrument.name,
        position_std=campaign.instrument.position_std or 1e-4,
    )
    limits, assumed = limits_of(campaign.robot)
    return cell, limits, assumed


def _reference(campaign: Campaign) -> str:
    """What the campaign calls its robot: a bundled name, or the path of a description of the user's own."""
    header = None if campaign.path is None else campaign.path / "campaign.toml"
    if header is None or not header.is_file():
        return campaign.robot.name
    said = str(tomllib.loads(header.read_text(encoding="utf-8"))["robot"])
    return str(header.parent / said) if Path(said).suffix else said


def _imagined_columns(
    campaign: Campaign, estimate: Estimate, wanted: Sequence[Scored], q: Array, direction: Array, state: str
) -> tuple[Array, list[Array]]:
    """Whitened columns ``(K, r, P)`` and ``(K, r, k)`` each of K poses of all targets that have not been measured."""
    rows = estimate.experiment.rows
    pool = _imagined_rows(campaign, estimate, q, direction, state)
    slots: dict[Slot, float] = {}
    for s in wanted:
        slots |= dict.fromkeys(s.candidate.slots, 0.0) | dict(s.candidate.shapes)
    own = len(estimate.slots)
    trial = estimate.experiment.with_rows(pool).with_slots((*estimate.slots, *slots))
    _, jacobian = trial.residual(np.r_[estimate.theta[:own], list(slots.values())])
    jacobian = jacobian / np.median(estimate.noise.sigma[rows.used.any(axis=1)], axis=0)[:, None]
    count, index = len(q), {slot: own + k for k, slot in enumerate(slots)}
    blocks = jacobian.reshape(count, -1, jacobian.shape[2])
    return blocks[:, :, :own], [blocks[:, :, [index[slot] for slot in s.candidate.slots]] for s in wanted]


def _imagined_rows(campaign: Campaign, estimate: Estimate, q: Array, direction: Array, state: str) -> Rows:
    """Rows of poses that have not been measured, pose by pose all targets, where the model expects the points."""
    rows, frame = estimate.experiment.rows, campaign.tables["poses"].sort_values("time_s")
    targets = list(dict.fromkeys(str(t) for t in frame["target"]))
    like = frame.iloc[[-1 if state == "warm" else 0]]
    table = pd.concat([like] * (len(q) * len(targets)), ignore_index=True)
    pose = np.repeat(np.arange(len(q)), len(targets))
    table["pose"], table["visit"], table["target"] = pose + 1, 1, np.tile(targets, len(q))
    for i in range(campaign.robot.n):
        table[f"q{i + 1}_rad"], table[f"dir{i + 1}"] = q[pose, i], direction[pose, i]
    # Elapsed time counts from the first row of the campaign: the measured table stays beside the imagined one.
    imagined = replace(campaign, tables=MappingProxyType({"poses": frame, "verification": table}))
    base = {int(s): rows.constants["base_reference"][np.flatnonzero(rows.session == s)[0]] for s in rows.session[:1]}
    made = pose_rows([imagined], rows.layout, "verification", base)
    # What depends on the measured point takes the predicted one.
    residual, _ = estimate.experiment.with_rows(made).residual(estimate.theta)
    points = made.measured[:, :3] - residual[:, :3]
    return replace(made, signals={**made.signals, "position": points})


def plan_of(campaign: Campaign, proposed: NextPoses) -> Plan:
    """The poses as a plan that the runner can execute: in an order of short ways, each approached from its side.

    Raises
    ------
    PlanError
        The campaign's robot lets no such motion be.
    """
    cell, limits, assumed = _cell(campaign)
    cell = replace(cell, reference=_reference(campaign))
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
        assumed=(*assumed, f"the robot is {TEMPERATURES[proposed.state]}", "only the floor is in the way"),
        wished={"evidence_before": proposed.before, "evidence_after": proposed.after, "evidence_needed": SAME},
    )
    validate_plan(made, "next poses")
    return made
