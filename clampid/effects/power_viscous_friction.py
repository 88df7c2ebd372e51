"""Lubricant friction that grows less than in proportion to speed: grease that thins as it is sheared."""

from __future__ import annotations

from typing import Any

from clampid.algebra import exp, log
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search

LINEAR_BELOW = 1e-3  # of the reference speed: the power's slope is infinite at rest, a film's is not


def torque(p: Any, x: Any) -> Any:
    """tau_motor = F_p sign(w) |w / w_r|^a, for |w| far above w_r / 1000."""
    w = x.motor_speed / p.wr
    return p.Fp * w * exp(0.5 * (p.a - 1.0) * log(w**2 + LINEAR_BELOW**2))


EFFECT = Effect(
    name="power_viscous_friction",
    family="viscous_friction",
    acts={"motor_torque": torque},
    parameters=(
        Parameter(
            "Fp",
            "Nm",
            30.0,
            "joint",
            (0.0, 1e6),
            "viscous friction at the reference speed, at the motor",
            gearing=-1,
            role="friction",
        ),
        Parameter("a", "", 0.2, "joint", (0.2, 0.95), "exponent of speed, below 1", True, (0.6, 0.4, 0.8)),
        Parameter(
            "wr",
            "rad/s",
            1.0,
            "joint",
            meaning="reference speed, 1 rad/s at the joint",
            shape=True,
            grid=(1.0, 1.0, 1.0),  # beside the exponents'
            fixed="everywhere",
            gearing=1,
        ),
    ),
    needs=("motor_speed",),
    stages=("free_air",),
    equation="tau_motor = F_p sign(w) |w/w_r|^a, w_r = 1 rad/s at the joint",
    source=("Bittencourt2010",),
    search=Search(refines="viscous_friction"),
)
