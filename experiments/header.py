"""Reads ``campaign.toml``: which robot, gravity, tool, targets, instrument and tables."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from experiments.columns import LOGS, TABLES, lookalike
from experiments.errors import CampaignError, fault
from experiments.keys import frozen, missing, number, refuse_unknown, section_of, vector
from experiments.stated import SECTIONS, UNREAD, Stated, parse_stated
from kinematics.description import DescriptionError, RobotDescription, load_robot, robot_names
from kinematics.escaping import has_controls
from kinematics.reading import read_text, toml_of
from kinematics.section import migrated

__all__ = ["FORMAT", "Header", "Instrument", "Tool", "parse_header", "read_header"]

FORMAT = "clampid-campaign/1"
HEADER_FILE = "campaign.toml"
FloatArray = npt.NDArray[np.float64]

# Gravity on the ground is 9.764 … 9.834 m/s²; a robot's tilt turns it but does not change its length.
GRAVITY_RANGE = (9.7, 9.9)
# The strongest serial robots carry 2.3 t, and no tool reaches 5 m from its flange: beyond, grams or millimetres.
LONGEST_NAME = 100  # characters, of a target
LARGEST_MASS_KG = 3000.0
FARTHEST_POINT_M = 5.0
# A robot's own errors are of the order of 1 mm and 1 mrad. An instrument five (a hundred) times worse sees none of
# them, while a usual one stated in mm (0.02 … 0.1), or in degrees or mrad, is above these.
WORST_POSITION_STD_M = 5e-3
WORST_ORIENTATION_STD_RAD = 0.1
_STATED = {
    "position_std_m": WORST_POSITION_STD_M,
    "orientation_std_rad": WORST_ORIENTATION_STD_RAD,
    "distance_std_m": WORST_POSITION_STD_M,
}
"""Keys of one sigma each, with the worst that an instrument may have."""

KEYS = ("format", "robot", "gravity_m_s2", "tool", "targets_m", "instrument", "tables", *SECTIONS)
"""The keys and sections of ``campaign.toml``; any other is refused, because it would be ignored in silence."""
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
    """What the controller was told of the tool, not necessarily the truth.

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
    if not folder.exists():
        raise fault(folder, expected="a campaign folder", found="no such folder")
    if not folder.is_dir():
        raise fault(folder, expected="a campaign folder", found="a file")
    path = folder / HEADER_FILE
    if not path.is_file():
        raise fault(path, expected=f"a campaign folder with {HEADER_FILE}", found="no such file")
    try:
        raw = toml_of(read_text(path))
    except UnicodeDecodeError as error:
        raise fault(path, expected="UTF-8 text", found=f"a byte that is not, at offset {error.start}") from error
    except OSError as error:
        raise fault(path, expected="TOML", found=error.strerror or str(error)) from error
    except tomllib.TOMLDecodeError as error:
        raise fault(path, expected="TOML", found=str(error)) from error
    return parse_header(raw, path)


def parse_header(raw: Mapping[str, Any], path: Path, also: Sequence[str] = ()) -> Header:
    """Check the content of a ``campaign.toml``.

    Parameters
    ----------
    raw
        The file's content.
    path
        The file, for messages, and because a robot's path is relative to it.
    also
        Keys that the caller reads itself.

    Returns
    -------
    Header
        With the robot loaded.

    Raises
    ------
    CampaignError
        As `read_header`.
    """
    if "format" not in raw:  # the contract wants it
        raise fault(path, expected=f'"{FORMAT}"', found=missing("format", raw), column="format")
    try:
        raw = migrated(raw, FORMAT, {})
    except ValueError as error:
        raise CampaignError(f"{path}, {error}") from None
    refuse_unknown(raw, (*KEYS, *UNREAD, *also), path)
    robot, targets = _robot(raw, path), _targets(raw, path)
    tables, at_joints = _tables(raw, path)
    return Header(
        robot=robot,
        gravity=_gravity(raw, path),
        tool=_tool(raw, path),
        targets=targets,
        instrument=_instrument(raw, path),
        tables=tables,
        raw=MappingProxyType(dict(raw)),
        stated=parse_stated(raw, targets, robot.n, path),
        at_joints=at_joints,
    )


def _robot(raw: Mapping[str, Any], path: Path) -> RobotDescription:
    name = raw.get("robot")
    known = ", ".join(robot_names())
    expected = f"a bundled robot ({known}) or the path of a description"
    if not isinstance(name, str):
        found = missing("robot", raw) if name is None else repr(name)
        raise fault(path, expected=expected, found=found, column="robot")
    try:
        return load_robot(name, relative_to=path.parent)
    except DescriptionError as error:
        near = get_close_matches(name, robot_names(), n=1, cutoff=0.5)
        reason = f" ({error})" if Path(name).suffix else f"; {near[0]} is probably meant" if near else ""
        raise fault(path, expected=expected, found=f"{name!r}{reason}", column="robot") from error


def _gravity(raw: Mapping[str, Any], path: Path) -> FloatArray:
    gravity = vector(raw, "gravity_m_s2", "gravity_m_s2", path)
    size = float(np.linalg.norm(gravity))
    low, high = GRAVITY_RANGE
    if not low <= size <= high:
        expected = f"gravity in the robot base frame in m/s², of length {low} to {high}"
        raise fault(path, expected=expected, found=f"length {size:g}", column="gravity_m_s2")
    return gravity


