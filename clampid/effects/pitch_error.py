"""A joint that advances along its axis as it turns by another amount than described.

The screw of a joint is v = -w x p + h w; a screw drive has h by design, and a spindle's lead is off by some parts in
ten thousand. Other joints that turn have none to speak of: a bearing's face out of square moves the axis to and fro
once a turn, and not on and on. It is looked for at helical joints only, so that arms without any pay nothing for it; by
name it can be fitted wherever a joint turns. What a sliding joint is off by is its ratio: `coupling_ratio_error`.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import along
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def advance(p: Any, x: Any) -> Any:
    """V = h q w at the link behind the joint; it commutes with the turn about w, so that it is exact."""
    return along(p.h * (x.linkage @ x.q), x.turning_axes)


EFFECT = Effect(
    name="pitch_error",
    family="coupling_ratio_error",
    acts={"link_twist": advance},
    parameters=(
        Parameter("h", "m/rad", 1e-5, "joint", meaning="advance along the axis by angle, beyond the description"),
    ),
    needs=("q",),
    stages=("poses",),
    equation="exp([(w, v + h w)] q) = exp([(w, v)] q) exp([(0, h w)] q)",
    source=("UniversalModel", "LynchPark2017"),
    search=Search(scope="places", joint_kind="helical"),
)
