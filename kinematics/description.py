"""
Reads robot descriptions: bundled ones by name, others by path (our TOML, or URDF).

The TOML is for people: lengths in m, angles in degrees or radians as the key says (`limits_deg`, `limits_rad`),
ratios as exact fractions in quotes. A key that is not known is an error. The format is told in
appendix_data/robots/README.md.
"""

import math
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from kinematics.checks import validate
from kinematics.dh import DHRow, DHTable, row_transform
from kinematics.reading import read_bytes, toml_of
from kinematics.robot import DescriptionError, Joint, Link, RobotDescription
from kinematics.screws import transform
from kinematics.section import Section, migrated
from kinematics.typing_ import Array

__all__ = ["DescriptionError", "Joint", "Link", "RobotDescription", "load_robot", "robot_names"]

_FORMAT = "clampid-robot/1"
KINDS = ("revolute", "prismatic", "helical")
MAX_LENGTH, MAX_MASS = 100.0, 1e5  # m and kg, of a robot's parts: beyond, millimetres or grams
MOST_TURNED = 1e4  # rad, or rad/s: a wrist of 255 turns is 1602
LONGEST_SOURCE = 2000  # characters


def robot_names() -> tuple[str, ...]:
    """
    List the bundled robots.

    Returns
    -------
    tuple of str
        Names that `load_robot` knows, sorted.
    """
    files = resources.files("appendix_data").joinpath("robots").iterdir()
    return tuple(sorted(Path(f.name).stem for f in files if f.name.endswith(".toml")))


def load_robot(name_or_path: str | Path, relative_to: Path | None = None) -> RobotDescription:
    """
    Read and check a robot description.

    Parameters
    ----------
    name_or_path
        Name of a bundled robot, or path of a .toml or .urdf file.
    relative_to
        Folder that a relative path starts from; the current one if not given.

    Returns
    -------
    RobotDescription
        The checked description.

    Raises
    ------
    DescriptionError
        If there is no such robot or file, or the description does not make sense.
    """
    name = str(name_or_path)
    path = Path(name)
    if path.suffix.lower() in (".toml", ".urdf"):
        path = path if relative_to is None else relative_to / path
        if not path.is_file():
            raise DescriptionError(f"robot description {path}: expected a file, found none")
        if path.suffix.lower() == ".urdf":
            from kinematics.urdf import read_urdf  # pinocchio takes long to import, and few descriptions are URDF

            return read_urdf(path)
        return _parse(str(path), _read(path))
    known = robot_names()
    if name not in known:
        begun = [whole for whole in known if name and whole.startswith(name)]
        near = begun or get_close_matches(name, known, n=1, cutoff=0.5)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise DescriptionError(
            f"robot {name!r}: expected a path to a .toml or .urdf file or one of {', '.join(known)}{hint}"
        )
    return _parse(name, resources.files("appendix_data").joinpath("robots", f"{name}.toml").read_bytes())


def _read(path: Path) -> bytes:
    try:
        return read_bytes(path)
    except OSError as error:
        raise DescriptionError(f"{path}: cannot be read: {error.strerror}") from error


def _parse(where: str, content: bytes) -> RobotDescription:
    try:
        table = migrated(toml_of(content.decode("utf-8-sig")), _FORMAT, {})
        return validate(_robot(Section(table, "", error=DescriptionError)))
    except (ValueError, ArithmeticError) as error:  # no TOML, no UTF-8, and ours
        raise DescriptionError(f"{where}: {error}") from None


@dataclass(frozen=True)
class _Home:
    """Where a DH table puts a joint: its axis and a point of it, in the base at zero."""

    axis: Array
    point: Array
    prismatic: bool


def _robot(at: Section) -> RobotDescription:
    at.has("format")
    gears, joints = at.section("transmission", optional=True), at.sections("joint")
    n = len(joints)
    dh = _dh(at.section("dh")) if at.has("dh") else None
    homes, flange = _homes(dh, n)
    robot = RobotDescription(
        name=at.text("name"),
        title=at.text("title"),
        joints=tuple(_joint(joint, home) for joint, home in zip(joints, homes, strict=True)),
        flange=_frame(at.section("flange")) if flange is None or at.has("flange") else flange,
        links=tuple(_link(link) for link in at.sections("link", optional=True)),
        transmission=gears.rows("T", ()),
        transmission_known=gears.has("T"),
        motor_spring=gears.vector("motor_spring_Nm_rad", n, 0.0, default=None, above=True),
        linkage=at.rows("linkage", ()),
        dh=dh,
        notes=at.texts("notes", ()),
        unverified=at.texts("unverified", ()),
        source=at.text("source", longest=LONGEST_SOURCE),
    )
    gears.done()
    at.done()
    return robot


