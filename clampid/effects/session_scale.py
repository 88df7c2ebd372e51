"""A scale error of the instrument that differs between the campaigns of one robot.

A scale error common to all campaigns is :mod:`clampid.effects.instrument_scale`, or a larger arm; a model has one of
the two effects, not both.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import dot
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def error(p: Any, x: Any) -> Any:
    """Dx = s x of the session, in the instrument's frame."""
    return dot(p.s, x.session_is) * x.position


EFFECT = Effect(
    name="session_scale",
    family="instrument_scale",
    acts={"measurement": error},
    parameters=(Parameter("s", "", 2e-5, "session", (-0.01, 0.01), "scale error in the session"),),
    needs=("position", "session_is"),
    stages=("poses",),
    equation="dx = s x of the session",
    source=("ISO9283",),
    at="instrument",
    search=Search(opt_in=True),
)
