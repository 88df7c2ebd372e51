"""A joint's bearing that tilts across its axis under the moment it carries."""

from __future__ import annotations

from typing import Any

from clampid.algebra import before, turning
from clampid.effect import CAST_ARM, Effect, Parameter
from clampid.search_policy import Search, Separator


def tilt(p: Any, x: Any) -> Any:
    """W = c M_perp, at the joint, in the link behind it."""
    m = x.transverse_moment
    return before(turning([p.c * m[:, k] for k in range(3)]), x.link_vectors)


EFFECT = Effect(
    name="bearing_tilt",
    family="bearing_tilt",
    acts={"link_twist": tilt},
    parameters=(
        Parameter(
            "c",
            "rad/Nm",
            5e-7,
            "joint",
            (0.0, 1e-5),
            "tilt of the bearing across its axis by moment",
            moment=CAST_ARM,
        ),
    ),
    needs=("transverse_moment",),
    stages=("poses",),
    equation="w_i = c_i M_i, M_i the moment across the axis of joint i",
    source=("Klimchik",),
    search=Search(
        scope="places",
        separators=(
            Separator(
                "base_tilt",
                "no pose separates a tilt of joint 1's bearing from a tilt of the base: put an inclinometer or a "
                "target on the base plate",
            ),
            Separator("joint_compliance", "the same poses with two payloads, joint 4 turned between"),
        ),
    ),
)