def _angle(at: Section, key: str, default: Any = None, per: str = "", length: int | None = None) -> Any:
    """Read `key_deg` or `key_rad` (a number, or so many) as radians; the default, if there is neither."""
    degrees, radians = f"{key}_deg{per}", f"{key}_rad{per}"
    if at.has(degrees) and at.has(radians):
        raise at.fault(degrees, f"{degrees} or {radians}", "both")
    name, most, unit = radians, MOST_TURNED, f"rad{per.replace('_', '/')}"
    if at.has(degrees):
        name, most, unit = degrees, math.degrees(most), ""
    if length is None:
        found = at.number(name, -most, most, unit, default)
    else:
        found = at.vector(name, length, -most, most, unit, default, infinite=True)
    return np.deg2rad(found) if name == degrees else found


def _joint(at: Section, home: _Home | None) -> Joint:
    """Read a joint; what it does not say of its axis, the DH table does, if there is one."""
    kind = at.text("kind", KINDS, "prismatic" if home is not None and home.prismatic else "revolute")
    turns = kind != "prismatic"
    limits = (
        _angle(at, "limits", length=2)
        if turns
        else at.vector("limits_m", 2, -MAX_LENGTH, MAX_LENGTH, "m", infinite=True)
    )
    if limits is None:
        raise at.fault("", "limits_deg or limits_rad", "neither")
    speed = _angle(at, "max_speed", per="_s") if turns else at.number("max_speed_m_s", default=None)
    joint = Joint(
        name=at.text("name"),
        kind=kind,
        axis=at.vector("axis") if home is None or at.has("axis") else home.axis,
        point=at.vector("point_m", 3, -MAX_LENGTH, MAX_LENGTH, "m")
        if home is None or at.has("point_m")
        else home.point,
        pitch=at.number("pitch_m_rad", -MAX_LENGTH, MAX_LENGTH, default=0.0) if kind == "helical" else 0.0,
        lower=float(limits[0]),
        upper=float(limits[1]),
        max_speed=None if speed is None else float(speed),
        rated_torque=at.number("rated_torque_Nm" if turns else "rated_force_N", default=None),
    )
    at.done()
    return joint


def _homes(dh: DHTable | None, n: int) -> tuple[list[_Home | None], Array | None]:
    """Where a DH table puts its joints, and the flange's pose by it; nothing without a table of all joints."""
    if dh is None or len(dh.rows) != n:
        return [None] * n, None
    frame = dh.base
    out: list[_Home | None] = []
    for row in dh.rows:
        out.append(_Home(row.sign * frame[:3, 2], frame[:3, 3], row.prismatic))
        frame = frame @ row_transform(row, 0.0)
    return out, np.asarray(frame @ dh.tool)


def _link(at: Section) -> Link:
    inertia = at.rows("inertia_kg_m2", ())
    link = Link(
        at.number("mass_kg", 0.0, MAX_MASS, "kg"),
        at.vector("com_m", 3, -MAX_LENGTH, MAX_LENGTH, "m"),
        inertia if at.has("inertia_kg_m2") else None,
    )
    at.done()
    return link


def _frame(at: Section) -> Array:
    """Build the pose from position, x and z; y follows, so that nothing is said twice."""
    x, z = at.vector("x"), at.vector("z")
    place = at.vector("position_m", 3, -MAX_LENGTH, MAX_LENGTH, "m")
    at.done()
    return transform(np.stack([x, np.cross(z, x), z], axis=-1), place)


def _dh(at: Section) -> DHTable:
    rows = []
    for row in at.sections("row"):
        rows.append(
            DHRow(
                sign=row.integer("sign", -1, 1, 1),
                theta_offset=float(_angle(row, "theta_offset", 0.0)),
                d=row.number("d_m", -MAX_LENGTH, MAX_LENGTH, "m"),
                a=row.number("a_m", -MAX_LENGTH, MAX_LENGTH, "m"),
                alpha=float(_angle(row, "alpha", 0.0)),
                beta=float(_angle(row, "beta", 0.0)),
                prismatic=row.flag("prismatic", False),
            )
        )
        row.done()
    standard = all(row.beta == 0.0 for row in rows)
    frames = {key: _frame(at.section(key)) for key in ("base", "tool") if at.has(key)}
    at.done()
    return DHTable(tuple(rows), convention="standard" if standard else "hayati", **frames)
