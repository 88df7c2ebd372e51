"""Lost motion that depends only on the direction of approach: a joint stops on the side it came from, at any load.

The flank of a clearance (backlash) follows the load if that exceeds the friction of a bearing. If friction in the gear,
a stiff seal or a dragging brake exceeds the load, or the described load is wrong, the direction of the last motion
decides. This friction has no parameter here: the width between both sides includes the windup that it causes.
"""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def lag(p: Any, x: Any) -> Any:
    """q_arm = T' theta_motor - h/2 dir."""
    return -0.5 * p.width * x.direction


EFFECT = Effect(
    name="lost_motion",
    family="backlash",
    acts={"joint_angle": lag},
    parameters=(
        Parameter(
            "width",
            "rad",
            1e-4,
            "joint",
            (0.0, 2e-2),
            "difference of the joint angle between both directions of approach",
        ),
    ),
    needs=("direction",),
    stages=("poses",),
    equation="dq = -h/2 * dir, dir the direction of the last motion",
    source=("UniversalModel", "XCTDrift"),
    search=Search(refines="backlash", symptom_of=("wrist_coupling_friction",)),
)
