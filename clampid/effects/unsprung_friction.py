"""Friction that holds a gear's flank and winds up no spring: it acts between the clearance and what yields.

The model has friction of the arm's side behind both: it decides on which flank a joint stops, and stays in the
springs. Friction of the gear's output bearing or its seal, ahead of a spring that is a hollow shaft or the bearing
itself, decides on the flank alone; so does friction whose spring lets go once the motor has stopped. The joint then
stands apart, come from either side, by less than springs wound up by that friction would have it.
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
            "by how much less it stands apart than with wound springs",
        ),
    ),
    needs=("direction",),
    stages=("poses",),
    equation="dq = +h/2 * dir, dir the direction of the last motion",
    source=("Nordin2002", "XCTDrift"),
    search=Search(refines="wrist_coupling_friction"),
)