def _tool(raw: Mapping[str, Any], path: Path) -> Tool:
    section = section_of(raw, "tool", path)
    if not section:
        return Tool(0.0, frozen(np.zeros(3)))
    refuse_unknown(section, ("mass_kg", "com_m"), path, "tool")
    mass = number(section, "mass_kg", "tool.mass_kg", path)
    if not 0.0 <= mass <= LARGEST_MASS_KG:
        expected = f"a mass in kg from 0 to {LARGEST_MASS_KG:g}"
        raise fault(path, expected=expected, found=f"{mass:g}", column="tool.mass_kg")
    return Tool(mass, _point(section, "com_m", "tool.com_m", path))


def _targets(raw: Mapping[str, Any], path: Path) -> Mapping[str, FloatArray]:
    section = section_of(raw, "targets_m", path)
    for name in section:
        if has_controls(name) or not 0 < len(name) <= LONGEST_NAME:
            expected = f"names of 1 to {LONGEST_NAME} printable characters on one line"
            raise fault(path, expected=expected, found=repr(name[:80]), column="targets_m")
    return MappingProxyType({name: _target(section, name, path) for name in section})


def _target(section: Mapping[str, Any], name: str, path: Path) -> FloatArray:
    """A target on the flange: three numbers, or a table that says so."""
    where, entry = f"targets_m.{name}", section[name]
    if not isinstance(entry, Mapping):
        return _point(section, name, where, path)
    refuse_unknown(entry, ("at", "position_m"), path, where)
    if entry.get("at", "flange") != "flange":
        raise fault(
            path,
            expected='a target on the flange: three numbers, or {at = "flange", position_m = …}',
            found=f"at = {entry['at']!r}: targets that stand elsewhere are not supported yet",
            column=f"{where}.at",
        )
    return _point(entry, "position_m", f"{where}.position_m", path)


def _instrument(raw: Mapping[str, Any], path: Path) -> Instrument:
    section = section_of(raw, "instrument", path)
    refuse_unknown(section, ("name", *_STATED, *_TRACKER), path, "instrument")
    name = section.get("name", "unknown")
    if not isinstance(name, str):
        raise fault(path, expected="text", found=repr(name), column="instrument.name")
    sigmas: dict[str, float | None] = {}
    for key, limit in _STATED.items():
        sigmas[key] = number(section, key, f"instrument.{key}", path) if key in section else None
        sigma = sigmas[key]
        if sigma is not None and not 0.0 < sigma <= limit:
            unit = key.rsplit("_", 1)[-1]
            expected = f"one sigma in {unit}, above 0 and not above {limit:g} {unit} (is it in another unit?)"
            raise fault(path, expected=expected, found=f"{sigma:g}", column=f"instrument.{key}")
    position, orientation, distance = sigmas.values()
    return Instrument(name, position, orientation, _tracker(section, path), distance)


def _tracker(section: Mapping[str, Any], path: Path) -> Tracker | None:
    """The errors of range and angles; range and angles only make sense together."""
    if not any(key in section for key in _TRACKER):
        return None
    numbers = []
    for key, (limit, optional) in _TRACKER.items():
        if key not in section and not optional:
            given = ", ".join(k for k in _TRACKER if k in section)
            raise fault(path, expected=f"instrument.{key} with {given}", found="none", column=f"instrument.{key}")
        value = number(section, key, f"instrument.{key}", path) if key in section else 0.0
        if not (0.0 if optional else 1e-12) <= value <= limit:
            raise fault(
                path,
                expected=f"one sigma above 0 and not above {limit:g} (is it in another unit?)",
                found=f"{value:g}",
                column=f"instrument.{key}",
            )
        numbers.append(value)
    return Tracker(*numbers)


def _tables(raw: Mapping[str, Any], path: Path) -> tuple[Mapping[str, str], frozenset[str]]:
    """File name by table, and the tables whose torques are those at the joints."""
    section = section_of(raw, "tables", path)
    files: dict[str, str] = {}
    at_joints = set()
    for name, entry in section.items():
        where = f"tables.{name}"
        if name not in TABLES:
            near = lookalike(name, TABLES)
            hint = f"; {near} is probably meant" if near else ""
            expected = f"one of {', '.join(TABLES)}"
            raise fault(path, expected=expected, found=f"{name!r}{hint}", column=where)
        known = dict(entry) if isinstance(entry, Mapping) else {"file": entry}
        refuse_unknown(known, ("file", "side"), path, where)
        if not isinstance(known.get("file"), str):
            expected = 'a file name, or { file = "…", side = "joint" }'
            raise fault(path, expected=expected, found=repr(entry), column=where)
        files[name] = known["file"]
        side = known.get("side", SIDES[0])
        if side not in SIDES:
            raise fault(path, expected=f"one of {', '.join(SIDES)}", found=repr(side), column=f"{where}.side")
        if "side" in known and name not in LOGS:
            expected = f"a side of the torques of {' or '.join(LOGS)} only"
            raise fault(path, expected=expected, found=f"one of {name}", column=f"{where}.side")
        at_joints |= {name} if side == SIDES[1] else set()
    if not section:
        raise fault(path, expected=f"at least one of {', '.join(TABLES)}", found="no table", column="tables")
    return MappingProxyType(files), frozenset(at_joints)


def _point(section: Mapping[str, Any], key: str, where: str, path: Path) -> FloatArray:
    point = vector(section, key, where, path)
    distance = float(np.linalg.norm(point))
    if distance > FARTHEST_POINT_M:
        expected = f"a point in the flange frame in m, within {FARTHEST_POINT_M:g} m (is it in millimetres?)"
        raise fault(path, expected=expected, found=f"one {distance:g} away", column=where)
    return point
