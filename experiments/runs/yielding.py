"""The shift of the flange from the torques of standing motors, and the direction in which a driven joint pushes it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from experiments.plans.motion import Array
from experiments.plans.press import motor_torques, wrench
from kinematics.description import RobotDescription

__all__ = ["flange_shift", "push_of"]

USUAL = 1e-4  # m along each axis; wrist torques alone would leave an axis open


def flange_shift(
    torque: Array,
    error: Array,
    motors: npt.NDArray[np.int64],
    robot: RobotDescription,
    stiffness: Array,
    jacobian: Array,
) -> Array:
    """Shift ``(..., 3)``, m, that adds torques ``(..., s)``, Nm, to standing motors, if the flange does not turn.

    Least squares with a usual size as prior, ``error`` ``(s,)`` Nm, with springs as described.
    """
    wound = np.asarray(-np.linalg.pinv(jacobian)[:, :3].T, dtype=np.float64)
    each = motor_torques(robot, stiffness, np.zeros(robot.n), wound)[:, motors].T  # (s, 3) Nm/m
    design = np.vstack([each / error[:, None], np.eye(3) / USUAL])
    seen = np.atleast_2d(torque / error)
    found = np.linalg.lstsq(design, np.hstack([seen, np.zeros((len(seen), 3))]).T)[0].T
    return np.asarray(found.reshape(*np.shape(torque)[:-1], 3))


def push_of(robot: RobotDescription, stiffness: Array, jacobian: Array, joint: int) -> Array:
    """Force ``(3,)``, N, that a joint driven forward by 1 rad puts on the clamp."""
    turn = np.zeros((1, robot.n))
    turn[0, joint] = 1.0
    none = np.zeros(robot.n)
    return np.asarray(wrench(robot, jacobian, none, motor_torques(robot, stiffness, none, turn))[0, :3])
