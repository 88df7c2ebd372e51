"""How hard a clamped arm is pressed: up to which wind-up of a joint's spring, and what the clamp bears."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clampid.stages.rows import Array
from experiments.plans.errors import PlanError
from experiments.plans.limits import Limits
from kinematics.description import RobotDescription

__all__ = ["Press", "press_limits", "stiffness_of"]

WINDUP = 4e-3  # rad at the joint at rated torque, where no spring is known: the reference robot's main axes


@dataclass(frozen=True)
class Press:
    """How hard to press, and what the clamp bears.

    Attributes
    ----------
    amplitude
        ``(n,)``: shares of the rated motor torques that the driven joint's spring is wound up to.
    rated
        ``(n,)`` Nm at the motors.
    stiffness
        ``(n,)`` Nm/rad at the motors, as described.
    margin
        By how much stiffer drives may be than described.
    dwell
        s at each step.
    clamping_time
        s that it takes to clamp the flange.
    """

    amplitude: Array
    rated: Array
    stiffness: Array
    margin: float = 1.6
    dwell: float = 1.0
    clamping_time: float = 600.0


def stiffness_of(robot: RobotDescription, rated: Array) -> tuple[Array, tuple[str, ...]]:
    """Springs at the motors ``(n,)``, Nm/rad, as described or as usual, and what had to be assumed."""
    if robot.motor_spring is not None:
        return np.array(robot.motor_spring, dtype=float), ()
    ratio = np.abs(np.diag(robot.transmission))
    words = f"no springs are described: every drive winds up by {WINDUP * 1e3:g} mrad at its rated torque"
    return np.asarray(rated * ratio / WINDUP), (words,)


def press_limits(
    limits: Limits, rated: Array, *, torque: float = 0.8, force: float = 3000.0, moment: float = 2000.0
) -> Limits:
    """Limits with those of a clamp: a share of the rated motor torques, N and Nm.

    Raises
    ------
    PlanError
        One of them is not above 0.
    """
    for name, value in (("motor torque", torque), ("force on the clamp", force), ("moment on the clamp", moment)):
        if not value > 0 or not np.isfinite(value):
            raise PlanError(f"{name}: expected a limit above 0, found {value:g}")
    return replace(limits, motor_torque=torque * rated, force=force, moment=moment)
