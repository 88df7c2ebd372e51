"""Lubricant friction of the motors: a torque that grows with speed."""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter


def torque(p: Any, x: Any) -> Any:
    """tau_motor = F_v w_motor."""
    return p.Fv * x.motor_speed


EFFECT = Effect(
    name="viscous_friction",
    family="viscous_friction",
    acts={"motor_torque": torque},
    parameters=(
        Parameter(
            "Fv",
            "Nm s/rad",
            30.0,
            "joint",
            (0.0, 1e6),
            "viscous friction at the motor",
            gearing=-2,
            role="viscous_damping",
        ),
    ),
    needs=("motor_speed",),
    stages=("free_air",),
    equation="tau_motor = F_v w_motor",
    source=("Thesis", "Armstrong1994"),
)
