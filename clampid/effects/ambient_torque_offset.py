"""An error of a torque reading that follows the temperature of the surroundings, as of a drive's current sensor."""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter


def torque(p: Any, x: Any) -> Any:
    """tau_motor = b_0 + b_T (T - 20 degC)."""
    return p.b + p.drift * x.ambient_temperature


EFFECT = Effect(
    name="ambient_torque_offset",
    family="torque_offset",
    acts={"motor_torque": torque},
    parameters=(
        Parameter(
            "b", "Nm", 10.0, "joint", meaning="offset of the torque reading at 20 degC, at the motor", gearing=-1
        ),
        Parameter("drift", "Nm/K", 1.0, "joint", meaning="change of the offset per kelvin, at the motor", gearing=-1),
    ),
    needs=("ambient_temperature",),
    stages=("free_air", "clamped"),
    equation="tau_motor = b_0 + b_T (T_a - T_0)",
    source=("VIM",),
)
"""The temperature at which a reading was zeroed is unknown, so the drift is always fitted together with an offset.

Source: VIM 4.22, variation due to an influence quantity.
"""
