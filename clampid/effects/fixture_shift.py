"""The block to which the flange is clamped slips once, in the middle of a sweep, and stays in its new place.

The posture at which each sweep was clamped is unknown, so later sweeps do not show the slip. Only the sweep in which
it happened identifies it.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import floor, rows, within
from clampid.effect import Effect, Parameter


def motion(p: Any, x: Any) -> Any:
    """(w, v) = (r, d) after the slip, zero before it and in other sweeps."""
    return rows(p.rx, p.ry, p.rz, p.x, p.y, p.z) * within(x.sweep_progress, p.at, floor(p.at) + 1.0)


EFFECT = Effect(
    name="fixture_shift",
    family="fixture_compliance",
    acts={"fixture": motion},
    parameters=(
        *(Parameter(a, "m", 1e-4, bounds=(-1e-2, 1e-2), meaning=f"slipped along {a}") for a in "xyz"),
        *(Parameter(f"r{a}", "rad", 1e-4, bounds=(-1e-2, 1e-2), meaning=f"turned about {a}") for a in "xyz"),
        Parameter(
            "at",
            "",
            1.0,
            bounds=(0.0, 1e6),
            meaning="when: sweeps before, and the share of the sweep's rows before; between two rows",
            shape=True,
            grid=(0.47,),
            fixed="everywhere",
        ),
    ),
    needs=("sweep_progress",),
    stages=("clamped",),
    equation="(w, v) = (r, d) once sweep_progress > at, in that sweep; base frame, about the flange",
    source=("Thesis",),
    at="fixture",
    event="at",
    caveat="the true uncertainty of the slip is slightly larger than stated: friction of motors at rest may hide which "
    "clearances were crossed; on eight virtual robots 90 % of the 95 % intervals contained the true value",
)
