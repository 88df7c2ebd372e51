"""A tool that differs from the declared one, by a different amount in each campaign of one robot.

An error common to all campaigns is :mod:`clampid.effects.payload`; a model has one of the two, not both.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import dot, rows
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def torque(p: Any, x: Any) -> Any:
    """D tau = Y_flange(q) d(m, m c) of the session: the tool moves with the last link."""
    return x.tool_regressor @ rows(*(dot(part, x.session_is) for part in (p.m, p.mx, p.my, p.mz)))


EFFECT = Effect(
    name="session_payload",
    family="payload",
    acts={"joint_torque": torque},
    parameters=(
        Parameter(
            "m", "kg", 2.0, "session", meaning="mass of the session's tool beyond what was declared", role="mass"
        ),
        *(
            Parameter(
                f"m{a}",
                "kg m",
                0.4,
                "session",
                meaning=f"m c_{a} of that tool beyond what was declared",
                role="first_moment",
                axis=a,
            )
            for a in "xyz"
        ),
    ),
    needs=("tool_regressor", "session_is"),
    stages=("poses",),
    equation="d tau = Y_n(q) d(m, m c)_tool of the session",
    source=("Thesis",),
    at="tool",
    search=Search(opt_in=True),
)
