"""Arm-side friction of the wrist: it reaches several motors through the transmission, and stays in the springs.

In motion the drive carries it against the motion. After a stop from direction `dir` the springs stay wound up by it,
so that it supplies load and flank to the pose stage too. In torque logs it can be told from the motor's own friction
only where the transmission couples a joint with another; in poses it shows at every joint.
"""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter


def torque(p: Any, x: Any) -> Any:
    """tau_joint = F_arm sign(w_joint): through T it reaches several motors."""
    return p.F * x.joint_motion


EFFECT = Effect(
    name="wrist_coupling_friction",
    family="wrist_coupling_friction",
    acts={"joint_torque": torque},
    parameters=(
        Parameter(
            "F", "Nm", 5.0, "joint", (0.0, 1e4), "dry friction on the arm side of the joint", role="arm_friction"
        ),
    ),
    needs=("joint_motion",),
    stages=("free_air", "poses"),
    equation="tau_motor = T F_arm sign(w_joint)",
    source=("Thesis",),
    coupled_only=("free_air",),
)
