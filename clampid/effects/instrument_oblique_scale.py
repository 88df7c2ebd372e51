"""A scale error of the instrument along axes other than those of its frame, or axes that are not perpendicular.

A camera's frame is often aligned with an object of the cell, not with the camera. The common scale error of all
directions is :mod:`clampid.effects.instrument_scale`; a common rotation is part of the instrument's frame.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import rows
from clampid.effect import Effect, Parameter

BOUNDS = (-0.05, 0.05)


def error(p: Any, x: Any) -> Any:
    """Dx = S x with S symmetric and without a trace, in the instrument's frame."""
    a, b, c = x.position[0], x.position[1], x.position[2]
    return rows(
        p.x * a + p.xy * b + p.xz * c,
        p.xy * a + p.y * b + p.yz * c,
        p.xz * a + p.yz * b - (p.x + p.y) * c,
    )


EFFECT = Effect(
    name="instrument_oblique_scale",
    family="instrument_scale",
    acts={"measurement": error},
    parameters=(
        Parameter("x", "", 1e-4, bounds=BOUNDS, meaning="scale error along x beyond the mean of the three axes"),
        Parameter("y", "", 1e-4, bounds=BOUNDS, meaning="the same along y; along z it is -(x + y)"),
        Parameter("xy", "", 1e-4, bounds=BOUNDS, meaning="half the angle error between x and y, rad"),
        Parameter("xz", "", 1e-4, bounds=BOUNDS, meaning="half the angle error between x and z, rad"),
        Parameter("yz", "", 1e-4, bounds=BOUNDS, meaning="half the angle error between y and z, rad"),
    ),
    needs=("position",),
    stages=("poses",),
    equation="dx = S x, S = S', tr S = 0",
    source=("VDI2634",),
    at="instrument",
)
