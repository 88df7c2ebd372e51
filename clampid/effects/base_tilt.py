"""A pedestal that tilts under the moment of the arm's weight."""

from __future__ import annotations

from typing import Any

from clampid.algebra import rows
from clampid.effect import CAST_ARM, Effect, Parameter
from clampid.search_policy import Search, Separator


def tilt(p: Any, x: Any) -> Any:
    """W = C (M_x, M_y), M the moment of all moving masses about the base's origin."""
    mx, my = x.base_moment[0], x.base_moment[1]
    return rows(p.cxx * mx + p.cxy * my, p.cxy * mx + p.cyy * my, 0, 0, 0, 0)


EFFECT = Effect(
    name="base_tilt",
    family="base_tilt",
    acts={"base_twist": tilt},
    parameters=tuple(
        Parameter(
            name,
            "rad/Nm",
            1e-7,
            bounds=(-5e-5 if name == "cxy" else 0.0, 5e-5),
            meaning=f"tilt of the base about {a} by moment about {b}",
            moment=CAST_ARM,
        )
        for name, a, b in (("cxx", "x", "x"), ("cxy", "x and y", "y and x"), ("cyy", "y", "y"))
    ),
    needs=("base_moment",),
    stages=("poses",),
    equation="(w_x, w_y) = C_b (M_x, M_y)",
    source=("XCTDrift",),
    at="base",
    search=Search(
        separators=(
            Separator(
                "joint_compliance",
                "poses at other angles of joint 1 with equal loads on joint 2, or a target on the base plate",
                same_stage=True,
            ),
        )
    ),
)
