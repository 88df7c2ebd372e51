"""The drives' springs: a motor's torque winds up its spring, and reaches the joints through the transmission."""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter


def deflection(p: Any, x: Any) -> Any:
    """Dq = -T' diag(c) T tau: not diagonal in a coupled wrist."""
    return -x.transmission.T @ (p.c * (x.transmission @ x.torque))


EFFECT = Effect(
    name="joint_compliance",
    family="joint_compliance",
    acts={"joint_angle": deflection},
    parameters=(
        Parameter(
            "c",
            "rad/Nm",
            5e-5,
            "joint",
            (5e-9, 0.1),
            "compliance of the drive's spring, 1/k, at the motor; size and bounds at the joint",
            gearing=2,
            role="compliance",
        ),
    ),
    needs=("torque",),
    stages=("clamped", "poses"),
    equation="dq = -T' diag(1/k) T tau_joint",
    source=("Thesis", "Dumas2011"),
)
