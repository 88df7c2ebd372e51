"""The load on motors and clamp from a reading, compared with the plan's limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.plans.model import Plan, Sweep
from experiments.plans.motion import Array
from experiments.plans.press import flange_jacobian, holding_torque, wrench

__all__ = ["FREE", "Watch", "loaded", "slope_of"]

FREE = 0.25  # of the described stiffness: no drive is four times as soft, so below this the flange is free
CERTAIN_SLOPE = 3.0  # standard errors by which it is below that
MIN_READINGS = 5  # readings that a slope is taken from


@dataclass(frozen=True)
class Watch:
    """The limits of one clamping.

    Attributes
    ----------
    plan
        With its limits.
    load
        Joint torques that hold the described arm, Nm, ``(n,)``. Friction counts as load on the clamp: the safe side.
    jacobian
        Of the flange, ``(6, n)``.
    """

    plan: Plan
    load: Array
    jacobian: Array

    @staticmethod
    def of(plan: Plan, sweep: Sweep) -> Watch:
        """For the posture of a sweep."""
        cell = plan.cell
        load = holding_torque(cell.robot, sweep.posture, cell.gravity, cell.tool_mass, cell.tool_com)
        return Watch(plan, load, flange_jacobian(cell.robot, sweep.posture))

    def fault(self, torque: Array) -> str | None:
        """What motor torques ``(n,)``, Nm, exceed, in words, or None."""
        limits = self.plan.limits
        if not np.all(np.isfinite(torque)):
            return f"expected torques, found {torque.tolist()}"
        W = wrench(self.plan.cell.robot, self.jacobian, self.load, torque[None])[0]
        found = [
            ("force on the clamp", float(np.linalg.norm(W[:3])), limits.force, "N"),
            ("moment on the clamp", float(np.linalg.norm(W[3:])), limits.moment, "Nm"),
        ]
        if limits.motor_torque is not None:
            found += [
                (f"torque of motor {i + 1}", abs(float(v)), float(limits.motor_torque[i]), "Nm")
                for i, v in enumerate(torque)
            ]
        for what, value, limit, unit in found:
            if limit is not None and value > limit:
                return f"{what}: expected at most {limit:.6g} {unit}, measured {value:.6g} {unit}"
        return None


def slope_of(motor: Array, torque: Array) -> tuple[float, float]:
    """Torque against motor angle and its standard error, Nm/rad, of readings ``(m,)`` taken in one direction."""
    x = motor - motor.mean()
    spread = float(x @ x)
    if len(motor) < 3 or spread <= 0.0:
        return 0.0, np.inf
    value = float(x @ torque) / spread
    rest = torque - torque.mean() - value * x
    return value, float(np.sqrt(rest @ rest / (len(x) - 2) / spread))


def loaded(motor: Array, torque: Array, stiffness: float) -> bool | None:
    """Whether a driven motor's spring winds up while it is driven one way; None: too few data.

    The later two thirds are judged: friction turns and a clearance is crossed first.
    """
    first = len(motor) // 3
    if len(motor) - first < MIN_READINGS:
        return None
    value, error = slope_of(motor[first:], torque[first:])
    return bool(value + CERTAIN_SLOPE * error >= FREE * stiffness)
