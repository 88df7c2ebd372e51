"""Geometric errors: places of joints, base, flange and targets, as small motions in the product of exponentials.

Each link carries a small motion of its far end, which moves the screws of all joints after it. Base, flange, targets
and the anchors of distances belong to a session of measurement; each session has its own. Which of these parameters are
identifiable follows from the robot, not from their names: see :mod:`clampid.fitting.gauge`.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import columns, dot, rows
from clampid.effect import Effect, Parameter, Per
from clampid.roles import Role
from clampid.search_policy import Search


def base(p: Any, x: Any) -> Any:
    """Motion of the base, (w, v)."""
    parts = (p.base_rx, p.base_ry, p.base_rz, p.base_x, p.base_y, p.base_z)
    return rows(*(dot(part, x.session_is) for part in parts))


def link(p: Any, x: Any) -> Any:
    """Motion of each link's far end, (w, v), one row a link; the last link's is the flange's own."""
    own = columns(p.rx, p.ry, p.rz, p.x, p.y, p.z)
    flange = [dot(f, x.session_is) for f in (p.flange_rx, p.flange_ry, p.flange_rz, p.flange_x, p.flange_y, p.flange_z)]
    return rows(own[:-1, :], own[-1, :] + columns(*flange))


def target(p: Any, x: Any) -> Any:
    """Shift of the row's target in the flange frame."""
    return rows(*(dot(part, x.target_is) for part in (p.target_x, p.target_y, p.target_z)))


def anchor(p: Any, x: Any) -> Any:
    """Change of the vector from the row's anchor to the target, for an anchor that is off by a: -a."""
    return -rows(*(dot(part, x.anchor_is) for part in (p.anchor_x, p.anchor_y, p.anchor_z)))


def _frame(role: Role, prefix: str, per: Per, what: str) -> tuple[Parameter, ...]:
    return (
        *(
            Parameter(f"{prefix}{a}", "m", 1e-3, per, meaning=f"{what} moved along {a}", role=role, axis=a)
            for a in "xyz"
        ),
        *(
            Parameter(f"{prefix}r{a}", "rad", 2e-3, per, meaning=f"{what} turned about {a}", role=role, axis=f"r{a}")
            for a in "xyz"
        ),
    )


EFFECT = Effect(
    name="geometry",
    family="geometry",
    acts={"base_twist": base, "link_twist": link, "target_shift": target, "measurement": anchor},
    parameters=(
        *_frame("base_frame", "base_", "session", "base"),
        *(
            Parameter(
                f"target_{a}",
                "m",
                1e-3,
                "target",
                meaning=f"target off along {a} of the flange",
                role="target_point",
                axis=a,
            )
            for a in "xyz"
        ),
        *(
            Parameter(
                f"anchor_{a}",
                "m",
                1e-3,
                "anchor",
                spread=100.0,
                meaning=f"anchor off along {a}, instrument frame",
                role="anchor_point",
                axis=a,
            )
            for a in "xyz"
        ),
        *_frame("flange_frame", "flange_", "session", "flange"),
        *_frame("link_frame", "", "link", "far end of the link, in base axes at the zero pose,"),
    ),
    needs=("session_is", "target_is", "anchor_is"),
    stages=("poses",),
    equation="T = B prod exp([xi_i] q_i) M_i; M_i the motion of link i's far end",
    source=("UniversalModel", "LynchPark2017"),
    search=Search(scope="together"),
)
