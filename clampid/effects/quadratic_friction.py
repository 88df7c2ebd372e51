"""Lubricant friction that does not grow in proportion to speed: a film that thins or thickens as it is sheared."""

from __future__ import annotations

from typing import Any

from clampid.algebra import fabs
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def torque(p: Any, x: Any) -> Any:
    """tau_motor = F_2 w |w|."""
    return p.F2 * x.motor_speed * fabs(x.motor_speed)


EFFECT = Effect(
    name="quadratic_friction",
    family="viscous_friction",
    acts={"motor_torque": torque},
    parameters=(
        Parameter(
            "F2", "Nm s^2/rad^2", 10.0, "joint", meaning="curvature of viscous friction, at the motor", gearing=-3
        ),
    ),
    needs=("motor_speed",),
    stages=("free_air",),
    equation="tau_motor = F_2 w |w|",
    source=("Waiboer2005",),
    search=Search(refines="viscous_friction"),
)
