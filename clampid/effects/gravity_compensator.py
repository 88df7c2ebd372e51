"""A spring or gas balancer on a joint, anchored beside its axis."""

from __future__ import annotations

from typing import Any

from clampid.algebra import cos, sin
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search, Separator


def torque(p: Any, x: Any) -> Any:
    """tau_joint = a sin q + b cos q + c sin 2q + d cos 2q: the balancer's torque to second order in its lever."""
    return p.a * sin(x.q) + p.b * cos(x.q) + p.c * sin(2 * x.q) + p.d * cos(2 * x.q)


EFFECT = Effect(
    name="gravity_compensator",
    family="gravity_compensator",
    acts={"joint_torque": torque},
    parameters=(
        Parameter("a", "Nm", 50.0, "joint", meaning="sine part of the balancer's torque"),
        Parameter("b", "Nm", 50.0, "joint", meaning="cosine part"),
        Parameter("c", "Nm", 20.0, "joint", meaning="sine part at twice the angle"),
        Parameter("d", "Nm", 20.0, "joint", meaning="cosine part at twice the angle"),
    ),
    needs=("q",),
    stages=("free_air", "poses"),
    equation="tau = k (l - l_0) dl/dq, l^2 = a^2 + b^2 - 2 a b cos(q - q_0), as two harmonics of q",
    source=("Klimchik",),
    holds_weight=True,
    search=Search(
        scope="places",
        separators=(
            Separator(
                "gear_eccentricity",
                "a log of torques in free air: a balancer's torque shows there, a gear's error does not",
            ),
        ),
    ),
)
