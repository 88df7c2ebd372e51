"""Checks of a request before anything is solved: postures, directions, temperatures, arms.

For the coordinates themselves see :func:`offline_ik.cell.coordinates.check_target`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from kinematics.robot import RobotDescription
from offline_ik.cell.cell_values import COLDEST, HOTTEST
from offline_ik.errors import DetectorError, TargetError

__all__ = ["check_arm", "check_directions", "check_posture", "check_temperatures"]

Array = npt.NDArray[np.float64]


def check_arm(robot: RobotDescription) -> None:
    """Refuse an arm that cannot hold a detector at any orientation, or whose joints have no turns."""
    if robot.n < 6:
        raise DetectorError(f"{robot.name}: expected an arm of at least six joints, found {robot.n}")
    for joint in robot.joints:
        if joint.kind != "revolute":
            raise DetectorError(f"{robot.name}: expected revolute joints only, found {joint.name}, {joint.kind}")


def check_directions(joints: int, values: Sequence[float] | Array) -> Array:
    """Directions ``(n,)`` in which joints come to rest: 1 towards larger angles, -1 smaller, 0 not said.

    Raises
    ------
    TargetError
        They are not as many, or other numbers.
    """
    found = np.asarray(np.nan if isinstance(values, str) else values, dtype=float)
    if found.shape != (joints,) or not np.isin(found, (-1.0, 0.0, 1.0)).all():
        given = values if isinstance(values, str) else found.tolist()
        raise TargetError(f"direction: expected {joints} numbers 1, -1 or 0, one of each joint, found {given}")
    return found


def check_posture(joints: int, q: Sequence[float] | Array, what: str) -> Array:
    """A posture ``(n,)``, rad; ``what`` names it.

    Raises
    ------
    TargetError
        Not as many finite numbers as there are joints, or far beyond any limits (degrees?).
    """
    found = np.asarray(q, dtype=float)
    if found.shape != (joints,):
        raise TargetError(f"{what}: expected {joints} joint angles, found {found.tolist()}")
    values = found.tolist()
    if not all(map(math.isfinite, values)):
        raise TargetError(f"{what}: expected {joints} finite joint angles, found {values}")
    if max(map(abs, values)) > 3 * math.pi:
        raise TargetError(f"{what}: expected joint angles in radians, found {values}; are these degrees?")
    return found


def check_temperatures(joints: int, values: Sequence[float] | Array, what: str) -> Array:
    """Temperatures ``(n,)`` of links or motors, degC; ``what`` names them.

    Raises
    ------
    TargetError
        They are not as many, not finite, or no robot's (kelvin?).
    """
    found = np.asarray(values, dtype=float)
    if found.shape != (joints,) or not ((found > COLDEST) & (found < HOTTEST)).all():
        raise TargetError(
            f"{what}: expected {joints} temperatures in degC, at most {HOTTEST:g}, found {found.tolist()}"
        )
    return found
