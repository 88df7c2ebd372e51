"""Errors of the described masses and centres of mass of the links.

The tolerance of the description is their prior (clampid.fitting.priors). Only this prior separates the mass of the last
link from an undeclared tool, whose torques are the same: see payload.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import interleave
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def torque(p: Any, x: Any) -> Any:
    """D tau = Y(q) d(m, m c)."""
    return x.regressor @ interleave(p.m, p.mx, p.my, p.mz)


EFFECT = Effect(
    name="gravity",
    family="gravity",
    acts={"joint_torque": torque},
    parameters=(
        Parameter("m", "kg", 5.0, "link", meaning="mass beyond the description", role="mass"),
        Parameter(
            "mx",
            "kg m",
            2.0,
            "link",
            meaning="m c_x beyond the description, base axes at the zero pose",
            role="first_moment",
            axis="x",
        ),
        Parameter("my", "kg m", 2.0, "link", meaning="m c_y beyond the description", role="first_moment", axis="y"),
        Parameter("mz", "kg m", 2.0, "link", meaning="m c_z beyond the description", role="first_moment", axis="z"),
    ),
    needs=("regressor",),
    stages=("free_air", "poses"),
    equation="d tau = Y(q) d(m, m c), Y = d(dV/dq)/d(m, m c)",
    source=("Thesis", "LynchPark2017"),
    search=Search(scope="together"),
)
