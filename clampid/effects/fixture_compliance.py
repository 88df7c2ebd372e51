"""The clamp, or the block it sits on, yields under the wrench of the clamped arm."""

from __future__ import annotations

from typing import Any

from clampid.algebra import rows
from clampid.effect import Effect, Parameter


def motion(p: Any, x: Any) -> Any:
    """(w, v) = diag(c_r, c_t) F, F the wrench on the fixture."""
    return rows(p.crx, p.cry, p.crz, p.cx, p.cy, p.cz) * x.wrench


EFFECT = Effect(
    name="fixture_compliance",
    family="fixture_compliance",
    acts={"fixture": motion},
    parameters=(
        *(
            Parameter(f"cr{a}", "rad/Nm", 1e-6, bounds=(0.0, 1e-2), meaning=f"fixture turns about {a} by moment")
            for a in "xyz"
        ),
        *(
            Parameter(f"c{a}", "m/N", 1e-7, bounds=(0.0, 1e-3), meaning=f"fixture yields along {a} by force")
            for a in "xyz"
        ),
    ),
    needs=("wrench",),
    stages=("clamped",),
    equation="dx = C_f F, C_f diagonal in the base frame",
    source=("Thesis",),
    at="fixture",
)
