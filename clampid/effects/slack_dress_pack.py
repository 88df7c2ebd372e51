"""Cables and hoses with slack, which pull little near their rest, and more and more beyond it."""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def torque(p: Any, x: Any) -> Any:
    """tau_joint = k (q - q_0) + h (q - q_0)^3, written as t + k1 q + k2 q^2 + k3 q^3, q in rad."""
    return p.t + p.k1 * x.q + p.k2 * x.q**2 + p.k3 * x.q**3


EFFECT = Effect(
    name="slack_dress_pack",
    family="dress_pack",
    acts={"joint_torque": torque},
    parameters=(
        Parameter("k1", "Nm/rad", 2.0, "joint", meaning="stiffness of the dress pack at the joint's zero"),
        Parameter("t", "Nm", 2.0, "joint", meaning="its torque at the joint's zero"),
        Parameter("k2", "Nm", 1.0, "joint", meaning="quadratic part of its torque, at 1 rad"),
        Parameter("k3", "Nm", 1.0, "joint", meaning="cubic part of its torque, at 1 rad"),
    ),
    needs=("q",),
    stages=("free_air", "poses"),
    equation="tau_joint = k (q - q_0) + h (q - q_0)^3",
    source=("Armstrong1994",),
    known_within="q",
    search=Search(scope="places", shown_by="free_air"),
)
