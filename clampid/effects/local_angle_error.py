"""Angle error over a few degrees of a joint: a damaged tooth, a dent in a bearing's ring, dirt on an encoder's disc.

It repeats with every turn of the joint and is zero elsewhere. Harmonics describe it badly: a bump of 15 degrees needs
two dozen of them. Its place is not known beforehand: diagnosis tries every place that poses visited, and a fit starts
at the likeliest one. Any bump has a height, a middle and a width; the raised cosine is a smooth one of finite width.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import cos, pi, turned_by, within
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def error(p: Any, x: Any) -> Any:
    """Dq = h (1 + cos(2 pi d / w)) / 2 where |d|, the joint's angle from the middle, is below w / 2."""
    d = turned_by(x.q - p.middle)
    return 0.5 * p.height * (1.0 + cos(2.0 * pi * d / p.width)) * within(d, -0.5 * p.width, 0.5 * p.width)


EFFECT = Effect(
    name="local_angle_error",
    family="gear_eccentricity",
    acts={"joint_angle": error},
    parameters=(
        Parameter("height", "rad", 2e-4, "joint", (-0.05, 0.05), "angle error in the middle", role="angle_error"),
        Parameter("middle", "rad", pi, "joint", meaning="joint angle where it is largest", shape=True, grid=(0.0,)),
        Parameter(
            "width",
            "rad",
            0.13,
            "joint",
            (0.035, 1.05),
            "from where it begins to where it ends",
            shape=True,
            grid=(0.26, 0.13, 0.52),
        ),
    ),
    needs=("q",),
    stages=("poses",),
    equation="dq = h (1 + cos(2 pi d / w)) / 2 for |d| < w / 2, else 0; d = q - c, whole turns apart",
    source=("UniversalModel",),
    scanned="middle",
    meaning="periodic in the joint's angle, over a few degrees only",
    search=Search(scope="places", joint_kind="revolute"),
)
