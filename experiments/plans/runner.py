"""Runs a plan: step by step on a robot, each step's rows kept as soon as they are there, so that a run can be resumed.

While a plan runs, its rows lie in ``.CAMPAIGN.run`` beside the campaign's folder, which itself appears only when the
plan is done. Running the same plan to the same folder again goes on after the last step that was finished.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from experiments.campaign import write_campaign
from experiments.outputs import new_file, write_text
from experiments.plans.errors import PlanError, PlanStopped
from experiments.plans.model import Plan, Run, Sweep, Visit, table_of
from experiments.plans.motion import Course
from experiments.plans.press import flange_jacobian, holding_torque, wrench
from experiments.plans.seam import RobotSeam
from experiments.plans.validate import validate_plan, visit_course
from experiments.plans.write import plan_text

__all__ = ["run_plan", "work_folder"]

BETWEEN_S = 1.0  # s between the clocks of two sessions of one campaign; the true gap was not logged
Stop = Callable[[], bool]
Step = tuple[str, str, Callable[[], pd.DataFrame]]  # what it is, its table, and how to do it


def work_folder(folder: str | Path) -> Path:
    """Where the rows of an unfinished run lie."""
    path = Path(folder).resolve()
    return path.with_name(f".{path.name}.run")


def run_plan(
    plan: Plan,
    robot: RobotSeam,
    folder: str | Path,
    *,
    stop: Stop = lambda: False,
    progress: Callable[[str], None] = lambda text: None,
    file_format: Literal["csv", "parquet"] = "parquet",
) -> Path:
    """Run a plan and write the campaign; go on where an earlier call was stopped.

    Parameters
    ----------
    plan
        What to do; it is checked against its own limits once more.
    robot
        Who does it.
    folder
        The campaign; new or empty.
    stop
        Asked before every step, and before every single step against the clamp; True ends the run.
    progress
        Gets a line before each step.
    file_format
        How the campaign's tables are stored.

    Returns
    -------
    pathlib.Path
        The campaign folder.

    Raises
    ------
    PlanError
        The plan is beyond its limits, or the folder holds something else.
    PlanStopped
        It was stopped, or a reading at the clamp was beyond a limit; finished steps are kept.
    """
    validate_plan(plan)
    target, work = Path(folder).resolve(), work_folder(folder)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise PlanError(f"{folder}: expected a new or empty folder, found something there")
    _open_work(plan, work, folder)
    done: list[tuple[str, pd.DataFrame]] = []
    fresh = False  # whether a step of this session has been done
    steps = list(_steps(plan, robot, stop))
    for number, (what, table, do) in enumerate(steps, 1):
        file = work / f"{number:05d}.parquet"
        if file.is_file():
            done.append((table, pd.read_parquet(file)))
            continue
        if stop():
            raise PlanStopped(f"stopped before {what} ({number} of {len(steps)}); the same call goes on from there")
        progress(f"{what} ({number} of {len(steps)})")
        rows = do()
        if not fresh:
            shift = _shift([frame for _, frame in done], rows)
            fresh = True
        rows["time_s"] = rows["time_s"] + shift
        with new_file(file) as unfinished:
            rows.to_parquet(unfinished, index=False)
        done.append((table, rows))
    tables = {
        name: pd.concat([f for t, f in done if t == name], ignore_index=True)
        for name in dict.fromkeys(t for t, _ in done)
    }
    path = write_campaign(target, _header(plan, robot, target), tables, file_format)
    shutil.rmtree(work)
    return path


def _open_work(plan: Plan, work: Path, folder: str | Path) -> None:
    """Make the work folder, or take over the one that this very plan left."""
    text = plan_text(plan, work)
    mark, copy = hashlib.sha256(text.encode()).hexdigest(), work / "plan.toml"
    if copy.is_file() and hashlib.sha256(copy.read_bytes()).hexdigest() != mark:
        raise PlanError(
            f"{folder}: expected the plan whose run was stopped (a copy is {copy}), found another; finish that one, or "
            f"remove {work}"
        )
    work.mkdir(parents=True, exist_ok=True)
    if not copy.is_file():
        write_text(copy, text)


def _shift(before: list[pd.DataFrame], first: pd.DataFrame) -> float:
    """By how much, s, this session's clock is put on so that the campaign's goes on."""
    last = max((float(frame["time_s"].max()) for frame in before), default=-np.inf)
    start = float(first["time_s"].min())
    return 0.0 if start > last else last + BETWEEN_S - start


def _steps(plan: Plan, robot: RobotSeam, stop: Stop) -> Iterator[Step]:
    """Every step of a plan, in order; nothing is done until it is called."""
    for number, run in enumerate(plan.runs, 1):
        yield f"run {number}", table_of(plan.kind)[0], partial(_log, robot, run, plan.rate, number)
    clamp = _Clamp(plan, robot, stop)
    for number, sweep in enumerate(plan.sweeps, 1):
        yield f"sweep {number}", "clamped", partial(clamp.sweep, sweep, number)
    before = plan.start
    for visit in plan.visits:
        what = f"pose {visit.pose}, visit {visit.visit} ({visit.table})"
        if not visit.targets:
            raise PlanError(f"{what}: expected targets, found a visit that only moves; clampid run does those")
        yield what, visit.table, partial(_visit, robot, visit, visit_course(visit, before), plan.measure_time)
        before = visit.q


def _log(robot: RobotSeam, run: Run, rate: float, number: int) -> pd.DataFrame:
    return _first(robot.log(run.course, rate), run=number)


def _visit(robot: RobotSeam, visit: Visit, course: Course, measure_time: float) -> pd.DataFrame:
    return _first(robot.visit(course, visit.targets, measure_time), pose=visit.pose, visit=visit.visit)


def _first(frame: pd.DataFrame, **numbers: int) -> pd.DataFrame:
    """The table with numbering columns before its own."""
    out = frame.copy()
    for place, (name, value) in enumerate(numbers.items()):
        out.insert(place, name, value)
    return out


class _Clamp:
    """Sweeps of a clamped robot; every reading is checked against the limits before the next step is taken."""

    def __init__(self, plan: Plan, robot: RobotSeam, stop: Stop) -> None:
        self.plan, self.robot, self.stop = plan, robot, stop
        self.clamping = 0

    def sweep(self, sweep: Sweep, number: int) -> pd.DataFrame:
        if sweep.clamping != self.clamping:
            if self.clamping:
                self.robot.release()
            self.robot.clamp(sweep.posture)
            self.clamping = sweep.clamping
        rows: list[dict[str, float]] = []
        readings = self.robot.press(sweep.joint, sweep.offset, sweep.dwell)
        for step in range(1, len(sweep.offset) + 1):
            if self.stop():
                self._leave()
                raise PlanStopped(
                    f"stopped in sweep {number} before step {step}; the same call starts that sweep again"
                )
            reading = next(readings, None)
            if reading is None:
                self._leave()
                raise PlanStopped(f"sweep {number}: expected {len(sweep.offset)} readings, found {step - 1}")
            fault = self._fault(sweep, reading)
            if fault:
                self._leave()
                raise PlanStopped(f"sweep {number}, step {step}: {fault}; the drives were unwound")
            rows.append(dict(reading))
        if number == len(self.plan.sweeps):
            self._leave()
        return _first(pd.DataFrame(rows), sweep=number, joint=sweep.joint + 1)

    def _leave(self) -> None:
        self.robot.release()
        self.clamping = 0

    def _fault(self, sweep: Sweep, reading: Any) -> str | None:
        """What a reading exceeds, in words, or None. Friction counts as load: that errs on the safe side."""
        cell, limits = self.plan.cell, self.plan.limits
        n = cell.robot.n
        tau = np.array([reading[f"tau{i + 1}_Nm"] for i in range(n)])
        if not np.all(np.isfinite(tau)):
            return f"expected torques, found {tau.tolist()}"
        load = holding_torque(cell.robot, sweep.posture, cell.gravity, cell.tool_mass, cell.tool_com)
        W = wrench(cell.robot, flange_jacobian(cell.robot, sweep.posture), load, tau[None])[0]
        for found, limit, what, unit in (
            (float(np.linalg.norm(W[:3])), limits.force, "force on the clamp", "N"),
            (float(np.linalg.norm(W[3:])), limits.moment, "moment on the clamp", "Nm"),
            *(
                (abs(tau[i]), limits.motor_torque[i], f"torque of motor {i + 1}", "Nm")
                for i in range(n)
                if limits.motor_torque is not None
            ),
        ):
            if limit is not None and found > limit:
                return f"{what}: expected at most {limit:.6g} {unit}, measured {found:.6g} {unit}"
        return None


def _header(plan: Plan, robot: RobotSeam, target: Path) -> dict[str, Any]:
    """``campaign.toml``: what the cell declares, else what the plan was made for."""
    cell = plan.cell
    reference = cell.reference
    if Path(reference).suffix:
        reference = os.path.relpath(Path(reference).resolve(), target)
    header: dict[str, Any] = {
        "robot": reference,
        "gravity_m_s2": cell.gravity,
        "tool": {"mass_kg": cell.tool_mass, "com_m": cell.tool_com},
        "targets_m": dict(cell.targets),
        "instrument": {"name": cell.instrument, "position_std_m": cell.position_std},
    }
    return header | {k: v for k, v in robot.declared().items() if k in header and k != "robot"}
