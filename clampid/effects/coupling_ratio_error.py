"""A wrong entry in the transmission matrix: an error of a ratio, or a missing coupling."""

from __future__ import annotations

from typing import Any

from clampid.algebra import shifted_up
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search, Separator


def error(p: Any, x: Any) -> Any:
    """dq_i = k_i q_i + c_i q_(i-1)."""
    return p.k * x.q + p.c * shifted_up(x.q)


EFFECT = Effect(
    name="coupling_ratio_error",
    family="coupling_ratio_error",
    acts={"joint_angle": error},
    parameters=(
        Parameter("k", "", 1e-4, "joint", meaning="relative error of the joint's own ratio"),
        Parameter("c", "", 1e-4, "joint", meaning="error of the coupling with the joint before it"),
    ),
    needs=("q",),
    stages=("poses",),
    equation="dq_i = k_i q_i + c_i q_(i-1)",
    source=("Thesis",),
    search=Search(
        scope="places",
        separators=(Separator("gear_eccentricity", "poses over the full range of the joint", same_stage=True),),
    ),
)
