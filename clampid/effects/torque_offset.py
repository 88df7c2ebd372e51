"""A constant error of a torque reading, such as a current sensor's offset."""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter


def torque(p: Any, x: Any) -> Any:
    """tau_motor = b_0."""
    return p.b + 0 * x.motor_motion


EFFECT = Effect(
    name="torque_offset",
    family="torque_offset",
    acts={"motor_torque": torque},
    parameters=(Parameter("b", "Nm", 10.0, "joint", meaning="offset of the torque reading, at the motor", gearing=-1),),
    needs=("motor_motion",),
    stages=("free_air", "clamped"),
    equation="tau_motor = b_0",
    source=("Armstrong1994",),
)
