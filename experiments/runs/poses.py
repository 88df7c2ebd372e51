"""Runs a plan of poses: every visit is approached as planned, and every target's row is on disk before the next one."""

from __future__ import annotations

from typing import Any

import numpy as np

from experiments.instruments import Instrument, InstrumentError, LineOfSightError, Sample
from experiments.plans.model import Visit
from experiments.plans.motion import Array
from experiments.plans.validate import visit_course
from experiments.runs.context import Block, Context, place_on, straight_to
from experiments.runs.errors import RunStopped
from experiments.runs.robot import ARRIVED, share_of
from experiments.runs.warmth import steady_words

__all__ = ["run_poses"]

READINGS_PER_SECOND = 20.0  # of the plan's time for a point, the rest goes into waiting until it is still
MIN_READINGS, MAX_READINGS = 5, 100  # readings of one target
ANCHOR = "instrument"  # what measured distances are to
PATIENCE = 10.0  # s on top of the plan's time


def run_poses(context: Context) -> str | None:
    """Visit what has not been visited; returns why it ended early, if enough was known.

    Raises
    ------
    RunStopped, LinkError
        It ended before its end.
    """
    plan, journal = context.plan, context.journal
    if context.instrument is None:
        raise RunStopped("poses: expected --instrument, found none")
    _check_targets(context)
    recorded = {tuple(entry["key"]) for what in ("row", "skipped", "passed") for entry in journal.of(what)}
    before = plan.start
    total = sum(visit.length(plan.measure_time) for visit in plan.visits)
    spent = 0.0
    for visit in plan.visits:
        keys = [(visit.table, visit.pose, visit.visit, target) for target in visit.targets or ("",)]
        missing = [key[3] for key in keys if key not in recorded]
        name = f"pose {visit.pose}, visit {visit.visit} ({visit.table})"
        if missing:
            context.progress(spent / total, name)
            _arrive(context, visit, before, name)
            for _ in range(visit.times - 1):
                for to in (visit.via, visit.q):
                    context.robot.go(to, share_of(context.robot.robot, visit.q - visit.via, *_last(visit)), name)
            context.robot.pause(visit.wait)
            if visit.targets:
                _measure(context, visit, missing, name)
            else:
                journal.add("passed", key=keys[0])
        spent += visit.length(plan.measure_time)
        before = visit.q
        if not (missing and visit.targets):
            continue
        enough = context.finished(Block(name, visit.table, spent / total))
        if enough is None and plan.steady is not None:
            enough = steady_words(journal.entries, plan.steady)
        if enough is not None:
            return enough
    return None


def _check_targets(context: Context) -> None:
    wanted = {target for visit in context.plan.visits for target in visit.targets}
    known = () if context.instrument is None else context.instrument.targets
    if missing := sorted(wanted - set(known)):
        raise RunStopped(
            f"instrument: expected targets {', '.join(sorted(wanted))}, found no {', '.join(missing)} among "
            f"{', '.join(known)}"
        )


def _arrive(context: Context, visit: Visit, before: Array | None, name: str) -> None:
    """Come to the pose from the planned side, wherever on the planned way the robot stands."""
    robot = context.robot
    course = visit_course(visit, before)
    here = robot.rest().joints
    stays = before is not None and np.array_equal(before, visit.q) and np.array_equal(visit.via, visit.q)
    if stays and context.begun and np.max(np.abs(here - visit.q)) < ARRIVED:
        return  # a move to where it stands would make it settle anew
    place = place_on(course.knots, here)
    if before is None or place is None:
        if not context.begun or np.max(np.abs(here - visit.via)) > ARRIVED:
            straight_to(context, visit.via, name, course.knots)
    elif place == 0:
        share = share_of(robot.robot, visit.via - before, float(visit.duration[0]), float(visit.ramp[0]))
        robot.go(visit.via, share, name)
    else:
        robot.go(visit.via, share_of(robot.robot, visit.q - visit.via, *_last(visit)), name)
    context.begun = True
    robot.go(visit.q, share_of(robot.robot, visit.q - visit.via, *_last(visit)), name)


def _last(visit: Visit) -> tuple[float, float]:
    return float(visit.duration[1]), float(visit.ramp[1])


def _measure(context: Context, visit: Visit, targets: list[str], name: str) -> None:
    """Measure targets; each row is on the disk before the next one is measured."""
    robot, instrument = context.robot, context.instrument
    if instrument is None:
        raise RunStopped("poses: expected --instrument, found none")
    for target in targets:
        key = [visit.table, visit.pose, visit.visit, target]
        before = robot.next_status()
        try:
            sample = _seen(instrument, target, context.plan.measure_time)
        except LineOfSightError as error:
            context.journal.add("skipped", key=key, why=str(error))
            context.say(f"{name}: {target} is skipped: {error}")
            continue
        except InstrumentError as error:
            raise RunStopped(f"{name}, {target}: {error}") from None
        after = robot.next_status()
        moved = float(np.max(np.abs(after.joints - before.joints)))
        if moved > ARRIVED:
            raise RunStopped(f"{name}, {target}: the robot moved by {moved:.2g} rad while it was measured")
        q = (before.joints + after.joints) / 2
        row: dict[str, Any] = {"pose": visit.pose, "visit": visit.visit, "time_s": robot.now(before)}
        row |= {f"q{i}_rad": float(v) for i, v in enumerate(q, 1)}
        row |= {f"dir{i}": int(v) for i, v in enumerate(visit.direction, 1)}
        table, measured = _measured(visit, sample)
        row |= {"target": target} | measured
        if after.temperature is not None:
            row |= {f"temp_motor{i}_C": round(float(v), 2) for i, v in enumerate(after.temperature, 1)}
        row |= {f"temp_{place}_C": float(v) for place, v in _temperatures(instrument).items()}
        std = [float(v) if np.isfinite(v) else None for v in sample.std_m]
        context.journal.add("row", key=key, table=table, row=row, std_m=std, count=sample.count)


def _seen(instrument: Instrument, target: str, measure_time: float) -> Sample:
    """Measure a target; the instrument looks for it again by itself."""
    count = int(np.clip(round(READINGS_PER_SECOND * measure_time), MIN_READINGS, MAX_READINGS))
    return instrument.measure(target, count, PATIENCE + measure_time)


def _measured(visit: Visit, sample: Sample) -> tuple[str, dict[str, Any]]:
    """Table and columns of a reading: a point, or a distance to the instrument.

    Raises
    ------
    RunStopped
        A distance was measured for verification, which is of points.
    """
    x, *others = (float(v) for v in sample.point_m)
    if np.all(np.isfinite(others)):
        return visit.table, dict(zip(("x_m", "y_m", "z_m"), (x, *others), strict=True))
    if visit.table != "poses":
        raise RunStopped(f"{visit.table}: expected points, found an instrument that measures distances")
    return "distances", {"anchor": ANCHOR, "distance_m": x}


def _temperatures(instrument: Instrument) -> dict[str, float]:
    """Temperatures of the instrument's sensors; a point is kept without them."""
    try:
        return dict(instrument.temperatures())
    except InstrumentError:
        return {}
