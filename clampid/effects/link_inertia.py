"""Inertia of each link about the joint that carries it, beyond the description's: full rigid-body dynamics.

Together with `gravity`, whose masses and first moments act in acceleration too, and with `inertia`, in which the rotors
are, this is every torque of a tree of rigid bodies.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import interleave
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search

NAMES = ("Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")


def torque(p: Any, x: Any) -> Any:
    """D tau = Y_I(q, q', q'') dI."""
    return x.link_inertia_regressor @ interleave(*(getattr(p, name) for name in NAMES))


EFFECT = Effect(
    name="link_inertia",
    family="inertia",
    acts={"joint_torque": torque},
    parameters=tuple(
        Parameter(
            name,
            "kg m^2",
            2.0,
            "link",
            meaning=f"{name} about the link's joint beyond the description's, base axes at the zero pose",
            role="inertia_tensor",
            axis=name.removeprefix("I"),
        )
        for name in NAMES
    ),
    needs=("link_inertia_regressor",),
    stages=("free_air",),
    equation="d tau = Y_I(q, q', q'') d(Ixx, Iyy, Izz, Ixy, Ixz, Iyz)",
    source=("LynchPark2017",),
    search=Search(refines="inertia", scope="together"),
)
