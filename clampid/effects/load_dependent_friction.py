"""Friction that grows with the torque that the gear transmits.

In free air the load is gravity and the joint moves against the friction. In a clamped sweep the joint stands still and
the motor moves against it; the load is the torque of the springs.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import fabs
from clampid.effect import Effect, Parameter


def torque(p: Any, x: Any) -> Any:
    """tau_joint = mu |tau_load| sign(motion); it reaches the motors through T."""
    return p.mu * fabs(x.torque) * x.joint_motion


EFFECT = Effect(
    name="load_dependent_friction",
    family="load_dependent_friction",
    acts={"joint_torque": torque},
    parameters=(Parameter("mu", "", 0.05, "joint", meaning="friction per load, both at the joint", role="friction"),),
    needs=("torque", "joint_motion"),
    stages=("free_air", "clamped"),
    equation="tau_joint = mu |tau_g| sign(w)",
    source=("Bittencourt2010",),
)
