"""Additional dry friction at slow speed, which vanishes as a lubricant film builds up with speed."""

from __future__ import annotations

from typing import Any

from clampid.algebra import exp
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search, Separator


def torque(p: Any, x: Any) -> Any:
    """tau_motor = F_s exp(-(w_motor/w_s)^2) sign(w_motor)."""
    return p.Fs * exp(-((x.motor_speed / p.ws) ** 2)) * x.motor_motion


EFFECT = Effect(
    name="stribeck_friction",
    family="stribeck_friction",
    acts={"motor_torque": torque},
    parameters=(
        Parameter(
            "Fs",
            "Nm",
            10.0,
            "joint",
            (0.0, 1e5),
            "dry friction at slow speed beyond Coulomb's, F_s - F_c, never negative",
            gearing=-1,
            role="friction",
        ),
        Parameter(
            "ws",
            "rad/s",
            0.042,
            "joint",
            (5e-4, 5.0),
            "Stribeck speed, at the motor",
            True,
            (0.042, 0.0125, 0.125, 0.33),
            gearing=1,
        ),
    ),
    needs=("motor_speed", "motor_motion"),
    stages=("free_air",),
    equation="tau_motor = (F_s - F_c) exp(-(w/w_s)^2) sign(w)",
    source=("Stribeck1902", "Waiboer2005", "Armstrong1994"),
    search=Search(
        separators=(
            Separator(
                "viscous_friction", "five speeds, evenly spread in their logarithm, down to creeping", same_stage=True
            ),
        )
    ),
)
