"""
The part of a cell file that says what stands around a robot, how thick its links are and what its flange carries.

The rest of the file (convention, targets, temperatures) is for detector positions; see ``offline_ik``.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

from kinematics.collision.bodies import CLEARANCE, WorldDescription, carried_box
from kinematics.collision.obstacles import obstacles_of, pose_of
from kinematics.reading import read_text, toml_of
from kinematics.robot import RobotDescription
from kinematics.section import Section, migrated

__all__ = ["CELL_FORMAT", "LARGEST_TOOL", "open_cell", "read_world", "world_in"]

CELL_FORMAT = "clampid-cell/1"
LARGEST_TOOL = 3.0  # m: what a flange carries, how far it sticks out, a link's radius; beyond, millimetres
WIDEST_CLEARANCE = 1.0  # m


def open_cell(path: Path, robot: RobotDescription, of: str, error: type[ValueError]) -> Section:
    """
    The content of a cell file, of which only ``format`` and ``robot`` have been read.

    Parameters
    ----------
    robot, of
        Which robot it must be of, and what is of that robot: ``model`` or ``plan``.

    Raises
    ------
    ValueError
        Of the kind ``error``: the file is not there, no TOML, of another format or of another robot.
    """
    try:
        table = toml_of(read_text(path))
    except FileNotFoundError:
        raise error(f"{path}: expected a cell file, found none") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as fault:
        raise error(f"{path}: expected a cell as TOML, found: {fault}") from fault
    try:
        root = Section(migrated(table, CELL_FORMAT, {}), str(path), error=error)
    except ValueError as fault:
        raise error(f"{path}, {fault}") from None
    root.has("format")
    stated = root.text("robot")
    if stated != robot.name:
        raise root.fault("robot", f"{robot.name!r}, which the {of} is of", repr(stated))
    return root


def read_world(path: Path, robot: RobotDescription, error: type[ValueError]) -> WorldDescription:
    """
    The world of a cell file for a plan; what the file says of other things is not looked at.

    Raises
    ------
    ValueError
        Of the kind ``error``: the file cannot be read, is of another robot, or what it says of the world is wrong.
    """
    root = open_cell(path, robot, "plan", error)
    detector, shape, safety = (root.section(key, optional=True) for key in ("detector", "robot_shape", "safety"))
    described = world_in(root, detector, shape, safety, robot.n, path.parent)
    shape.done()
    return described


def world_in(
    root: Section, detector: Section, shape: Section, safety: Section, n: int, folder: Path
) -> WorldDescription:
    """
    The world that a cell file in ``folder`` describes, for a robot of n joints, from the file and three of its tables.

    Raises
    ------
    ValueError
        The sections' own: a key is missing or wrong.
    """
    mount = pose_of(detector, LARGEST_TOOL)
    size = detector.vector("size_m", 3, 0.0, LARGEST_TOOL, "m", None, above=True)
    return WorldDescription(
        obstacles=obstacles_of(root.sections("obstacle", optional=True), folder),
        base_radius=shape.number("base_radius_m", 0.0, LARGEST_TOOL, "m", None, above=True),
        link_radii=shape.vector("radius_m", n, 0.0, LARGEST_TOOL, "m", None, above=True),
        clearance=safety.number("clearance_m", 0.0, WIDEST_CLEARANCE, "m", CLEARANCE),
        carried=None if size is None else carried_box(tuple(size.tolist()), mount),
    )
