"""The clamp's motion as a sensor on its block saw it, whatever moved it: rocking, shifting, a slip in the middle.

A share of 1 says that the flange went as the sensor says; anything else that the sensor's axes, units or signs are not
what they are taken for, or that it does not watch the flange.
"""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter


def motion(p: Any, x: Any) -> Any:
    """(w, v) = share * what the sensor read."""
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
