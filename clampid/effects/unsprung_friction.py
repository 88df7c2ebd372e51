"""Friction that selects a gear's flank and winds up no spring: it acts between the clearance and the compliance.

Arm-side friction of the model acts behind both: it selects the flank on which a joint stops, and winds up the springs.
Friction of the gear's output bearing or seal acts before a spring that is a hollow shaft or the bearing itself, and
only selects the flank; so does friction whose spring relaxes once the motor has stopped. Then the difference between
both directions of approach is smaller than with wound springs.
"""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def unwound(p: Any, x: Any) -> Any:
    """q_arm = T' theta_motor - C (tau + F dir) - b/2 s + h/2 dir."""
    return 0.5 * p.width * x.direction


EFFECT = Effect(
    name="unsprung_friction",
    family="backlash",
    acts={"joint_angle": unwound},
    parameters=(
        Parameter(
            "width",
            "rad",
            1e-4,
            "joint",
            (0.0, 2e-2),
            "by how much the difference between both directions is smaller than with wound springs",
        ),
    ),
    needs=("direction",),
    stages=("poses",),
    equation="dq = +h/2 * dir, dir the direction of the last motion",
    source=("Nordin2002", "XCTDrift"),
    search=Search(refines="wrist_coupling_friction"),
)
