"""A scale error of the instrument: all lengths are too long, or too short, by the same factor."""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter
from clampid.search_policy import Search, Separator


def error(p: Any, x: Any) -> Any:
    """Dx = s x, in the instrument's frame."""
    return p.s * x.position


EFFECT = Effect(
    name="instrument_scale",
    family="instrument_scale",
    acts={"measurement": error},
    parameters=(Parameter("s", "", 2e-5, bounds=(-0.01, 0.01), meaning="scale error"),),
    needs=("position",),
    stages=("poses",),
    equation="dx = s x",
    source=("ISO9283",),
    at="instrument",
    search=Search(separators=(Separator("geometry", "a certified distance between two targets"),)),
)
