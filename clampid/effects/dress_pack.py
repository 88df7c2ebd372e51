"""Cables and hoses that act as a spring on wrist joints."""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def torque(p: Any, x: Any) -> Any:
    """tau_joint = k (q - q_0), written as k q + t."""
    return p.k * x.q + p.t


EFFECT = Effect(
    name="dress_pack",
    family="dress_pack",
    acts={"joint_torque": torque},
    parameters=(
        Parameter("k", "Nm/rad", 2.0, "joint", meaning="stiffness of the dress pack about the joint"),
        Parameter("t", "Nm", 2.0, "joint", meaning="its torque at the joint's zero, -k q_0"),
    ),
    needs=("q",),
    stages=("free_air", "poses"),
    equation="tau_joint = k (q - q_0)",
    source=("Armstrong1994",),
    search=Search(scope="places"),
)
