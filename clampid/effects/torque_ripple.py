"""Torque that varies with the motor's revolution: cogging, or an eccentric gear stage."""

from __future__ import annotations

from typing import Any

from clampid.algebra import cos, sin
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def torque(p: Any, x: Any) -> Any:
    """tau_motor = a1 sin m + b1 cos m + a2 sin 2m + b2 cos 2m, m the motor's angle."""
    m = x.motor
    return p.a1 * sin(m) + p.b1 * cos(m) + p.a2 * sin(2 * m) + p.b2 * cos(2 * m)


EFFECT = Effect(
    name="torque_ripple",
    family="torque_ripple",
    acts={"motor_torque": torque},
    parameters=tuple(
        Parameter(f"{a}{k}", "Nm", 5.0, "joint", meaning=f"{f} part, {k} per revolution of the motor", gearing=-1)
        for k in (1, 2)
        for a, f in (("a", "sine"), ("b", "cosine"))
    ),
    needs=("motor",),
    stages=("free_air",),
    equation="tau_motor = sum_k a_k sin k m + b_k cos k m, k = 1, 2",
    source=("Armstrong1994",),
    search=Search(scope="places"),
)
