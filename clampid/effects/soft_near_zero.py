"""A drive that is soft at small loads, because its teeth engage one after the other: more compliance near zero."""

from __future__ import annotations

from typing import Any

from clampid.algebra import tanh
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def deflection(p: Any, x: Any) -> Any:
    """Dq = -T' (a s tanh(T tau/s)): additional compliance a at zero, which vanishes beyond the torque s."""
    load = x.transmission @ x.torque
    return -x.transmission.T @ (p.a * p.s * tanh(load / p.s))


EFFECT = Effect(
    name="soft_near_zero",
    family="nonlinear_stiffness",
    acts={"joint_angle": deflection},
    parameters=(
        Parameter(
            "a",
            "rad/Nm",
            1e-5,
            "joint",
            meaning="compliance near zero torque beyond the spring's, at the motor; size at the joint",
            gearing=2,
        ),
        Parameter(
            "s",
            "Nm",
            100.0,
            "joint",
            (10.0, 5e3),  # what is gone at a smaller torque is a clearance
            "torque at the motor beyond which it vanishes; size at the joint",
            shape=True,
            grid=(100.0, 30.0, 300.0),
            gearing=-1,
        ),
    ),
    needs=("torque",),
    stages=("clamped", "poses"),
    equation="d theta_m = tau_m/k + a s tanh(tau_m/s)",
    source=("Klimchik",),
    known_within="torque",
    search=Search(refines="joint_compliance"),
)
