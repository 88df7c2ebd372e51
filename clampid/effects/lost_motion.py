"""Lost motion by the approach alone: a joint stops on the side that it came from, whatever its load.

A clearance's flank is the load's, wherever that is more than a bearing's friction. Where friction inside the gear, a
stiff seal or a brake that drags outweighs the load, or the load is not the one described, the direction of the last
motion decides. The friction that does it is not asked for: the width between both sides has in it what it winds up.
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
            "width", "rad", 1e-4, "joint", (0.0, 2e-2), "by how much the joint stands apart, come from either side"
        ),
    ),
    needs=("direction",),
    stages=("poses",),
    equation="dq = -h/2 * dir, dir the direction of the last motion",
    source=("UniversalModel", "XCTDrift"),
    search=Search(refines="backlash", symptom_of=("wrist_coupling_friction",)),
)
