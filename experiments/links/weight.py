"""Checks the unit of a link's torques by the robot's own weight.

At rest the drives hold the arm against gravity. With τ the torque by the description's masses and y what the link gives
at several postures, each axis that bears weight is fitted by ::

    y = k·τ + c        (c: friction and whatever does not depend on the posture)

k is 1 if the unit is right. Errors of the described masses and friction at rest change k by less than a factor of two.
The wrong side of the gears, or per cent, changes it by more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinematics.gravity import STANDARD_GRAVITY, add_tool, gravity_parameters, gravity_regressor
from kinematics.masses import links_of
from kinematics.robot import RobotDescription

__all__ = ["WeightCheck", "check_torque_unit"]

Array = npt.NDArray[np.float64]

FACTOR = 2.0
FEWEST_POSTURES = 4
LEAST_SPREAD = 0.2  # of an axis's largest torque by weight: what its postures have to differ by
LEAST_CORRELATION = 0.8


@dataclass(frozen=True)
class WeightCheck:
    """What the torques of a link are, by the robot's own weight.

    Attributes
    ----------
    unit
        ``Nm``, or None where it is another or cannot be said.
    side
        ``motor`` or ``gear``, where the unit is Nm.
    motor_slope, gear_slope
        k by axis, against torques of motors and of gears; nan where the axis carries no weight.
    words
        One sentence for a person.
    """

    unit: str | None
    side: str | None
    motor_slope: Array
    gear_slope: Array
    words: str


def check_torque_unit(
    robot: RobotDescription,
    joints: npt.ArrayLike,
    torques: npt.ArrayLike,
    tool_mass: float = 0.0,
    tool_com: npt.ArrayLike = (0.0, 0.0, 0.0),
    gravity: npt.ArrayLike = STANDARD_GRAVITY,
) -> WeightCheck:
    """
    Compare torques at rest with those of the robot's weight.

    Parameters
    ----------
    robot
        Its masses and transmission; assumed masses will do, if the description has none.
    joints
        Postures at rest ``(m, n)``, rad, best approached from both sides.
    torques
        What the link gave there ``(m, n)``, in its unit.
    tool_mass, tool_com
        Of what the flange carries, kg and m in the flange frame.
    gravity
        ``(3,)`` in the base frame, m/s².

    Returns
    -------
    WeightCheck
        What they are.

    Raises
    ------
    ValueError
        There are too few postures, or gravity differs too little between them.
    """
    q, y = np.atleast_2d(np.asarray(joints, dtype=np.float64)), np.atleast_2d(np.asarray(torques, dtype=np.float64))
    if q.shape != y.shape or q.shape[1] != robot.n or len(q) < FEWEST_POSTURES:
        raise ValueError(
            f"weight: expected joints and torques ({FEWEST_POSTURES} or more, {robot.n}), found {q.shape} and {y.shape}"
        )
    phi = add_tool(gravity_parameters(links_of(robot)), robot.flange, tool_mass, tool_com)
    gear = np.asarray(gravity_regressor(robot.screws, q @ robot.linkage.T, gravity) @ phi) @ robot.linkage
    motor = gear @ robot.transmission.T
    motor_slope, gear_slope = _slopes(motor, y), _slopes(gear, y)
    loaded = np.isfinite(motor_slope) & np.isfinite(gear_slope)
    if not loaded.any():
        raise ValueError("weight: expected postures in which gravity loads an axis differently, found none that do")
    for side, slope in (("motor", motor_slope), ("gear", gear_slope)):
        if np.all((slope[loaded] > 1 / FACTOR) & (slope[loaded] < FACTOR)):
            found = ", ".join(f"{k:.2f}" for k in slope[loaded])
            return WeightCheck("Nm", side, motor_slope, gear_slope, f"Nm at the {side}: {found} of the robot's weight")
    axes = " and ".join(str(k + 1) for k in np.flatnonzero(loaded))
    values = ", ".join(f"{1 / k:.3g}" for k in motor_slope[loaded])
    words = f"not Nm: by the robot's weight one unit is {values} Nm of the motor at axis {axes}"
    return WeightCheck(None, None, motor_slope, gear_slope, words)


def _slopes(weight: Array, y: Array) -> Array:
    """K by axis; nan where gravity hardly changes, or where what is measured does not follow it."""
    out = np.full(weight.shape[1], math.nan)
    largest = np.abs(weight).max()
    for axis in range(weight.shape[1]):
        x, z = weight[:, axis] - weight[:, axis].mean(), y[:, axis] - y[:, axis].mean()
        if np.ptp(x) < LEAST_SPREAD * largest or not np.ptp(z) > 0:
            continue
        if abs(float(np.corrcoef(x, z)[0, 1])) >= LEAST_CORRELATION:
            out[axis] = float(x @ z / (x @ x))
    return out
