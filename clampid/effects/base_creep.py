"""A base that creeps with the logarithm of time, as grout, anchors and bolted joints do, each session anew.

The pose of the base is a parameter of each session, so only its change during the session is identifiable. An
instrument that creeps on its stand moves all points in the same way; no pose separates the two.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import dot, log, rows
from clampid.effect import Effect, Parameter


def creep(p: Any, x: Any) -> Any:
    """(w, v) = (r, d) log(1 + t/t_0), t since the session's first row."""
    passed = log(1 + x.elapsed / p.t0)
    return rows(*(dot(part, x.session_is) * passed for part in (p.rx, p.ry, p.rz, p.x, p.y, p.z)))


EFFECT = Effect(
    name="base_creep",
    family="base_tilt",
    acts={"base_twist": creep},
    parameters=(
        *(
            Parameter(a, "m", 1e-4, "session", (-0.05, 0.05), f"creeps along {a} while time grows e-fold")
            for a in "xyz"
        ),
        *(
            Parameter(f"r{a}", "rad", 1e-4, "session", (-0.05, 0.05), f"tilts about {a} while time grows e-fold")
            for a in "xyz"
        ),
        Parameter(
            "t0", "s", 900.0, bounds=(10.0, 1e5), meaning="when it began, before", shape=True, grid=(300.0, 3000.0)
        ),
    ),
    needs=("elapsed", "session_is"),
    stages=("poses",),
    equation="(w, v) = (r, d) log(1 + t/t_0), base frame, about its origin",
    source=("XCTDrift",),
    at="base",
)
