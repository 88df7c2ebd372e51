"""Angle error periodic in a joint's revolution, once and twice: an eccentric gear or encoder."""

from __future__ import annotations

from typing import Any

from clampid.algebra import cos, sin
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def error(p: Any, x: Any) -> Any:
    """Dq = a1 sin q + b1 cos q + a2 sin 2q + b2 cos 2q."""
    return p.a1 * sin(x.q) + p.b1 * cos(x.q) + p.a2 * sin(2 * x.q) + p.b2 * cos(2 * x.q)


EFFECT = Effect(
    name="gear_eccentricity",
    family="gear_eccentricity",
    acts={"joint_angle": error},
    parameters=tuple(
        Parameter(
            f"{a}{k}",
            "rad",
            1e-4,
            "joint",
            (-0.05, 0.05),
            f"{f} part, {k} per revolution of the joint",
            role="angle_error",
        )
        for k in (1, 2)
        for a, f in (("a", "sine"), ("b", "cosine"))
    ),
    needs=("q",),
    stages=("poses",),
    equation="dq = sum_k a_k sin k q + b_k cos k q, k = 1, 2",
    source=("UniversalModel",),
    known_within="q",
    search=Search(scope="places"),
)
