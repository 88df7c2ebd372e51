"""What a cell file and a robot description leave to defaults."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from kinematics.robot import RobotDescription

__all__ = ["assumed_of"]

# Each default by the part and key of a cell file that would say it.
_DEFAULTS = {
    "convention": ("convention", "name"),
    "sample": ("convention", "sample_m"),
    "beam": ("convention", "beam"),
    "detector at the flange": ("detector", "position_m"),
    "a detector without a body": ("detector", "size_m"),
    "tool at the flange": ("tool", "com_m"),
    "tool as heavy as the campaign says": ("tool", "mass_kg"),
    "no obstacles": ("", "obstacle"),
    "gravity": ("", "gravity_m_s2"),
    "links of 20 degC": ("temperature", "link_C"),
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
        if key not in (table.get(part, {}) if part else table):
            out.append(name)
    if np.array_equal(np.asarray(robot.transmission), np.eye(robot.n)):
        out.append("motors turn as joints do (no gears are described)")
    if any(not joint.max_speed for joint in robot.joints):
        out.append("joints of 180 deg/s where no greatest speed is described")
    return tuple(out)
