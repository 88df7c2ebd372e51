"""Torque that repeats at every tooth or wave of a gear whose ratio is not described: its order is sought.

A strain wave gear turns its wave generator ratio times as fast as the joint and deforms twice in each of its
revolutions; teeth of a spur gear mesh as often as it has teeth. A description with the ratios has these orders in
`torque_ripple`. Where it has none, because its motors are stated at the joints, or where the gear has several stages,
the order is one more unknown.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import cos, sin
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def torque(p: Any, x: Any) -> Any:
    """tau_motor = a sin k m + b cos k m, m the motor's angle."""
    return p.a * sin(p.k * x.motor) + p.b * cos(p.k * x.motor)


EFFECT = Effect(
    name="gear_ripple",
    family="torque_ripple",
    acts={"motor_torque": torque},
    parameters=(
        Parameter("a", "Nm", 1.0, "joint", meaning="sine part", gearing=-1),
        Parameter("b", "Nm", 1.0, "joint", meaning="cosine part", gearing=-1),
        Parameter(
            "k", "", 1.0, "joint", (7.0, 600.0), "periods per revolution of the motor", True, (100.0,), gearing=-1
        ),
    ),
    needs=("motor",),
    stages=("free_air",),
    equation="tau_motor = a sin k m + b cos k m",
    source=("Tuttle1996",),
    order="k",
    search=Search(scope="places"),
)
