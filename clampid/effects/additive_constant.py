"""Zero error of a distance instrument: a draw-wire's reel, a ballbar's ends, the internal path of a laser ranger.

Each anchor has its own constant, because anchors may belong to several instruments. Points do not identify it.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import dot
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def error(p: Any, x: Any) -> Any:
    """Dd = c of the row's anchor, along the way to the target."""
    return dot(p.c, x.anchor_is) * x.anchor_way


EFFECT = Effect(
    name="additive_constant",
    family="instrument_scale",
    acts={"measurement": error},
    parameters=(Parameter("c", "m", 1e-3, "anchor", meaning="error of distances from the anchor, > 0: too long"),),
    needs=("anchor_is", "anchor_way"),
    stages=("poses",),
    equation="dd = c",
    source=("ISO17123",),
    at="instrument",
    search=Search(scope="together"),
)
"""Part 4 of the source calls it the zero-point correction of a distance meter."""
