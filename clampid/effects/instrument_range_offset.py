"""An instrument of ranges and angles whose zero of ranges is off: points lie too far out along the line of sight."""

from __future__ import annotations

from typing import Any

from clampid.algebra import fmax, norm
from clampid.effect import Effect, Parameter

NEAREST_POINT = 1e-3  # m: no instrument sees so near; what is no point, but a distance, stands at the origin


def error(p: Any, x: Any) -> Any:
    """Dr = c: dx = c x / |x|, in the instrument's frame."""
    return p.c * x.position / fmax(norm(x.position), NEAREST_POINT)


EFFECT = Effect(
    name="instrument_range_offset",
    family="instrument_scale",
    acts={"measurement": error},
    parameters=(Parameter("c", "m", 1e-4, meaning="what ranges from the instrument's origin are too long by"),),
    needs=("position",),
    stages=("poses",),
    equation="dr = c",
    source=("ISO17123",),
    at="instrument",
)
