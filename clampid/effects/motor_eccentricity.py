"""Angle error periodic in a motor's revolution, once and twice: a resolver, or the first stage of a gear.

A strain-wave gear has an error twice per revolution of its wave generator, which the motor turns. The phase is fitted;
only the gear ratio must be right. In a description without gears the motors are at the joints, and this is the
eccentricity of the joint itself.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import cos, sin
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def error(p: Any, x: Any) -> Any:
    """Dq = a1 sin m + b1 cos m + a2 sin 2m + b2 cos 2m, m the motor's angle."""
    m = x.motor
    return p.a1 * sin(m) + p.b1 * cos(m) + p.a2 * sin(2 * m) + p.b2 * cos(2 * m)


EFFECT = Effect(
    name="motor_eccentricity",
    family="gear_eccentricity",
    acts={"joint_angle": error},
    parameters=tuple(
        Parameter(
            f"{a}{k}",
            "rad",
            1e-4,
            "joint",
            (-0.05, 0.05),
            f"{f} part, {k} per revolution of the motor",
            role="angle_error",
        )
        for k in (1, 2)
        for a, f in (("a", "sine"), ("b", "cosine"))
    ),
    needs=("motor",),
    stages=("poses",),
    equation="dq = sum_k a_k sin k m + b_k cos k m, k = 1, 2, m the motor's angle",
    source=("UniversalModel",),
    search=Search(scope="places"),
)
