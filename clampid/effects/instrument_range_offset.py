"""Zero error of ranges of an instrument that measures ranges and angles: points are too far along the line of sight."""

from __future__ import annotations

from typing import Any

from clampid.algebra import fmax, norm
from clampid.effect import Effect, Parameter

NEAREST_POINT = 1e-3  # m: no instrument measures so near; rows of distances are at the origin


def error(p: Any, x: Any) -> Any:
    """Dr = c: dx = c x / |x|, in the instrument's frame."""
    return p.c * x.position / fmax(norm(x.position), NEAREST_POINT)


EFFECT = Effect(
    name="instrument_range_offset",
    family="instrument_scale",
    acts={"measurement": error},
    parameters=(Parameter("c", "m", 1e-4, meaning="error of ranges from the instrument's origin, > 0: too long"),),
    needs=("position",),
    stages=("poses",),
    equation="dr = c",
    source=("ISO17123",),
    at="instrument",
)
