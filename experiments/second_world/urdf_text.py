"""Writes an arm as URDF: the description that a campaign refers to, and the way into pinocchio."""

from collections.abc import Sequence

import numpy as np

from experiments.second_world.arms import Arm, Body
from experiments.second_world.arrays import Array

__all__ = ["urdf_text"]


def _numbers(values: Array) -> str:
    return " ".join(f"{v:.12g}" for v in np.atleast_1d(values))


def _origin(xyz: Array, rpy: Array) -> str:
    return f'<origin xyz="{_numbers(xyz)}" rpy="{_numbers(rpy)}"/>'


def _inertial(body: Body) -> str:
    I = body.inertia_kg_m2  # noqa: E741 the symbol of every textbook
    terms = {"ixx": I[0, 0], "ixy": I[0, 1], "ixz": I[0, 2], "iyy": I[1, 1], "iyz": I[1, 2], "izz": I[2, 2]}
    inertia = " ".join(f'{k}="{v:.12g}"' for k, v in terms.items())
    return (
        f'<inertial>{_origin(body.com_m, np.zeros(3))}<mass value="{body.mass_kg:.12g}"/>'
        f"<inertia {inertia}/></inertial>"
    )


def urdf_text(arm: Arm, friction: Sequence[tuple[float, float]] | None = None) -> str:
    """
    Write an arm as URDF.

    Parameters
    ----------
    arm
        The arm. Its flange becomes the frame tool0.
    friction
        Coulomb friction, Nm, and viscous friction, Nm s/rad, of each joint, where the maker states them.

    Returns
    -------
    str
        The text of the file.
    """
    lines = ['<?xml version="1.0"?>', f'<robot name="{arm.name}">', '<link name="base_link"/>']
    parent = "base_link"
    for i, (joint, body) in enumerate(zip(arm.joints, arm.bodies, strict=True), start=1):
        dynamics = ""
        if friction is not None:
            coulomb, viscous = friction[i - 1]
            dynamics = f'<dynamics friction="{coulomb:.6g}" damping="{viscous:.6g}"/>'
        lines += [
            f'<link name="link_{i}">{_inertial(body)}</link>',
            f'<joint name="joint_{i}" type="revolute"><parent link="{parent}"/><child link="link_{i}"/>'
            f"{_origin(joint.xyz_m, joint.rpy_rad)}"
            f'<axis xyz="{_numbers(joint.axis)}"/>'
            f'<limit lower="{joint.lower_rad:.9g}" upper="{joint.upper_rad:.9g}" '
            f'velocity="{joint.max_speed_rad_s:.9g}" effort="{joint.max_torque_Nm:.9g}"/>{dynamics}</joint>',
        ]
        parent = f"link_{i}"
    lines += [
        '<link name="tool0"/>',
        f'<joint name="flange" type="fixed"><parent link="{parent}"/><child link="tool0"/>'
        f"{_origin(arm.flange_xyz_m, arm.flange_rpy_rad)}</joint>",
        "</robot>",
        "",
    ]
    return "\n".join(lines)
