"""The block to which the flange is clamped creeps during a sweep.

The posture at which each sweep was clamped is unknown, so only changes within a sweep identify the creep.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import rows
from clampid.effect import Effect, Parameter


def motion(p: Any, x: Any) -> Any:
    """(w, v) = (r, d) times the elapsed share of the sweep."""
    return rows(p.rx, p.ry, p.rz, p.x, p.y, p.z) * x.sweep_fraction


EFFECT = Effect(
    name="fixture_creep",
    family="fixture_compliance",
    acts={"fixture": motion},
    parameters=(
        *(Parameter(a, "m", 1e-4, bounds=(-1e-2, 1e-2), meaning=f"crept along {a} in a sweep") for a in "xyz"),
        *(Parameter(f"r{a}", "rad", 1e-4, bounds=(-1e-2, 1e-2), meaning=f"turned about {a} in a sweep") for a in "xyz"),
    ),
    needs=("sweep_fraction",),
    stages=("clamped",),
    equation="(w, v) = (r, d) s, s from 0 to 1 in each sweep; base frame, about the flange",
    source=("Thesis",),
    at="fixture",
)
