"""A tool that was changed or loaded between poses and torque logs: its mass in the poses less that in the logs.

The error of the declared tool that both have in common is :mod:`clampid.effects.payload`.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import rows
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def torque(p: Any, x: Any) -> Any:
    """D tau = Y_flange(q) d(m, m c): the tool moves with the last link."""
    return x.tool_regressor @ rows(p.m, p.mx, p.my, p.mz)


EFFECT = Effect(
    name="pose_payload",
    family="payload",
    acts={"joint_torque": torque},
    parameters=(
        Parameter("m", "kg", 2.0, meaning="mass of the poses' tool beyond that of the logs", role="mass"),
        Parameter(
            "mx",
            "kg m",
            0.4,
            meaning="m c_x of the poses' tool beyond that of the logs, in the flange frame",
            role="first_moment",
            axis="x",
        ),
        Parameter(
            "my",
            "kg m",
            0.4,
            meaning="m c_y of the poses' tool beyond that of the logs, in the flange frame",
            role="first_moment",
            axis="y",
        ),
        Parameter(
            "mz",
            "kg m",
            0.4,
            meaning="m c_z of the poses' tool beyond that of the logs, in the flange frame",
            role="first_moment",
            axis="z",
        ),
    ),
    needs=("tool_regressor",),
    stages=("poses",),
    equation="d tau = Y_n(q) d(m, m c), of the poses' tool less the logs'",
    source=("Thesis",),
    at="tool",
    search=Search(differs_from="free_air"),
)
