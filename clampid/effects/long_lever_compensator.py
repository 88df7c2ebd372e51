"""A spring or gas balancer whose lever is long beside the distance of its pins, so that it takes three harmonics."""

from __future__ import annotations

from typing import Any

from clampid.algebra import cos, sin
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search, Separator

ORDERS = (1, 2, 3)


def torque(p: Any, x: Any) -> Any:
    """tau_joint = sum_k s_k sin k q + c_k cos k q: the balancer's torque to third order in its lever."""
    return sum(getattr(p, f"s{k}") * sin(k * x.q) + getattr(p, f"c{k}") * cos(k * x.q) for k in ORDERS)


EFFECT = Effect(
    name="long_lever_compensator",
    family="gravity_compensator",
    acts={"joint_torque": torque},
    parameters=tuple(
        Parameter(f"{a}{k}", "Nm", size, "joint", meaning=f"{f} part at {k} times the angle")
        for k, size in zip(ORDERS, (50.0, 20.0, 10.0), strict=True)
        for a, f in (("s", "sine"), ("c", "cosine"))
    ),
    needs=("q",),
    stages=("free_air", "poses"),
    equation="tau = k (l - l_0) dl/dq, l^2 = a^2 + b^2 - 2 a b cos(q - q_0), as three harmonics of q",
    source=("Klimchik",),
    holds_weight=True,
    search=Search(
        scope="places",
        shown_by="free_air",
        separators=(
            Separator(
                "gear_eccentricity",
                "a log of torques in free air: a balancer's torque shows there, a gear's error does not",
            ),
        ),
    ),
)
