"""Dry friction of the motors: a constant torque against the motion."""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter


def torque(p: Any, x: Any) -> Any:
    """tau_motor = F_c sign(w_motor)."""
    return p.Fc * x.motor_motion


EFFECT = Effect(
    name="coulomb_friction",
    family="coulomb_friction",
    acts={"motor_torque": torque},
    parameters=(
        Parameter("Fc", "Nm", 30.0, "joint", (0.0, 1e5), "dry friction at the motor", gearing=-1, role="dry_friction"),
    ),
    needs=("motor_motion",),
    stages=("free_air", "clamped"),
    equation="tau_motor = F_c sign(w_motor)",
    source=("Thesis", "Armstrong1994"),
)
