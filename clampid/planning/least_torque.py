"""How a clamping plan searches for the posture of least torque: steps and bounds from the springs of the drives."""

from __future__ import annotations

import numpy as np

from clampid.planning.press import Press
from experiments.plans.model import LeastTorque
from kinematics.description import RobotDescription

__all__ = ["STEP_TORQUE_SHARE", "WITHIN", "search_for"]

STEP_TORQUE_SHARE = 0.01  # of the rated torque, by which one step winds a drive's spring up
WITHIN = 0.25  # of it: a clamp that presses more into a drive was not closed well


def search_for(robot: RobotDescription, press: Press) -> LeastTorque:
    """Steps and bounds at the joints ``(n,)``, rad, from springs as described."""
    turn = np.abs(np.diag(np.linalg.inv(np.asarray(robot.transmission))))
    at_rated = press.rated / (press.stiffness * turn)
    return LeastTorque(STEP_TORQUE_SHARE * at_rated, WITHIN * at_rated)
