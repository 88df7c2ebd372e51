"""
Reads robot descriptions: bundled ones by name, others by path (our TOML, or URDF).

The TOML is for people: lengths in m, angles in degrees or radians as the key says (`limits_deg`, `limits_rad`),
ratios as exact fractions in quotes. A key that is not known is an error. The format is told in
appendix_data/robots/README.md.
"""

from collections.abc import Mapping
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from kinematics.checks import validate
from kinematics.dh import DHRow, DHTable, row_transform
from kinematics.reading import fraction_of, read_bytes, toml_of
from kinematics.robot import DescriptionError, Joint, Link, RobotDescription
from kinematics.screws import transform
from kinematics.typing_ import Array

__all__ = ["DescriptionError", "Joint", "Link", "RobotDescription", "load_robot", "robot_names"]

_FORMAT = "clampid-robot/1"
Table = Mapping[str, Any]


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
        near = get_close_matches(name, known, n=1, cutoff=0.5)
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
        table = toml_of(content.decode("utf-8-sig"))
        return validate(_robot(table))
    except KeyError as error:
        raise DescriptionError(f"{where}: the key {error} is missing") from None
    except (ValueError, TypeError, AttributeError, IndexError, ArithmeticError) as error:
        # A wrong type or length anywhere in the file shows as one of these; ours are among the ValueErrors.
        raise DescriptionError(f"{where}: {error}") from None


def _known_keys(where: str, table: Table, *keys: str) -> None:
    for key in table:
        if key not in keys:
            near = get_close_matches(key, keys, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise DescriptionError(f"{where}: the key {key!r} is not known{hint}; expected {', '.join(keys)}")


def _robot(table: Table) -> RobotDescription:
    _known_keys(
        "description", table,
        "format", "name", "title", "source", "notes", "unverified",
        "joint", "link", "flange", "transmission", "linkage", "dh",
    )  # fmt: skip
    if table["format"] != _FORMAT:
        raise DescriptionError(f"format: expected {_FORMAT!r}, found {table['format']!r}")
    gears = table.get("transmission", {})
    _known_keys("transmission", gears, "T", "motor_spring_Nm_rad")
    springs = gears.get("motor_spring_Nm_rad")
    dh = _dh(table["dh"]) if "dh" in table else None
    joints, home = _axes_of_dh(table["joint"], dh)
    return RobotDescription(
        name=table["name"],
        title=table["title"],
        joints=tuple(_joint(f"joint {i}", joint) for i, joint in enumerate(joints, 1)),
        flange=_flange(table["flange"]) if "flange" in table or home is None else home,
        links=tuple(_link(f"link {i}", link) for i, link in enumerate(table.get("link", ()), 1)),
        transmission=_matrix(gears.get("T", ())),
        transmission_known="T" in gears,
        motor_spring=None if springs is None else np.asarray(springs, dtype=np.float64),
        linkage=_matrix(table.get("linkage", ())),
        dh=dh,
        notes=tuple(table.get("notes", ())),
        unverified=tuple(table.get("unverified", ())),
        source=table["source"],
    )


def _matrix(rows: list[list[float | str]]) -> Array:
    return np.array([[fraction_of(entry) for entry in row] for row in rows], dtype=np.float64)


def _angle(table: Table, key: str, default: float | None = None, per: str = "") -> Any:
    """Read `key_deg` or `key_rad` (a number or a list) as radians; the default, if there is neither."""
    degrees, radians = f"{key}_deg{per}", f"{key}_rad{per}"
    if degrees in table:
        return np.deg2rad(np.asarray(table[degrees], dtype=np.float64))
    return np.asarray(table[radians], dtype=np.float64) if radians in table else default


def _joint(where: str, table: Table) -> Joint:
    kind = table.get("kind", "revolute")
    turns = kind != "prismatic"
    _known_keys(
        where, table, "name", "kind", "axis", "point_m",
        *(("pitch_m_rad",) if kind == "helical" else ()),
        *(("limits_deg", "limits_rad", "max_speed_deg_s", "max_speed_rad_s", "rated_torque_Nm") if turns
          else ("limits_m", "max_speed_m_s", "rated_force_N")),
    )  # fmt: skip
    limits = _angle(table, "limits") if turns else table["limits_m"]
    if limits is None:
        raise DescriptionError(f"{where}: expected limits_deg or limits_rad, found neither")
    speed = _angle(table, "max_speed", per="_s") if turns else table.get("max_speed_m_s")
    return Joint(
        name=table["name"],
        kind=kind,
        axis=np.asarray(table["axis"], dtype=np.float64),
        point=np.asarray(table["point_m"], dtype=np.float64),
        pitch=float(table.get("pitch_m_rad", 0.0)),
        lower=float(limits[0]),
        upper=float(limits[1]),
        max_speed=None if speed is None else float(speed),
        rated_torque=table.get("rated_torque_Nm" if turns else "rated_force_N"),
    )


def _axes_of_dh(joints: list[Table], dh: DHTable | None) -> tuple[list[Table], Array | None]:
    """Give joints without an axis that of their row of the DH table, and the flange's pose by the table."""
    if dh is None or len(dh.rows) != len(joints):
        return list(joints), None
    frame = dh.base
    out: list[Table] = []
    for joint, row in zip(joints, dh.rows, strict=True):
        kind = {"kind": "prismatic"} if row.prismatic else {}
        out.append({**kind, "axis": row.sign * frame[:3, 2], "point_m": frame[:3, 3], **joint})
        frame = frame @ row_transform(row, 0.0)
    return out, np.asarray(frame @ dh.tool)


def _link(where: str, table: Table) -> Link:
    _known_keys(where, table, "mass_kg", "com_m", "inertia_kg_m2")
    inertia = table.get("inertia_kg_m2")
    return Link(float(table["mass_kg"]), table["com_m"], None if inertia is None else np.asarray(inertia))


def _flange(table: Table) -> Array:
    """Build the pose from position, x and z; y follows, so that nothing is said twice."""
    _known_keys("flange", table, "position_m", "x", "z")
    x, z = np.asarray(table["x"], dtype=np.float64), np.asarray(table["z"], dtype=np.float64)
    return transform(np.stack([x, np.cross(z, x), z], axis=-1), np.asarray(table["position_m"], dtype=np.float64))


def _dh(table: Table) -> DHTable:
    _known_keys("dh", table, "row", "base", "tool")
    rows = []
    for i, row in enumerate(table["row"], 1):
        angles = [f"{name}_{unit}" for name in ("theta_offset", "alpha", "beta") for unit in ("deg", "rad")]
        _known_keys(f"dh row {i}", row, "sign", "d_m", "a_m", "prismatic", *angles)
        rows.append(
            DHRow(
                sign=int(row.get("sign", 1)),
                theta_offset=float(_angle(row, "theta_offset", 0.0)),
                d=float(row["d_m"]),
                a=float(row["a_m"]),
                alpha=float(_angle(row, "alpha", 0.0)),
                beta=float(_angle(row, "beta", 0.0)),
                prismatic=bool(row.get("prismatic", False)),
            )
        )
    standard = all(row.beta == 0.0 for row in rows)
    frames = {key: _flange(table[key]) for key in ("base", "tool") if key in table}
    return DHTable(tuple(rows), convention="standard" if standard else "hayati", **frames)
