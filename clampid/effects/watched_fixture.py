"""The clamp's motion as measured by a sensor on its block: rocking, shifting, a slip in the middle of a sweep.

A share of 1 means that the flange moved as the sensor measured. Any other value means that the sensor's axes, units or
signs differ from the assumed ones, or that it does not move with the flange.
"""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter


def motion(p: Any, x: Any) -> Any:
    """(w, v) = share * the sensor's reading."""
    return p.share * x.fixture_motion


EFFECT = Effect(
    name="watched_fixture",
    family="fixture_compliance",
    acts={"fixture": motion},
    parameters=(Parameter("share", "", 1.0, meaning="share of the watched motion that the flange took part in"),),
    needs=("fixture_motion",),
    stages=("clamped",),
    equation="(w, v) = share * (w, v) by the sensor; base frame, about the flange",
    source=("Thesis",),
    at="fixture",
)
