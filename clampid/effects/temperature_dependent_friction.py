"""Lubricant friction that falls as the gear warms up."""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter


def torque(p: Any, x: Any) -> Any:
    """tau_motor = (f_v w + f_c sign w) (T - 20 degC)."""
    return (p.fv * x.motor_speed + p.fc * x.motor_motion) * x.motor_temperature


EFFECT = Effect(
    name="temperature_dependent_friction",
    family="temperature_dependent_friction",
    acts={"motor_torque": torque},
    parameters=(
        Parameter(
            "fv",
            "Nm s/rad",
            1.0,
            "joint",
            meaning="viscous friction per kelvin, at the motor",
            gearing=-2,
            role="friction",
        ),
        Parameter(
            "fc", "Nm/K", 0.5, "joint", meaning="dry friction per kelvin, at the motor", gearing=-1, role="friction"
        ),
    ),
    needs=("motor_speed", "motor_motion", "motor_temperature"),
    stages=("free_air",),
    equation="tau_motor = (f_v w + f_c sign(w)) (T - T_0), the first order of F_v exp(-b (T - T_0)) w",
    source=("Bittencourt2010",),
)
