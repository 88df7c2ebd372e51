"""A drive whose stiffness changes with load: a cubic part of its deflection."""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter
from clampid.search_policy import Search, Separator


def deflection(p: Any, x: Any) -> Any:
    """Dq = -T' (h (T tau)^3)."""
    load = x.transmission @ x.torque
    return -x.transmission.T @ (p.h * load**3)


EFFECT = Effect(
    name="nonlinear_stiffness",
    family="nonlinear_stiffness",
    acts={"joint_angle": deflection},
    parameters=(
        Parameter(
            "h",
            "rad/Nm^3",
            3e-11,
            "joint",
            meaning="cubic part of the deflection at the motor; hardening: < 0; size at the joint",
            gearing=4,
        ),
    ),
    needs=("torque",),
    stages=("clamped", "poses"),
    equation="d theta_m = tau_m/k + h tau_m^3",
    source=("Klimchik",),
    known_within="torque",
    search=Search(
        refines="joint_compliance",
        separators=(
            Separator(
                "backlash", "amplitudes below 10 % and above 50 % of the rated torque in one run", same_stage=True
            ),
        ),
    ),
)
