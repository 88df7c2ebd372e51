"""Lost motion that depends on the path: parts of a drive that stick, are wound up, and slip again after each reversal.

Maxwell slip, Bouc-Wen and Dahl's law cannot be told apart in such sweeps, so that the effect goes by its family.
"""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter


def torque(p: Any, x: Any) -> Any:
    """tau_joint = sum_k h_k z_k: three elements of fixed widths, z_k from -1 to +1."""
    return p.h1 * x.slip[:, 0] + p.h2 * x.slip[:, 1] + p.h3 * x.slip[:, 2]


EFFECT = Effect(
    name="hysteresis",
    family="hysteresis",
    acts={"joint_torque": torque},
    parameters=tuple(
        Parameter(f"h{k + 1}", "Nm", 5.0, "joint", (0.0, 1e4), f"torque at which what slips after {after} slips")
        for k, after in enumerate(("a tenth of the sweep", "three tenths", "most of it"))
    ),
    needs=("slip",),
    stages=("clamped",),
    equation="tau_joint = sum_k h_k z_k, z_k the state of a stop operator on q of fixed width, -1 to +1",
    source=("Olsson1998",),
)
