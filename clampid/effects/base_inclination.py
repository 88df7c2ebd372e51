"""A base that is not level: gravity has another direction than the campaign states.

Machines are levelled to about 1 mrad; the axis of joint 1 is square to its base plate to a few tenths of that. The
effect is of first order and uses the described masses.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import rows
from clampid.effect import Effect, Parameter


def torque(p: Any, x: Any) -> Any:
    """D tau = dtau/dw w, w = (roll, pitch)."""
    return x.inclination_torque @ rows(p.roll, p.pitch)


EFFECT = Effect(
    name="base_inclination",
    family="base_inclination",
    acts={"joint_torque": torque},
    parameters=tuple(
        Parameter(
            name,
            "rad",
            1e-3,
            spread=5.0,  # five millimetres a metre
            meaning=f"inclination of the base about its {which} horizontal axis, {axis} where the robot stands upright",
        )
        for name, which, axis in (("roll", "first", "x"), ("pitch", "second", "y"))
    ),
    needs=("inclination_torque",),
    stages=("free_air",),
    equation="g' = g + g x w, w = (roll, pitch) about the base's horizontal axes",
    source=("LynchPark2017",),
    at="base",
    caveat="uses the described masses: the relative error of the angles is at least that of the masses, about 10 %",
)
