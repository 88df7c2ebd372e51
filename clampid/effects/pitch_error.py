"""Error of a joint's pitch: its advance along the axis per angle differs from the described one.

The screw of a joint is v = -w x p + h w. A screw drive has h by design, and a spindle's lead has errors of some parts
in ten thousand. Other revolute joints have no pitch: a bearing's face out of square moves the axis to and fro once per
turn, without a net advance. Diagnosis searches it at helical joints only, so other arms have no additional candidates;
by name it can be fitted at any revolute joint. The error of a sliding joint is its ratio: `coupling_ratio_error`.
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
