"""Axes of an arm that are tilted against their description: weight turns about other axes than the model's.

Housings are machined and bearings seated to some tenths of a milliradian. Of an inclined first axis
`base_inclination` is the same. The effect is of first order and uses the described masses. Shifts of an axis are left
out: `gravity` takes them up as first moments of the link before it.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import interleave
from clampid.effect import Effect, Parameter


def torque(p: Any, x: Any) -> Any:
    """D tau = dtau/d(alpha, beta) (alpha, beta)."""
    return x.axis_torque @ interleave(p.alpha, p.beta)


EFFECT = Effect(
    name="axis_misalignment",
    family="axis_misalignment",
    acts={"joint_torque": torque},
    parameters=tuple(
        Parameter(
            name,
            "rad",
            5e-4,
            "joint",
            spread=5.0,  # two and a half millimetres a metre
            meaning=f"tilt of the joint's axis about the {which} axis across it",
        )
        for name, which in (("alpha", "first"), ("beta", "second"))
    ),
    needs=("axis_torque",),
    stages=("free_air",),
    equation="tau = tau(axes turned by w_i), w_i = alpha_i u_i + beta_i (a_i x u_i), i > 1",
    source=("LynchPark2017",),
    caveat="uses the described masses: the relative error of the angles is at least that of the masses, about 10 %",
)
