"""Friction that falls while the gear warms up, without a sensor of its temperature."""

from __future__ import annotations

from typing import Any

from clampid.algebra import exp
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search

MINUTE = 60.0


def torque(p: Any, x: Any) -> Any:
    """tau_motor = (f_v w + f_c sign w) (1 - exp(-t/tau))."""
    return (p.fv * x.motor_speed + p.fc * x.motor_motion) * (1 - exp(-x.elapsed / p.tau))


EFFECT = Effect(
    name="warm_up_friction",
    family="temperature_dependent_friction",
    acts={"motor_torque": torque},
    parameters=(
        Parameter(
            "fv", "Nm s/rad", 15.0, "joint", meaning="viscous friction gained in the end, at the motor", gearing=-2
        ),
        Parameter("fc", "Nm", 7.0, "joint", meaning="dry friction gained in the end, at the motor", gearing=-1),
        Parameter(
            "tau", "s", 60 * MINUTE, "joint", (10.0, 3e5), "time constant", True, (20 * MINUTE, 5 * MINUTE, 80 * MINUTE)
        ),
    ),
    needs=("motor_speed", "motor_motion", "elapsed"),
    stages=("free_air",),
    equation="tau_motor = (f_v w + f_c sign(w)) (1 - exp(-t/tau))",
    source=("Bittencourt2010",),
    search=Search(superseded_by="motor_temperature"),
)
