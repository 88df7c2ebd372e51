"""Holds a plan against its own limits, step by step: ranges, speeds, accelerations, torques, the load on the clamp."""

from __future__ import annotations

import numpy as np

from experiments.plans.errors import PlanError
from experiments.plans.limits import Limits, motion_faults
from experiments.plans.model import Plan, Sweep, Visit
from experiments.plans.motion import Array, Course
from experiments.plans.press import holding_torque, wrenches

__all__ = ["sweep_fault", "validate_plan"]

ROUND = 1e-6  # relative: rounding of a printed number


def validate_plan(plan: Plan, where: str = "plan") -> None:
    """Check every step.

    Raises
    ------
    PlanError
        The first step that is beyond a limit; ``where`` is put before the message.
    """
    limits = plan.limits
    if np.any(limits.lower >= limits.upper):
        j = int(np.argmax(limits.lower >= limits.upper))
        raise PlanError(
            f"{where}, [limits]: joint {j + 1}: expected a lower limit below the upper one, found "
            f"{limits.lower[j]:g} and {limits.upper[j]:g} rad"
        )
    for number, run in enumerate(plan.runs, 1):
        fault = motion_faults(plan.cell.robot, limits, run.course)
        if fault:
            raise PlanError(f"{where}, run {number}, {fault}")
    for number, sweep in enumerate(plan.sweeps, 1):
        fault = sweep_fault(plan, sweep)
        if fault:
            raise PlanError(f"{where}, sweep {number}, {fault}")
    _refuse_moved_clamp(plan, where)
    before = plan.start
    for number, visit in enumerate(plan.visits, 1):
        if visit.times > 1 and visit.targets:
            raise PlanError(f"{where}, visit {number}: expected no targets of {visit.times} swings, found some")
        fault = motion_faults(plan.cell.robot, limits, visit_course(visit, before))
        if fault:
            raise PlanError(f"{where}, visit {number}, {fault}")
        before = visit.q
    _refuse_repeated(plan, where)


def visit_course(visit: Visit, before: Array | None) -> Course:
    """The two moves of a visit: to where it is approached from, and to the pose; one, if it is the first of all."""
    if before is None:
        return Course(np.array([visit.via, visit.q]), visit.duration[1:], visit.ramp[1:], 0.0)
    return Course(np.array([before, visit.via, visit.q]), visit.duration, visit.ramp, 0.0)


def sweep_fault(plan: Plan, sweep: Sweep) -> str | None:
    """The first step of a sweep that exceeds a limit, in words, or None."""
    limits, robot = plan.limits, plan.cell.robot
    if plan.stiffness is None or limits.motor_torque is None or limits.force is None or limits.moment is None:
        return (
            "expected stiffness_Nm_rad, and in [limits] motor_torque_Nm, force_N and moment_Nm, which bound the load "
            "on the clamp, found not all of them"
        )
    fault = _out_of_range(limits, sweep.posture)
    if fault:
        return fault
    load = holding_torque(robot, sweep.posture, plan.cell.gravity, plan.cell.tool_mass, plan.cell.tool_com)
    tau, force, moment = wrenches(robot, plan.stiffness, sweep.posture, sweep.joint, sweep.offset)
    motor = np.abs(tau + load @ np.asarray(robot.transmission).T)
    for step in range(len(sweep.offset)):
        for found, limit, what, unit in (
            (force[step], limits.force, "force on the clamp", "N"),
            (moment[step], limits.moment, "moment on the clamp", "Nm"),
            *((motor[step, i], limits.motor_torque[i], f"torque of motor {i + 1}", "Nm") for i in range(robot.n)),
        ):
            if found > limit * (1 + ROUND):
                return f"step {step + 1}: {what}: expected at most {limit:.6g} {unit}, found {found:.6g} {unit}"
        for stated, found, what in ((sweep.force, force, "force_N"), (sweep.moment, moment, "moment_Nm")):
            if abs(stated[step] - found[step]) > 1e-3 + ROUND * found[step]:
                return f"step {step + 1}: key {what}: expected {found[step]:.3f}, which follows from the offset, found {stated[step]:.3f}"  # noqa: E501
    return None


def _out_of_range(limits: Limits, q: Array) -> str | None:
    for j in range(len(q)):
        if not limits.lower[j] - ROUND <= q[j] <= limits.upper[j] + ROUND:
            return f"joint {j + 1}: expected {limits.lower[j]:.6g} to {limits.upper[j]:.6g} rad, found {q[j]:.6g} rad"
    return None


def _refuse_moved_clamp(plan: Plan, where: str) -> None:
    """One clamping has one posture, and clampings come one after the other."""
    posture: dict[int, Array] = {}
    last = 0
    for number, sweep in enumerate(plan.sweeps, 1):
        if sweep.clamping < last:
            raise PlanError(f"{where}, sweep {number}: expected clamping {last} or later, found {sweep.clamping}")
        last = sweep.clamping
        if not np.array_equal(posture.setdefault(last, sweep.posture), sweep.posture):
            raise PlanError(
                f"{where}, sweep {number}: expected the posture of the other sweeps of clamping {last}, found another"
            )


def _refuse_repeated(plan: Plan, where: str) -> None:
    seen: dict[tuple[str, int, int], int] = {}
    place: dict[tuple[str, int], Array] = {}
    for number, visit in enumerate(plan.visits, 1):
        key = (visit.table, visit.pose, visit.visit)
        if key in seen:
            raise PlanError(
                f"{where}, visit {number}: expected another number of the visit, found visit {visit.visit} of pose "
                f"{visit.pose} in {visit.table} again (it is visit {seen[key]} of the plan too)"
            )
        seen[key] = number
        if not np.array_equal(place.setdefault(key[:2], visit.q), visit.q):
            raise PlanError(
                f"{where}, visit {number}: expected the angles of the other visits of pose {visit.pose}, found others"
            )
