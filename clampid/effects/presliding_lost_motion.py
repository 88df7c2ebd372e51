"""Lost motion that builds up over a way: after a reversal a joint first lags less, and then by all of its lost motion.

The friction of a gear does not change its sign at once. Its contacts deform, and follow the motion over a length
(Dahl). A joint that has gone a short way since it turned back is therefore not yet on the side of its lost motion. What
is missing then falls with that way, which follows from the order of the visits. A last motion against the way from the
visit before it is short by its purpose, and nobody records how short: what is missing there is a parameter of its own.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import exp
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search, Separator


def missing(p: Any, x: Any) -> Any:
    """Dq = dir (h exp(-w / l) + g r): what is missing of -h/2 dir, on which side a joint stops after a long way."""
    return x.direction * (p.missing * exp(-x.reversal_way / p.length) + p.short * x.turned_back)


EFFECT = Effect(
    name="presliding_lost_motion",
    family="hysteresis",
    acts={"joint_angle": missing},
    parameters=(
        Parameter(
            "missing", "rad", 1e-4, "joint", (0.0, 2e-2), "lost motion of a long way, less that just after a reversal"
        ),
        Parameter("short", "rad", 1e-4, "joint", (0.0, 2e-2), "the same, less that after a short way to the pose"),
        Parameter(
            "length",
            "rad",
            0.1,
            "joint",
            (3e-3, 1.0),
            "way over which 63 % of it builds up",
            shape=True,
            grid=(0.1, 0.03, 0.3),
        ),
    ),
    needs=("direction", "reversal_way", "turned_back"),
    stages=("poses",),
    equation="dq = dir (h exp(-w/l) + g r), w the way since the last reversal; r = 1 if the last motion was against it",
    source=("Olsson1998",),
    search=Search(
        separators=(
            Separator(
                "backlash",
                "poses approached after ways of different lengths since the last reversal, from both sides",
                same_stage=True,
            ),
        )
    ),
)
