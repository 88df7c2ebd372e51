"""Hysteresis of a drive: parts of its spring stick, are wound up, and slip again after each reversal of the load.

Makers of gears show it as a loop of torsion over torque. Such sweeps do not distinguish Maxwell slip, Bouc-Wen and
Dahl's law, so the effect is named after their family.
"""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter
from clampid.search_policy import Search, Separator


def lag(p: Any, x: Any) -> Any:
    """Dq = sum_k a_k z_k: three elements that slip at fixed loads, z_k from -1 to +1."""
    return p.a1 * x.slip[:, 0] + p.a2 * x.slip[:, 1] + p.a3 * x.slip[:, 2]


EFFECT = Effect(
    name="hysteresis",
    family="hysteresis",
    acts={"joint_angle": lag},
    parameters=tuple(
        Parameter(f"a{k + 1}", "rad", 1e-4, "joint", (0.0, 2e-2), f"half the width of the loop of what slips {when}")
        for k, when in enumerate(("after a tenth of the load's amplitude", "after three tenths", "after most of it"))
    ),
    needs=("slip",),
    stages=("clamped",),
    equation="dq = sum_k a_k z_k, z_k the state of a stop operator on the joint's load, -1 to +1",
    source=("Olsson1998",),
    search=Search(
        separators=(
            Separator("backlash", "nested small loops: at least two amplitudes of reversal", same_stage=True),
            Separator("load_dependent_friction", "the same sweep at two loads with free-air logs at both"),
        )
    ),
)
