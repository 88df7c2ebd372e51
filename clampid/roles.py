"""What a parameter is in the field's terms, so that the core asks for a clearance or a mass and not for an effect.

An effect's file gives each parameter that the core needs to know a role and, where the role has several components, an
axis. A second law of clearance with the role ``clearance`` is a clearance wherever one is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

__all__ = ["FRAMES", "FRICTIONS", "INERTIAL", "INERTIAS", "ROLES", "WEIGHTS", "Role"]

Role = Literal[
    "", "base_frame", "link_frame", "flange_frame", "target_point", "anchor_point", "mass", "first_moment",
    "inertia_tensor", "rotor_inertia", "compliance", "cross_compliance", "clearance", "dry_friction",
    "viscous_damping", "friction", "arm_friction", "expansion", "angle_error", "reading_gain",
]  # fmt: skip

POINT = ("x", "y", "z")
TWIST = (*POINT, "rx", "ry", "rz")
ROLES: Mapping[Role, tuple[str, tuple[str, ...]]] = {
    "": ("nothing that the core asks for", ("",)),
    "base_frame": ("where the base stands, by shift and turn", TWIST),
    "link_frame": ("where a link's far end is, by shift and turn", TWIST),
    "flange_frame": ("where the flange is, by shift and turn", TWIST),
    "target_point": ("where a target is on the flange", POINT),
    "anchor_point": ("where the far end of measured distances is", POINT),
    "mass": ("mass of a link or tool beyond the description", ("",)),
    "first_moment": ("mass times centre of a link or tool beyond the description", POINT),
    "inertia_tensor": ("inertia of a link about its joint", ("xx", "yy", "zz", "xy", "xz", "yz")),
    "rotor_inertia": ("inertia about the joint's own axis, such as its rotor's", ("",)),
    "compliance": ("compliance of a drive's spring, at zero torque", ("",)),
    "cross_compliance": ("compliance between a drive and the one before it", ("",)),
    "clearance": ("width between the flanks of a drive", ("",)),
    "dry_friction": ("dry friction at the motor", ("",)),
    "viscous_damping": ("viscous friction at the motor", ("",)),
    "friction": ("a part of the motor's friction beyond these two", ("",)),
    "arm_friction": ("dry friction at the arm's side of a joint", ("",)),
    "angle_error": ("error of a joint's angle by a turn of its own", ("",)),
    "expansion": ("growth of a link by temperature", ("",)),
    "reading_gain": ("error of a motor's torque reading, per torque that the arm asks of it", ("",)),
}
"""Role → what it is, and its axes."""

FRAMES: tuple[Role, ...] = ("base_frame", "link_frame", "flange_frame", "target_point", "anchor_point")
WEIGHTS: tuple[Role, ...] = ("mass", "first_moment")
INERTIAS: tuple[Role, ...] = ("inertia_tensor", "rotor_inertia")
INERTIAL: tuple[Role, ...] = (*WEIGHTS, *INERTIAS)
FRICTIONS: tuple[Role, ...] = ("dry_friction", "viscous_damping", "friction")
