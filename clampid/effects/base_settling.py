"""A base that settles: pedestal, anchors and floor creep, or the column warms up, each session anew.

The pose of the base is a parameter of each session, so only its change during the session is identifiable. An
instrument that drifts on its stand moves all points in the same way; no pose separates the two.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import dot, exp, rows
from clampid.effect import Effect, Parameter

HOUR = 3600.0


def settling(p: Any, x: Any) -> Any:
    """(w, v) = (r, d) (1 - exp(-t/tau)), t since the session's first row."""
    passed = 1 - exp(-x.elapsed / p.tau)
    return rows(*(dot(part, x.session_is) * passed for part in (p.rx, p.ry, p.rz, p.x, p.y, p.z)))


EFFECT = Effect(
    name="base_settling",
    family="base_tilt",
    acts={"base_twist": settling},
    parameters=(
        *(Parameter(a, "m", 1e-4, "session", (-0.05, 0.05), f"settled along {a} in the end") for a in "xyz"),
        *(Parameter(f"r{a}", "rad", 1e-4, "session", (-0.05, 0.05), f"tilted about {a} in the end") for a in "xyz"),
        Parameter(
            "tau",
            "s",
            3 * HOUR,
            bounds=(60.0, 3e5),
            meaning="time constant",
            shape=True,
            grid=(HOUR, 0.25 * HOUR, 8 * HOUR),
        ),
    ),
    needs=("elapsed", "session_is"),
    stages=("poses",),
    equation="(w, v) = (r, d) (1 - exp(-t/tau)), base frame, about its origin",
    source=("XCTDrift", "IRB1200Drift"),
    at="base",
)
