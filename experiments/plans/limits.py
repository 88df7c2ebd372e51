"""What a plan must stay within: joint ranges, speeds and accelerations, motor torques, the load on a clamp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.plans.errors import PlanError
from experiments.plans.motion import Array, Course, peak_rates, shortest
from kinematics.description import RobotDescription

__all__ = ["Limits", "course_of", "limits_of", "motion_faults"]

HALF_TURN = np.pi  # rad, range of a joint whose description has no limit
RAMP_TIME = 0.5  # s to the top speed, where no acceleration is known
SPEED = 1.0  # rad/s, where no speed is known
ROUND = 1e-9  # relative: rounding of a printed number


@dataclass(frozen=True)
class Limits:
    """Limits of one plan, SI.

    Attributes
    ----------
    lower, upper
        Joint angles ``(n,)``, rad (m for a prismatic joint).
    speed, acceleration
        ``(n,)``, rad/s and rad/s².
    motor_torque
        ``(n,)``, Nm at the motor shafts; only plans for a clamped robot have it.
    force, moment
        N and Nm on the clamp, of the vectors about the flange's origin; only for a clamped robot.
    """

    lower: Array
    upper: Array
    speed: Array
    acceleration: Array
    motor_torque: Array | None = None
    force: float | None = None
    moment: float | None = None


def limits_of(
    robot: RobotDescription, *, share: float = 0.95, acceleration: Sequence[float] | float | None = None
) -> tuple[Limits, tuple[str, ...]]:
    """The limits that the description gives, and in words what had to be assumed.

    Parameters
    ----------
    share
        How much of each joint's range is used, about its middle, 0 … 1.
    acceleration
        rad/s², one for all joints or one each; by default every joint reaches its top speed in half a second.

    Raises
    ------
    PlanError
        A number is out of range, or the limits leave a joint no way to go.
    """
    if not 0.0 < share <= 1.0:
        raise PlanError(f"share of the joint ranges: expected above 0 and at most 1, found {share:g}")
    assumed = []
    lower, upper = np.array(robot.lower), np.array(robot.upper)
    for i in np.flatnonzero(~np.isfinite(lower) | ~np.isfinite(upper)):
        assumed.append(f"joint {i + 1} has no limits in the description: half a turn either way is used")
        lower[i], upper[i] = -HALF_TURN, HALF_TURN
    speed = np.array([SPEED if j.max_speed is None else j.max_speed for j in robot.joints])
    unknown = [str(i + 1) for i, j in enumerate(robot.joints) if j.max_speed is None]
    if unknown:
        assumed.append(f"no top speed is known of joints {', '.join(unknown)}: {SPEED:g} rad/s is used")
    if acceleration is None:
        given = speed / RAMP_TIME
        assumed.append(f"no acceleration is known: every joint reaches its top speed in {RAMP_TIME:g} s")
    else:
        given = np.broadcast_to(np.asarray(acceleration, dtype=float), (robot.n,)).copy()
        if not np.all(np.isfinite(given)) or np.any(given <= 0):
            raise PlanError(f"acceleration: expected numbers above 0, found {given.tolist()}")
    middle, half = (lower + upper) / 2, share * (upper - lower) / 2
    if np.any(half <= 0):
        raise PlanError(f"joint {int(np.argmin(half)) + 1}: its limits leave it no way to go")
    return Limits(middle - half, middle + half, speed, given), tuple(assumed)


def course_of(
    robot: RobotDescription, limits: Limits, knots: Array, *, speed_share: float = 1.0, dwell: float = 1.0
) -> Course:
    """The fastest course through ``knots`` ``(m + 1, n)`` at a share of the top speeds, motors' limits kept as well.

    A motor's top speed is what its own joint's is, taken through the transmission: coupled motors turn faster.
    """
    travel, speed, acceleration = _both_sides(robot, limits, np.diff(knots, axis=0))
    duration, ramp = shortest(travel, speed_share * speed, acceleration)
    return Course(np.asarray(knots, dtype=float), duration, ramp, dwell)


def _both_sides(robot: RobotDescription, limits: Limits, travel: Array) -> tuple[Array, Array, Array]:
    T = np.asarray(robot.transmission)
    ratio = np.abs(np.diag(T))
    motors = travel @ np.linalg.inv(T)
    return (
        np.concatenate([travel, motors], axis=-1),
        np.concatenate([limits.speed, limits.speed / ratio]),
        np.concatenate([limits.acceleration, limits.acceleration / ratio]),
    )


def motion_faults(robot: RobotDescription, limits: Limits, course: Course) -> str | None:
    """The first thing in a course that the limits do not allow, in words, or None."""
    slack = ROUND * np.maximum(1.0, np.abs(limits.upper) + np.abs(limits.lower))
    for i, q in enumerate(course.knots):
        for j in range(robot.n):
            if not limits.lower[j] - slack[j] <= q[j] <= limits.upper[j] + slack[j]:
                where = f"{limits.lower[j]:.6g} to {limits.upper[j]:.6g} rad"
                return f"stop {i}: joint {j + 1}: expected {where}, found {q[j]:.6g} rad"
    travel, speed, acceleration = _both_sides(robot, limits, np.diff(course.knots, axis=0))
    bad = (course.ramp <= 0) | (course.duration < 2 * course.ramp * (1 - ROUND))
    if bad.any():
        i = int(np.argmax(bad))
        return (
            f"move {i + 1}: expected a ramp above 0 s and at most half of the duration, found {course.ramp[i]:.6g} s "
            f"of {course.duration[i]:.6g} s"
        )
    rates = peak_rates(travel, course.duration, course.ramp)
    for found, limit, unit in zip(rates, (speed, acceleration), ("rad/s", "rad/s^2"), strict=True):
        over = found > limit * (1 + 1e-6)
        if over.any():
            i, k = (int(v) for v in np.argwhere(over)[0])
            who = f"joint {k + 1}" if k < robot.n else f"motor {k - robot.n + 1}"
            return f"move {i + 1}: {who}: expected at most {limit[k]:.6g} {unit}, found {found[i, k]:.6g} {unit}"
    return None
