"""Judges whether angles are radians, on the right side of the gears, and within the robot's limits."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from experiments.campaign import Campaign
from experiments.checks.finding import Finding, joint_list
from experiments.columns import joint_columns

__all__ = ["angle_findings", "joint_angles"]

FloatArray = npt.NDArray[np.float64]

# A controller stops a joint at its limits. Angles of twice the limit are in another unit.
REACH_FACTOR = 2.0
# One row may be a glitch of the log; a wrong unit shows wherever the joint is away from zero.
MANY_ROWS = 0.05
# Degrees, turned into radians, lie within the limits; the margin lets limits of another variant of the robot differ.
LIMIT_MARGIN = 1.1
# Limits are printed in whole degrees, and controllers report a joint at its stop a little beyond it.
LIMIT_SLACK_RAD = 1e-3
# Gears of robots reduce 30 to 250 times. If joint angles stood in motor columns, every joint would lie within this of
# zero in every posture. No clamped arm is measured stretched out like that in all load cases.
TINY_RAD = 0.1
# No robot's joint turns farther from zero than two revolutions. Angles within that may be another robot's radians.
MOST_TURNED_RAD = 4.0 * np.pi


def joint_angles(campaign: Campaign, table: str) -> FloatArray:
    """Joint angles of a table, through the ideal transmission where it holds motor angles.

    Parameters
    ----------
    campaign
        The campaign.
    table
        A table that it has.

    Returns
    -------
    ndarray, shape (rows, n)
        [rad]; of ``clamped`` only meaningful where the robot's transmission is known.
    """
    robot, frame = campaign.robot, campaign.tables[table]
    if table != "clamped":
        return frame[list(joint_columns("q{}_rad", robot.n))].to_numpy(dtype=np.float64)
    motor = frame[list(joint_columns("motor{}_rad", robot.n))].to_numpy(dtype=np.float64)
    return motor @ robot.transmission  # rows of q = Tᵀ·motor


def angle_findings(campaign: Campaign) -> Iterator[Finding]:
    """Look at every table's angles.

    Parameters
    ----------
    campaign
        The campaign.

    Yields
    ------
    Finding
        Errors for other units, warnings for angles beyond the limits.
    """
    for table in campaign.tables:
        if table == "clamped" and not campaign.robot.transmission_known:
            message = (
                f"the transmission of {campaign.robot.name} is not known, so that motor angles do not give the arm's "
                "posture; clamped sweeps cannot be used"
            )
            yield Finding("warning", table, joint_columns("motor{}_rad", 1)[0], None, message)
            continue
        q = joint_angles(campaign, table)
        found = _motor_side(campaign, table) or _wrong_unit(campaign, table, q)
        if found:
            yield found
        else:
            yield from _beyond_limits(campaign, table, q)


def _reach(campaign: Campaign) -> FloatArray:
    """Farthest that each joint turns either way (n,) [rad]; infinite for joints that have no unit of angle to check."""
    robot = campaign.robot
    turning = np.array([joint.kind != "prismatic" for joint in robot.joints])
    return np.where(turning, np.maximum(np.abs(robot.lower), np.abs(robot.upper)), np.inf)


def _wrong_unit(campaign: Campaign, table: str, q: FloatArray) -> Finding | None:
    robot, reach = campaign.robot, _reach(campaign)
    share = np.mean(np.abs(q) > REACH_FACTOR * reach, axis=0)  # (n,)
    far = [int(i) + 1 for i in np.flatnonzero(share > MANY_ROWS)]
    if not far:
        return None
    pattern = "motor{}_rad" if table == "clamped" else "q{}_rad"
    column = pattern.format(far[0])
    # The rows that are far out in any joint: the unit is judged on those, and a glitch elsewhere does not decide.
    bounded = np.isfinite(reach)
    typical = np.quantile(np.abs(q), 0.95, axis=0)
    largest = f"{joint_list(far)} beyond twice the limits in up to {share.max():.0%} of the rows, e.g. "
    largest += f"{typical[far[0] - 1]:.4g} against {reach[far[0] - 1]:.4g} rad"
    turned = float(typical[bounded].max(initial=0.0))
    may_be_radians = turned <= MOST_TURNED_RAD
    if not may_be_radians and np.all(np.deg2rad(typical[bounded]) <= LIMIT_MARGIN * reach[bounded]):
        what = "motor angles, taken through the transmission," if table == "clamped" else "joint angles"
        return Finding("error", table, column, None, f"{what} look like degrees, radians are expected: {largest}")
    through = np.quantile(np.abs(q @ robot.transmission), 0.95, axis=0)
    geared = table != "clamped" and robot.transmission_known and not may_be_radians
    if geared and np.all(through[bounded] <= LIMIT_MARGIN * reach[bounded]):
        message = f"these look like motor angles, joint angles are expected: {largest}"
        return Finding("error", table, column, None, message)
    message = f"these angles do not fit {robot.name}: {largest}; is it another robot's data, or are they degrees?"
    return Finding("error", table, column, None, message)


def _motor_side(campaign: Campaign, table: str) -> Finding | None:
    """Joint angles given where motor angles are expected: within the joints' limits, and nothing after the gears."""
    if table != "clamped":
        return None
    robot = campaign.robot
    motor = campaign.tables[table][list(joint_columns("motor{}_rad", robot.n))].to_numpy(dtype=np.float64)
    within = np.all(np.abs(motor) <= LIMIT_MARGIN * _reach(campaign))
    tiny = np.max(np.abs(motor @ robot.transmission)) < TINY_RAD
    geared = np.max(np.abs(np.diag(robot.transmission))) < 0.2
    if not (within and tiny and geared and np.max(np.abs(motor)) > TINY_RAD):
        return None
    message = (
        "these look like joint angles, motor angles are expected: all are within the joints' limits, and through the "
        f"transmission no joint would be more than {np.rad2deg(TINY_RAD):.0f}° from zero in any sweep"
    )
    return Finding("error", table, "motor1_rad", None, message)


def _beyond_limits(campaign: Campaign, table: str, q: FloatArray) -> Iterator[Finding]:
    robot = campaign.robot
    beyond = (q < robot.lower - LIMIT_SLACK_RAD) | (q > robot.upper + LIMIT_SLACK_RAD)
    pattern = "motor{}_rad" if table == "clamped" else "q{}_rad"
    for i in np.flatnonzero(beyond.any(axis=0)):
        rows = np.flatnonzero(beyond[:, i])
        message = (
            f"joint {i + 1} is beyond its limits ({robot.lower[i]:.4g} … {robot.upper[i]:.4g} rad) in {rows.size} of "
            f"{len(q)} rows, first in row {rows[0] + 1} with {q[rows[0], i]:.4g} rad"
        )
        yield Finding("warning", table, pattern.format(i + 1), int(rows[0]) + 1, message)
