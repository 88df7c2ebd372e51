"""The clamp, or the block it sits on, yields to the wrench of the clamped arm: it rocks about a pivot, and shifts."""

from __future__ import annotations

from typing import Any

from clampid.algebra import cross, rows
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search, Separator


def motion(p: Any, x: Any) -> Any:
    """W = diag(c_r) (M - d x F), v = diag(c_t) F - w x d: d from the flange to the pivot."""
    moment, force = x.wrench[:3], x.wrench[3:]
    pivot = rows(p.dx, p.dy, p.dz)
    w = rows(p.crx, p.cry, p.crz) * (moment - cross(pivot, force))
    return rows(w, rows(p.cx, p.cy, p.cz) * force - cross(w, pivot))


EFFECT = Effect(
    name="fixture_compliance",
    family="fixture_compliance",
    acts={"fixture": motion},
    parameters=(
        *(Parameter(f"cr{a}", "rad/Nm", 1e-6, bounds=(0.0, 1e-2), meaning=f"rocks about {a} by moment") for a in "xyz"),
        *(Parameter(f"c{a}", "m/N", 1e-7, bounds=(0.0, 1e-3), meaning=f"shifts along {a} by force") for a in "xyz"),
        *(
            Parameter(
                f"d{a}", "m", 0.5, bounds=(-3.0, 3.0), meaning=f"pivot beyond the flange along {a}", shape=True, grid=g
            )
            for a, g in (("x", (0.0, 0.0, 0.0)), ("y", (0.0, 0.0, 0.0)), ("z", (0.0, -0.4, -0.8)))
        ),
    ),
    needs=("wrench",),
    stages=("clamped",),
    equation="w = diag(c_r) (M - d x F), v = diag(c_t) F - w x d; base frame, F on the fixture at the flange",
    source=("Thesis",),
    at="fixture",
    search=Search(
        separators=(
            Separator("joint_compliance", "a target on the fixture's block, or the same sweeps in a second posture"),
            Separator("cross_coupled_stiffness", "a target on the fixture's block"),
        )
    ),
)
