"""What nobody said: what a cell file and a robot description leave to defaults, and what a model makes nothing of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from kinematics.robot import RobotDescription

if TYPE_CHECKING:
    from offline_ik.arm import IdentifiedArm
    from offline_ik.cell import Cell

__all__ = ["assumed_of", "notes_of"]

# Each default by the part and key of a cell file that would say it; no key: anything in that part.
_DEFAULTS = {
    "convention": ("convention", "name"),
    "sample": ("convention", "sample_m"),
    "beam": ("convention", "beam"),
    "detector at the flange": ("detector", "position_m"),
    "a detector without a body": ("detector", "size_m"),
    "tool at the flange": ("tool", "com_m"),
    "no obstacles": ("", "obstacle"),
    "gravity": ("", "gravity_m_s2"),
    "20 degC": ("temperature", ""),
    "link radii from the arm's reach": ("robot_shape", "radius_m"),
    "base radius from the arm's reach": ("robot_shape", "base_radius_m"),
    "clearance of 20 mm": ("safety", "clearance_m"),
    "speed of 0.3 of the greatest": ("safety", "speed"),
}


def assumed_of(table: Mapping[str, Any], robot: RobotDescription) -> tuple[str, ...]:
    """What a cell file and the robot's description leave open, in words.

    Parameters
    ----------
    table
        The cell file, checked; empty without one.
    """
    out = []
    for name, (part, key) in _DEFAULTS.items():
        said = table.get(part, {}) if part else table
        if not (key in said if key else said):
            out.append(name)
    if np.array_equal(np.asarray(robot.transmission), np.eye(robot.n)):
        out.append("motors turn as joints do (no gears are described)")
    if any(not joint.max_speed for joint in robot.joints):
        out.append("joints of 180 deg/s where no greatest speed is described")
    return tuple(out)


def notes_of(arm: IdentifiedArm, cell: Cell) -> tuple[str, ...]:
    """What a cell says and the model makes nothing of: temperatures without an effect that reads them."""
    read = {signal for slot in arm.slots for signal in arm.effects[slot.effect].needs}
    given = {"link": cell.link_temperature, "motor": cell.motor_temperature}
    return tuple(
        f"the model has no effect of the {name} temperatures: they change nothing"
        for name, values in given.items()
        if values is not None and f"{name}_temperature" not in read
    )
