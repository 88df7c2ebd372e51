"""Clearance: the joint is half the gap off its motor, on the flank against which the transmitted torque presses."""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter


def lag(p: Any, x: Any) -> Any:
    """q_arm = T' theta_motor - b/2 * flank."""
    return -0.5 * p.gap * x.flank


EFFECT = Effect(
    name="backlash",
    family="backlash",
    acts={"joint_angle": lag},
    parameters=(
        Parameter(
            "gap", "rad", 1e-4, "joint", (0.0, 2e-2), "clearance between the flanks, at the joint", role="clearance"
        ),
    ),
    needs=("flank",),
    stages=("clamped", "poses"),
    equation="dq = -b/2 * s, s the flank that the load holds, or the approach direction",
    source=("Nordin2002", "XCTDrift", "UniversalModel"),
)
