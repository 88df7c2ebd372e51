"""Springs that couple two neighbouring drives, in addition to the coupling by the transmission."""

from __future__ import annotations

from typing import Any

from clampid.algebra import shifted_down, shifted_up
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def deflection(p: Any, x: Any) -> Any:
    """Dq = -T' X T tau, X symmetric with x_i between drives i - 1 and i."""
    load = x.transmission @ x.torque
    wound = p.x * shifted_up(load) + shifted_down(p.x * load)
    return -x.transmission.T @ wound


EFFECT = Effect(
    name="cross_coupled_stiffness",
    family="cross_coupled_stiffness",
    acts={"joint_angle": deflection},
    parameters=(
        Parameter(
            "x",
            "rad/Nm",
            1e-5,
            "joint",
            meaning="compliance between this drive and the one before it, at the motors; size at the joint",
            gearing=2,
            role="cross_compliance",
        ),
    ),
    needs=("torque",),
    stages=("clamped", "poses"),
    equation="dq = -T' X T tau, X_(i-1,i) = X_(i,i-1) = x_i",
    source=("Thesis", "Klimchik"),
    search=Search(scope="places", refines="joint_compliance"),
)
