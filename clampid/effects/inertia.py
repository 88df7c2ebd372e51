"""Torque of acceleration in addition to that of the described masses: inertia of rotors and links."""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter


def torque(p: Any, x: Any) -> Any:
    """tau_joint = I q''."""
    return p.I * x.joint_acceleration


EFFECT = Effect(
    name="inertia",
    family="inertia",
    acts={"joint_torque": torque},
    parameters=(
        Parameter(
            "I",
            "kg m^2",
            20.0,
            "joint",
            meaning="inertia about the joint beyond the description's",
            role="rotor_inertia",
        ),
    ),
    needs=("joint_acceleration",),
    stages=("free_air",),
    equation="tau_joint = I q''",
    source=("LynchPark2017",),
)
