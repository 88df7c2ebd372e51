"""Sets of effects by name, each with its reason: with :mod:`clampid.effects` the one place that knows them so."""

from __future__ import annotations

from collections.abc import Mapping

from clampid.signals import Stage

__all__ = ["ARM_SIDE", "DRAWN", "DYNAMICS", "LINK_WEIGHT", "POSES_ALONE", "POSES_DIRECTED", "STANDARD", "WRIST"]

STANDARD: Mapping[Stage, tuple[str, ...]] = {
    "free_air": ("gravity", "coulomb_friction", "viscous_friction", "wrist_coupling_friction"),
    "clamped": ("joint_compliance", "backlash", "coulomb_friction"),
    "poses": ("geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction"),
    "inclination": ("base_tilt",),
}
"""What every geared arm has, and what its own stage measures well. Everything else is for diagnosis to find.

Poses take weight and arm-side friction from logs: these decide on which flank a joint stands.
"""
POSES_ALONE: tuple[str, ...] = ("geometry", "joint_compliance")
"""Of poses without logs and sweeps: nothing says what links weigh beyond the description, nor what joints rub."""
POSES_DIRECTED: tuple[str, ...] = ("backlash",)
"""Besides, where approach directions were recorded: without them no pose says on which flank a joint stands."""
DYNAMICS: tuple[str, ...] = ("inertia", "link_inertia")
"""Besides, of logs that do not always move steadily: rows in acceleration would not count without it."""
WRIST: tuple[str, ...] = ("coulomb_friction", "viscous_friction")
"""Per motor of a coupled wrist: what its runs are planned to separate from friction on the arm's side."""
ARM_SIDE = "wrist_coupling_friction"
"""The friction that those runs are planned for."""
LINK_WEIGHT = "gravity"
"""Of the links beyond the wrist: they load the same motors."""
DRAWN: tuple[str, ...] = (
    "gear_eccentricity", "thermal_expansion", "stribeck_friction", "fixture_compliance", "base_tilt", "torque_offset",
    "payload",
)  # fmt: skip
"""What a demonstration may hide: the catalogue knows it, the standard sets lack it. The order decides what a seed
draws."""
