"""A wrong entry two off the diagonal of the transmission matrix, such as joint 6 turned by joint 4 in a wrist."""

from __future__ import annotations

from typing import Any

from clampid.algebra import shifted_up
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def error(p: Any, x: Any) -> Any:
    """dq_i = c_i q_(i-2)."""
    return p.c * shifted_up(shifted_up(x.q))


EFFECT = Effect(
    name="distant_coupling_error",
    family="coupling_ratio_error",
    acts={"joint_angle": error},
    parameters=(Parameter("c", "", 1e-4, "joint", meaning="error of the coupling with the joint two before it"),),
    needs=("q",),
    stages=("poses",),
    equation="dq_i = c_i q_(i-2)",
    source=("Thesis",),
    search=Search(scope="places"),
)
