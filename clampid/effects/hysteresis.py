"""Lost motion that depends on the path: dry friction that builds up over a travel after each reversal.

Maxwell slip, Bouc-Wen and Dahl's law cannot be told apart in such sweeps, so that the effect goes by its family.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import exp
from clampid.effect import Effect, Parameter


def torque(p: Any, x: Any) -> Any:
    """tau_motor = -h exp(-travel/s) sign(motion): what is still missing of the friction after a reversal."""
    return -p.h * exp(-x.travel / p.s) * x.motor_motion


EFFECT = Effect(
    name="hysteresis",
    family="hysteresis",
    acts={"motor_torque": torque},
    parameters=(
        Parameter("h", "Nm", 0.2, "joint", meaning="friction that builds up again after a reversal, at the motor"),
        Parameter(
            "s", "rad", 0.05, "joint", (1e-4, 10.0), "travel of the motor over which it does", True, (0.05, 0.015, 0.15)
        ),
    ),
    needs=("travel", "motor_motion"),
    stages=("clamped",),
    equation="tau_motor = F_c sign(motion) (1 - h/F_c exp(-travel/s))",
    source=("Olsson1998",),
)
