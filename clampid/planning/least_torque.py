"""Steps and bounds of a clamping plan's search for the posture of least torque, from the springs of the drives."""

from __future__ import annotations

import numpy as np

from clampid.planning.press import Press
from experiments.plans.model import LeastTorque
from kinematics.description import RobotDescription

__all__ = ["LARGEST_TORQUE_SHARE", "STEP_TORQUE_SHARE", "search_for"]

STEP_TORQUE_SHARE = 0.01  # of the rated torque: spring torque of one step
LARGEST_TORQUE_SHARE = 0.25  # of the rated torque: a clamp that loads a drive more was not closed well


def search_for(robot: RobotDescription, press: Press) -> LeastTorque:
    """Steps and bounds at the joints ``(n,)``, rad, from the described springs."""
    turn = np.abs(np.diag(np.linalg.inv(np.asarray(robot.transmission))))
    at_rated = press.rated / (press.stiffness * turn)
    return LeastTorque(STEP_TORQUE_SHARE * at_rated, LARGEST_TORQUE_SHARE * at_rated)
