"""A tool whose mass or centre of mass differs from the declared one."""

from __future__ import annotations

from typing import Any

from clampid.algebra import rows
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search, Separator


def torque(p: Any, x: Any) -> Any:
    """D tau = Y_flange(q) d(m, m c): the tool moves with the last link."""
    return x.tool_regressor @ rows(p.m, p.mx, p.my, p.mz)


EFFECT = Effect(
    name="payload",
    family="payload",
    acts={"joint_torque": torque},
    parameters=(
        Parameter("m", "kg", 2.0, meaning="mass of the tool beyond what was declared", role="mass"),
        Parameter(
            "mx",
            "kg m",
            0.4,
            meaning="m c_x of the tool beyond what was declared, in the flange frame",
            role="first_moment",
            axis="x",
        ),
        Parameter(
            "my",
            "kg m",
            0.4,
            meaning="m c_y of the tool beyond what was declared, in the flange frame",
            role="first_moment",
            axis="y",
        ),
        Parameter(
            "mz",
            "kg m",
            0.4,
            meaning="m c_z of the tool beyond what was declared, in the flange frame",
            role="first_moment",
            axis="z",
        ),
    ),
    needs=("tool_regressor",),
    stages=("free_air", "poses"),
    equation="d tau = Y_n(q) d(m, m c)_tool",
    source=("Thesis",),
    at="tool",
    search=Search(
        separators=(
            Separator("gravity", "the same program with and without the tool"),
            Separator("joint_compliance", "the same poses without the tool"),
        )
    ),
)
