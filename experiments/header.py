"""Reads ``campaign.toml``: which robot, gravity, tool, targets, instrument and tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from experiments.columns import LOGS, TABLES
from experiments.errors import fault
from experiments.stated import UNREAD, Stated, stated_in
from experiments.toml_file import read_toml, root_of
from kinematics.description import DescriptionError, RobotDescription, load_robot, robot_names
from kinematics.section import Section, shown
from kinematics.typing_ import frozen_array

__all__ = ["FORMAT", "Header", "Instrument", "Tool", "header_in", "parse_header", "read_header", "robot_in"]

FORMAT = "clampid-campaign/1"
HEADER_FILE = "campaign.toml"
FloatArray = npt.NDArray[np.float64]

# Gravity on the ground is 9.764 … 9.834 m/s²; a robot's tilt turns it but does not change its length.
GRAVITY_RANGE = (9.7, 9.9)
# The strongest serial robots carry 2.3 t, and no tool reaches 5 m from its flange. Larger numbers are g or mm.
LONGEST_NAME = 100  # characters, of a target
LONGEST_PATH = 4096
LARGEST_MASS_KG = 3000.0
FARTHEST_POINT_M = 5.0
# A robot's own errors are of the order of 1 mm and 1 mrad. An instrument five (a hundred) times worse cannot measure
# them. The usual numbers in mm (0.02 … 0.1), degrees or mrad exceed these limits, so a wrong unit is found.
WORST_POSITION_STD_M = 5e-3
WORST_ORIENTATION_STD_RAD = 0.1
_STATED = {
    "position_std_m": WORST_POSITION_STD_M,
    "orientation_std_rad": WORST_ORIENTATION_STD_RAD,
    "distance_std_m": WORST_POSITION_STD_M,
}
"""Keys of one sigma each, with the worst that an instrument may have."""

SIDES = ("motor", "joint")
"""Where torques are measured: at the motor shaft, or at the joint, behind the gear."""
_TRACKER = {
    "range_std_m": (WORST_POSITION_STD_M, False),
    "range_std_m_m": (1e-3, True),
    "angle_std_rad": (WORST_ORIENTATION_STD_RAD, False),
}
"""Keys of a tracker's errors, with the worst that such an instrument may have, and whether they may be left out."""


@dataclass(frozen=True)
class Tool:
    """The tool as declared to the controller, not necessarily the true one.

    Attributes
    ----------
    mass
        Mass [kg].
    com
        Centre of mass in the flange frame [m], shape (3,).
    """

    mass: float
    com: FloatArray


@dataclass(frozen=True)
class Instrument:
    """The measuring instrument as its maker states it.

    Attributes
    ----------
    name
        Free text; ``"unknown"`` where the campaign does not say.
    position_std
        One sigma per axis [m], or None if not stated.
    orientation_std
        One sigma per axis [rad], or None if not stated.
    tracker
        How the error of a laser tracker grows with distance, or None if not stated; then it stands in for
        ``position_std``.
    distance_std
        Of what measured distances, one sigma [m], or None if not stated.
    """

    name: str
    position_std: float | None
    orientation_std: float | None
    tracker: Tracker | None = None
    distance_std: float | None = None


@dataclass(frozen=True)
class Tracker:
    """A laser tracker's or total station's errors, one sigma: range a + b r, and both angles, so across it angle r.

    The frame's origin is where its beams start. Source: ISO 10360-10:2021, and every maker's data sheet, state range
    and angles apart.

    Attributes
    ----------
    range_std
        a [m].
    range_rate
        b [m/m].
    angle_std
        Of each angle [rad].
    """

    range_std: float
    range_rate: float
    angle_std: float


@dataclass(frozen=True)
class Header:
    """``campaign.toml``, checked.

    Attributes
    ----------
    robot
        The nominal robot.
    gravity
        In the robot base frame [m/s²], shape (3,).
    tool, targets, instrument
        As declared; targets are points in the flange frame [m], shape (3,) each.
    tables
        File name by table.
    at_joints
        Tables whose torques were measured at the joints, behind the gears.
    raw
        Everything the file holds.
    stated
        What is known beforehand.
    """

    robot: RobotDescription
    gravity: FloatArray
    tool: Tool
    targets: Mapping[str, FloatArray]
    instrument: Instrument
    tables: Mapping[str, str]
    raw: Mapping[str, Any]
    stated: Stated = field(default_factory=Stated)
    at_joints: frozenset[str] = frozenset()


def read_header(folder: Path) -> Header:
    """Read and check ``campaign.toml``.

    Parameters
    ----------
    folder
        The campaign folder.

    Returns
    -------
    Header
        With the robot loaded.

    Raises
    ------
    CampaignError
        If the folder or file is missing, not TOML, or a key is missing, misspelt, unknown or in a wrong unit.
    """
    if not folder.is_dir():
        raise fault(folder, expected="a campaign folder", found="a file" if folder.exists() else "no such folder")
    path = folder / HEADER_FILE
    return _whole(read_toml(path, f"a campaign folder with {HEADER_FILE}", FORMAT, needed=True), folder)


def parse_header(raw: Mapping[str, Any], path: Path) -> Header:
    """Check the content of a ``campaign.toml``.

    Parameters
    ----------
    raw
        The file's content.
    path
        The file, for messages, and because a robot's path is relative to it.

    Returns
    -------
    Header
        With the robot loaded.

    Raises
    ------
    CampaignError
        As `read_header`.
    """
    return _whole(root_of(raw, path, FORMAT, needed=True), path.parent)


