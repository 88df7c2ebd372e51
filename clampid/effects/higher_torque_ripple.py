"""Torque that varies three to six times per revolution of the motor: poles and slots of the motor."""

from __future__ import annotations

from typing import Any

from clampid.algebra import cos, sin
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search

ORDERS = (3, 4, 5, 6)


def torque(p: Any, x: Any) -> Any:
    """tau_motor = sum_k a_k sin k m + b_k cos k m, m the motor's angle."""
    waves = [(getattr(p, f"a{k}"), getattr(p, f"b{k}"), k * x.motor) for k in ORDERS]
    return sum(a * sin(m) + b * cos(m) for a, b, m in waves)


EFFECT = Effect(
    name="higher_torque_ripple",
    family="torque_ripple",
    acts={"motor_torque": torque},
    parameters=tuple(
        Parameter(f"{a}{k}", "Nm", 5.0, "joint", meaning=f"{f} part, {k} per revolution of the motor", gearing=-1)
        for k in ORDERS
        for a, f in (("a", "sine"), ("b", "cosine"))
    ),
    needs=("motor",),
    stages=("free_air",),
    equation="tau_motor = sum_k a_k sin k m + b_k cos k m, k = 3, 4, 5, 6",
    source=("Armstrong1994",),
    search=Search(scope="places"),
)
