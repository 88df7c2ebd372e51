"""Friction of a motor that follows its own joint only, not the joints that the transmission couples it with.

Friction follows the shaft that rubs. If it follows the motor's own joint only, the coupling in T is wrong; or T is
right, and the log's joint angles are motor angles divided by their ratios, without the coupling. F_c and F_v are then
the motor's whole Coulomb and viscous friction; half of them would mean half of the coupling.
"""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter


def torque(p: Any, x: Any) -> Any:
    """tau_motor = F_c (sign(w_own) - sign(w_motor)) + F_v (w_own - w_motor), w_own = w_joint/T_ii."""
    return p.Fc * (x.own_motion - x.motor_motion) + p.Fv * (x.own_speed - x.motor_speed)


EFFECT = Effect(
    name="uncoupled_friction",
    family="coupling_ratio_error",
    acts={"motor_torque": torque},
    parameters=(
        Parameter(
            "Fc", "Nm", 30.0, "joint", meaning="dry friction that follows the motor's own joint, not T", gearing=-1
        ),
        Parameter(
            "Fv", "Nm s/rad", 30.0, "joint", meaning="viscous friction that follows the motor's own joint", gearing=-2
        ),
    ),
    needs=("own_speed", "own_motion", "motor_speed", "motor_motion"),
    stages=("free_air",),
    equation="tau_motor = F_c (sign(w_own) - sign(w_motor)) + F_v (w_own - w_motor), w_own = w_joint/T_ii",
    source=("Thesis",),
    coupled_only=("free_air",),
)