def _whole(root: Section, folder: Path) -> Header:
    header = header_in(root, folder)
    for key in UNREAD:
        if root.has(key):
            found = f"[{key}], which belongs to the campaign format and is not supported yet"
            raise root.fault(key, "a section that is read", found)
    files, at_joints = _tables(root)
    return replace(header, tables=files, at_joints=at_joints)


def header_in(root: Section, folder: Path) -> Header:
    """Read the keys and sections of a ``campaign.toml`` except its tables; other keys are left to the caller.

    Parameters
    ----------
    root
        The file.
    folder
        What a robot's path is relative to.

    Raises
    ------
    CampaignError
        A key is missing, misspelt or in a wrong unit.
    """
    robot, gravity = robot_in(root, folder), root.vector("gravity_m_s2")
    size = float(np.linalg.norm(gravity))
    low, high = GRAVITY_RANGE
    if not low <= size <= high:
        expected = f"gravity in the robot base frame in m/s², of length {low} to {high}"
        raise root.fault("gravity_m_s2", expected, f"length {size:g}")
    tool, targets = _tool(root), _targets(root)
    instrument, stated = _instrument(root.section("instrument", optional=True)), stated_in(root, targets, robot.n)
    return Header(robot, gravity, tool, targets, instrument, {}, MappingProxyType(dict(root.content)), stated)


def robot_in(root: Section, folder: Path) -> RobotDescription:
    """The robot that a file names: a bundled one, or a description's path from ``folder``."""
    expected = f"a bundled robot ({', '.join(robot_names())}) or the path of a description"
    name = root.value("robot", expected)
    if not isinstance(name, str) or len(name) > LONGEST_PATH:
        raise root.fault("robot", expected, shown(name))
    try:
        return load_robot(name, relative_to=folder)
    except DescriptionError as error:
        near = get_close_matches(name, robot_names(), n=1, cutoff=0.5)
        reason = f" ({error})" if Path(name).suffix else f"; did you mean {near[0]!r}?" if near else ""
        raise root.fault("robot", expected, f"{name!r}{reason}") from error


def _tool(root: Section) -> Tool:
    if not root.section("tool", optional=True).content:
        return Tool(0.0, frozen_array(np.zeros(3)))
    at = root.section("tool")
    tool = Tool(at.number("mass_kg", 0.0, LARGEST_MASS_KG, "kg"), _point(at, "com_m"))
    at.done()
    return tool


def _targets(root: Section) -> Mapping[str, FloatArray]:
    at = root.section("targets_m", optional=True)
    return MappingProxyType({name: _target(at, name) for name in at.keys()})  # noqa: SIM118 - not a dict


def _target(at: Section, name: str) -> FloatArray:
    """A target on the flange: three numbers, or a table that says so."""
    if len(name) > LONGEST_NAME:
        raise at.fault("", f"names of 1 to {LONGEST_NAME} characters", shown(name))
    if not isinstance(at.content[name], Mapping):
        return _point(at, name)
    entry = at.section(name)
    place = entry.value("at", "a place", "flange")
    if place != "flange":
        expected = 'a target on the flange: three numbers, or {at = "flange", position_m = …}'
        raise entry.fault("at", expected, f"at = {shown(place)}: targets that stand elsewhere are not supported yet")
    point = _point(entry, "position_m")
    entry.done()
    return point


def _instrument(at: Section) -> Instrument:
    sigmas = {
        key: at.number(key, 0.0, worst, key.rsplit("_", 1)[-1], above=True, default=None)
        for key, worst in _STATED.items()
    }
    name, tracker = at.text("name", default="unknown"), _tracker(at)
    at.done()
    return Instrument(name, sigmas["position_std_m"], sigmas["orientation_std_rad"], tracker, sigmas["distance_std_m"])


def _tracker(at: Section) -> Tracker | None:
    """The errors of range and angles; range and angles only make sense together."""
    given = [key for key in _TRACKER if at.has(key)]
    if not given:
        return None
    numbers = []
    for key, (worst, optional) in _TRACKER.items():
        if key not in given and not optional:
            raise at.fault(key, f"instrument.{key} with {', '.join(given)}", "none")
        unit = "rad" if key.endswith("rad") else "m/m" if key.endswith("m_m") else "m"
        numbers.append(at.number(key, 0.0, worst, unit, 0.0, above=not optional))
    return Tracker(*numbers)


def _tables(root: Section) -> tuple[Mapping[str, str], frozenset[str]]:
    """File name by table, and the tables whose torques are those at the joints."""
    at = root.section("tables", optional=True)
    found = {name: _table(at, name) for name in TABLES if at.has(name)}
    at.done()
    root.done()  # a section that is meant to be this one
    if not found:
        raise root.fault("tables", f"at least one of {', '.join(TABLES)}", "no table")
    files = {name: file for name, (file, _) in found.items()}
    return MappingProxyType(files), frozenset(name for name, (_, side) in found.items() if side == SIDES[1])


def _table(at: Section, name: str) -> tuple[str, str]:
    """Its file, and the side of its torques."""
    entry = at.section(name) if isinstance(at.content[name], Mapping) else at.part(name, {"file": at.content[name]})
    expected = 'a file name, or { file = "…", side = "joint" }'
    if not isinstance(entry.value("file", expected), str):
        raise at.fault(name, expected, shown(at.content[name]))
    if entry.has("side") and name not in LOGS:
        raise entry.fault("side", f"a side of the torques of {' or '.join(LOGS)} only", f"one of {name}")
    found = entry.text("file", longest=LONGEST_PATH), entry.text("side", SIDES, SIDES[0])
    entry.done()
    return found


def _point(at: Section, key: str) -> FloatArray:
    """A point in the flange frame."""
    point: FloatArray = at.vector(key, 3, -FARTHEST_POINT_M, FARTHEST_POINT_M, "m")
    return point
