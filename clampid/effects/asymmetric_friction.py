"""Dry friction that differs by direction. On one axis it is exactly Coulomb friction and a torque offset together."""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter
from clampid.search_policy import Search, Separator


def torque(p: Any, x: Any) -> Any:
    """tau_motor = dF_c (1 + sign(w))/2."""
    return p.dFc * 0.5 * (1 + x.motor_motion)


EFFECT = Effect(
    name="asymmetric_friction",
    family="asymmetric_friction",
    acts={"motor_torque": torque},
    parameters=(
        Parameter(
            "dFc", "Nm", 10.0, "joint", meaning="dry friction forwards less backwards", gearing=-1, role="friction"
        ),
    ),
    needs=("motor_motion",),
    stages=("free_air", "clamped"),
    equation="tau_motor = dF_c (1 + sign(w))/2",
    source=("Armstrong1994",),
    search=Search(
        separators=(
            Separator(
                "torque_offset",
                "nothing on one axis, where they are the same: a torque reading with the brakes on gives the offset",
            ),
        )
    ),
)
