"""Arm-side friction of the wrist: it acts on several motors through the transmission, and winds up the springs.

In motion it opposes the joint. After a stop from direction `dir` it keeps the springs wound up, so it also determines
load and flank in the pose stage. In torque logs it can be distinguished from the motor's own friction only where the
transmission couples the joint with another; poses show it at every joint.
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
