"""A scale error of the instrument that differs between its axes, as of a stereo camera in depth.

Their common scale error is :mod:`clampid.effects.instrument_scale`.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import rows
from clampid.effect import Effect, Parameter

BOUNDS = (-0.05, 0.05)


def error(p: Any, x: Any) -> Any:
    """Dx = diag(s_x, s_y, -(s_x + s_y)) x, in the instrument's frame."""
    return rows(p.x, p.y, -(p.x + p.y)) * x.position


EFFECT = Effect(
    name="instrument_axis_scale",
    family="instrument_scale",
    acts={"measurement": error},
    parameters=(
        Parameter("x", "", 1e-4, bounds=BOUNDS, meaning="scale error along x beyond the mean of the three axes"),
        Parameter("y", "", 1e-4, bounds=BOUNDS, meaning="the same along y; along z it is -(x + y)"),
    ),
    needs=("position",),
    stages=("poses",),
    equation="dx = S x, S = diag(s_x, s_y, -(s_x + s_y))",
    source=("VDI2634",),
    at="instrument",
)
