"""Runs plans in free air: moves at the plan's speeds, and the log of each is on the disk before the next one begins."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from experiments.links.protocol import UNKNOWN_UNIT, Recording
from experiments.plans.errors import PlanError
from experiments.plans.model import Run, table_of
from experiments.runs.context import Block, Context, straight_to
from experiments.runs.robot import LinkedRobot, share_of

__all__ = ["check_torque", "run_logs"]

BACKLOG = 30.0  # s of log that may wait to be fetched before the next motion; more, and rest in between is left out


def run_logs(context: Context) -> str | None:
    """Make the moves that have not been made; returns why it ended early, if enough was known.

    Raises
    ------
    PlanError
        The link does not record, or not in Nm.
    RunStopped, LinkError
        It ended before its end.
    """
    plan, journal = context.plan, context.journal
    check_torque(context.robot)
    table = table_of(plan.kind)[0]
    done = {(entry["run"], entry["move"]) for entry in journal.of("log")}
    total = sum(run.course.length for run in plan.runs)
    spent = 0.0
    for number, run in enumerate(plan.runs, 1):
        moves = len(run.course.duration)
        missing = [move for move in range(1, moves + 1) if (number, move) not in done]
        if missing:
            name = f"run {number} of {len(plan.runs)} at {run.speed_share:.0%} speed"
            _follow(context, run, number, missing, (spent, total), name, table)
        spent += run.course.length
        enough = context.finished(Block(f"run {number}", table, spent / total)) if missing else None
        if enough is not None:
            return enough
    return None


def check_torque(robot: LinkedRobot) -> None:
    """Refuse a link whose torques are not known to be Nm at the motors."""
    can = robot.link.capabilities
    torque = next((signal for signal in can.signals if signal.name == "torque"), None)
    if not can.records or torque is None:
        raise PlanError(f"--link: expected one that records torques, found {can.scheme}, which does not")
    if torque.unit != "Nm" or torque.side != "motor":
        found = "which does not say" if torque.unit == UNKNOWN_UNIT else f"{torque.unit} at the {torque.side}"
        raise PlanError(
            f"--link: expected torques in Nm at the motors, found {can.scheme}, {found}; look the unit of "
            "$TORQUE_AXIS_ACT up and add ?torque=Nm to the address"
        )


def _follow(
    context: Context, run: Run, number: int, missing: list[int], spent: tuple[float, float], name: str, table: str
) -> None:
    robot, course, journal = context.robot, run.course, context.journal
    first = missing[0] - 1
    path = course.knots[first : first + 2]
    if number == 1 or not context.begun:
        straight_to(context, course.knots[first], name, path)
    else:
        robot.go(course.knots[first], run.speed_share, name)
    context.begun = True
    robot.pause(course.dwell)
    following = (robot.next_status().newest or 0) + 1 - math.ceil(course.dwell / _period(robot))
    following = max(following, 1)
    for move in missing:
        context.progress((spent[0] + float(course.starts[move - 1])) / spent[1], f"{name}, move {move}")
        travel = course.knots[move] - course.knots[move - 1]
        share = share_of(robot.robot, travel, float(course.duration[move - 1]), float(course.ramp[move - 1]))
        robot.go(course.knots[move], share, f"{name}, move {move}")
        robot.pause(course.dwell)
        found = robot.samples(following)
        columns = _columns(robot, found, context.plan.rate, number)
        if found.lost is not None:
            gap = f"{name}, move {move}: samples {found.lost[0]} to {found.lost[1]} were lost: a gap in the log"
            journal.add("note", words=gap)
            context.say(gap)
        lost = None if found.lost is None else list(found.lost)
        journal.add("log", table=table, run=number, move=move, columns=columns, lost=lost, share=share)
        following = int(found.number[-1]) + 1
        newest = robot.next_status().newest or 0
        if (newest - following) * _period(robot) > BACKLOG:
            following = newest + 1


def _period(robot: LinkedRobot) -> float:
    """Of the recording, s."""
    signal = next(s for s in robot.link.capabilities.signals if s.name == "torque")
    return signal.period or 0.012


def _columns(robot: LinkedRobot, found: Recording, rate: float, number: int) -> dict[str, list[Any]]:
    """Every so many-th sample, about the plan's rate, as columns: an even clock that goes on from move to move."""
    stride = max(1, round(1.0 / (rate * _period(robot))))
    kept = np.flatnonzero(found.number % stride == 0)
    stamps = [robot.campaign_time(float(t)) for t in found.time[kept]]
    out: dict[str, list[Any]] = {"run": [number] * len(kept), "time_s": [round(t, 4) for t in stamps]}
    out |= {f"q{i + 1}_rad": found.joints[kept, i].tolist() for i in range(found.joints.shape[1])}
    out |= {f"tau{i + 1}_Nm": found.torque[kept, i].tolist() for i in range(found.torque.shape[1])}
    temperature = robot.status().temperature
    if temperature is not None:
        out |= {f"temp_motor{i}_C": [round(float(v), 2)] * len(kept) for i, v in enumerate(temperature, 1)}
    return out
