"""Depth error of a camera that grows with the square of the range, from an error of its disparities."""

from __future__ import annotations

from typing import Any

from clampid.algebra import norm
from clampid.effect import Effect, Parameter


def error(p: Any, x: Any) -> Any:
    """Dr = k r^2: dx = k |x| x, in the instrument's frame."""
    return p.k * norm(x.position) * x.position


EFFECT = Effect(
    name="instrument_range_square",
    family="instrument_scale",
    acts={"measurement": error},
    parameters=(Parameter("k", "1/m", 1e-4, meaning="error of ranges over their square, > 0: too long"),),
    needs=("position",),
    stages=("poses",),
    equation="dr = k r^2",
    source=("HartleyZisserman2004",),
    at="instrument",
)
"""Of two cameras b apart, of focal length f, a point at depth z has the disparity d = b f / z; d off by e makes z off
by z^2 e / (b f), along the line of sight.
"""
