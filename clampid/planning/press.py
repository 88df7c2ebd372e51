"""Amplitudes of clamped sweeps, the stiffness that they assume, and the limits of a clamp."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clampid.stages.rows import Array
from experiments.plans.errors import PlanError
from experiments.plans.limits import Limits
from kinematics.description import RobotDescription

__all__ = ["Press", "press_limits", "stiffness_of"]

USUAL_WINDUP = 4e-3  # rad at the joint at rated torque, if no spring is described: that of the reference robot's axes


@dataclass(frozen=True)
class Press:
    """How hard a clamped arm is pressed.

    Attributes
    ----------
    amplitude
        Largest spring torque of the driven joint, as a share of the rated motor torque ``(n,)``.
    rated
        Rated torques at the motors ``(n,)``, Nm.
    stiffness
        Described stiffness at the motors ``(n,)``, Nm/rad.
    margin
        Factor by which drives may be stiffer than described.
    dwell
        Time at each step, s.
    clamping_time
        Time to clamp the flange, s.
    """

    amplitude: Array
    rated: Array
    stiffness: Array
    margin: float = 1.6
    dwell: float = 1.0
    clamping_time: float = 600.0


def stiffness_of(robot: RobotDescription, rated: Array) -> tuple[Array, tuple[str, ...]]:
    """Stiffness at the motors ``(n,)``, Nm/rad, as described or else usual, and assumptions in words.

    ``rated`` ``(n,)``: rated torques at the motors, Nm.
    """
    if robot.motor_spring is not None:
        return np.array(robot.motor_spring, dtype=float), ()
    ratio = np.abs(np.diag(robot.transmission))
    words = f"no springs are described: every drive winds up by {USUAL_WINDUP * 1e3:g} mrad at its rated torque"
    return np.asarray(rated * ratio / USUAL_WINDUP), (words,)


def press_limits(
    limits: Limits, rated: Array, *, torque: float = 0.8, force: float = 3000.0, moment: float = 2000.0
) -> Limits:
    """The limits with those of a clamp.

    Parameters
    ----------
    limits
        Limits of the robot.
    rated
        Rated torques at the motors ``(n,)``, Nm.
    torque
        Largest motor torque, as a share of the rated one.
    force, moment
        Largest force, N, and moment, Nm, on the clamp.

    Raises
    ------
    PlanError
        One of the three is not above 0.
    """
    for name, value in (("motor torque", torque), ("force on the clamp", force), ("moment on the clamp", moment)):
        if not value > 0 or not np.isfinite(value):
            raise PlanError(f"{name}: expected a limit above 0, found {value:g}")
    return replace(limits, motor_torque=torque * rated, force=force, moment=moment)
