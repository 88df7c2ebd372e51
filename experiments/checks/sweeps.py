"""Checks each sweep of a clamped robot: whether the joint was loaded, and whether the clamp held the flange.

A driven motor's torque is friction, which depends on the direction, plus the spring, which depends on the angle. A line
with a step between the two directions is fitted to the rows on which friction has built up. Its slope is the stiffness.
If the slope is below a twentieth of the described stiffness (or of the joint's own in other sweeps), and the joint
moved farther than any clearance, the arm was free.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from experiments.campaign import Campaign
from experiments.checks.finding import Finding
from experiments.columns import joint_columns
from experiments.signals.typing_ import Array

__all__ = ["sweep_findings"]

MIN_ROWS = 12  # rows that a line with a step may be judged on
# Worn gears have clearances of arc minutes; a joint that turns by twice this without a spring torque is free.
WIDEST_GAP_RAD = 2e-3
# Fixtures and worn drives have been found several times as soft as described, never twenty times.
SOFT = 0.05
# Standard errors by which the spring's part of a sweep's torque is significant.
CERTAIN_SLOPE = 4.0


@dataclass(frozen=True)
class _Slope:
    """Torque per motor angle [Nm/rad] with its standard error, how far the motor went [rad], and the noise [Nm]."""

    value: float
    std: float
    travel: float
    noise: float


def sweep_findings(campaign: Campaign) -> Iterator[Finding]:
    """Look at every sweep of the table ``clamped``.

    Parameters
    ----------
    campaign
        The campaign; its angles are in the right unit and on the right side of the gears.

    Yields
    ------
    Finding
        An error for a sweep in free motion, a warning for one that does not load its joint.
    """
    frame, robot = campaign.tables["clamped"], campaign.robot
    motor = frame[list(joint_columns("motor{}_rad", robot.n))].to_numpy(dtype=np.float64)
    torque = frame[list(joint_columns("tau{}_Nm", robot.n))].to_numpy(dtype=np.float64)
    sweep, joint = frame["sweep"].to_numpy(), frame["joint"].to_numpy() - 1
    slopes: dict[int, tuple[int, int, _Slope]] = {}
    for number in np.unique(sweep):
        rows = np.flatnonzero(sweep == number)
        j = int(joint[rows[0]])
        slope = _slope(motor[rows, j], torque[rows, j])
        if slope is not None and np.all(joint[rows] == j):
            slopes[int(number)] = (j, int(rows[0]) + 1, slope)
    for number, (j, row, slope) in slopes.items():
        others = [
            s.value for n, (k, _, s) in slopes.items() if k == j and n != number and s.value > CERTAIN_SLOPE * s.std
        ]
        described = None if robot.motor_spring is None else float(robot.motor_spring[j])
        expected = float(np.median(others)) if others else described
        ratio = abs(float(robot.transmission[j, j]))
        finding = _judge(number, j, slope, expected, ratio)
        if finding is not None:
            severity, message = finding
            yield Finding("error" if severity == "free" else "warning", "clamped", f"tau{j + 1}_Nm", row, message)


def _judge(number: int, joint: int, slope: _Slope, expected: float | None, ratio: float) -> tuple[str, str] | None:
    """What is wrong with a sweep: ``free`` or ``idle``, and in words; None for a sweep that loads its joint."""
    wound = slope.value * slope.travel
    far = slope.travel * ratio
    if expected is not None and far > 2 * WIDEST_GAP_RAD and slope.value + CERTAIN_SLOPE * slope.std < SOFT * expected:
        return "free", (
            f"in sweep {number}, joint {joint + 1} moves freely: it turns by {far:.2g} rad, and apart from friction "
            f"its motor's torque changes by {max(slope.value, 0.0):.2g} Nm/rad, where a clamped arm's would by "
            f"{expected:.3g} Nm/rad: the clamp was open; leave the sweep out, or measure it again"
        )
    if slope.value <= CERTAIN_SLOPE * slope.std:
        return "idle", (
            f"sweep {number} never loads joint {joint + 1}: apart from friction its motor's torque changes by "
            f"{abs(wound):.2g} Nm over the sweep, its noise is {slope.noise:.2g} Nm; its spring cannot be identified"
        )
    return None


def _slope(angle: Array, torque: Array) -> _Slope | None:
    """Fit a line with a step between the directions to a driven motor's torque; None if there are too few rows."""
    step = np.diff(angle, prepend=angle[:1])
    if len(step) > 1:
        step[0] = step[1]
    moving = np.abs(step) > 0.0
    sign = np.sign(step)
    settled = moving & np.r_[True, sign[1:] == sign[:-1]]  # on the first step back friction only builds up
    if settled.sum() < MIN_ROWS or np.ptp(angle[settled]) == 0.0:
        return None
    columns = [np.ones(int(settled.sum())), angle[settled] - angle[settled].mean()]
    if np.ptp(sign[settled]) > 0:
        columns.append(sign[settled])
    A = np.column_stack(columns)
    found, _, rank, _ = np.linalg.lstsq(A, torque[settled], rcond=None)
    if rank < A.shape[1]:
        return None
    residual = torque[settled] - A @ found
    noise = float(np.sqrt(residual @ residual / max(len(residual) - A.shape[1], 1)))
    # Torques follow each other closely: the noise of neighbours is shared, and a slope less certain by that.
    memory = float(residual[1:] @ residual[:-1]) / max(float(residual @ residual), 1e-300)
    memory = min(max(memory, 0.0), 0.9)
    spread = noise * np.sqrt(np.linalg.inv(A.T @ A)[1, 1] * (1 + memory) / (1 - memory))
    return _Slope(float(found[1]), float(spread), float(np.ptp(angle[settled])), noise)
