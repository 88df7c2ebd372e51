"""Touches of features with a known tip: where a robot stood when its tip touched planes, spheres and points of a cell.

A file of touches is TOML, with the keys of ``campaign.toml`` but for ``[tables]``, and::

    format = "clampid-touched/1"
    touches = "touches.csv"             # feature, q1_rad …; target (which tip) if there are several; dir1 …, temp_*_C
    tip_radius_m = 0.003                # of the ball that touches; 0 (by default) of a point
    tip_std_m = 1e-5                    # one sigma per axis of where the tip is on the flange; 0 by default

    [instrument]
    position_std_m = 2e-5               # one sigma of a touch

    [features.table]                    # in the frame of the cell
    kind = "plane"
    point_m = [0.0, 0.0, 0.0]           # any point of it
    normal = [0.0, 0.0, 1.0]            # to the side that is touched, of any length
    std_m = 1e-5                        # one sigma of its place (of a coordinate); 0 by default

    [features.ball]
    kind = "sphere"                     # touched from outside
    centre_m = [0.8, 0.2, 0.1]
    radius_m = 0.02

    [features.cone]
    kind = "point"                      # the middle of the tip comes to rest there
    point_m = [0.9, -0.3, 0.0]

``[targets_m]`` are the tips in the flange frame. Where it is ambiguous how the cell stands to the robot,
``start_m = [x, y, z]`` and ``start_rad = [rx, ry, rz]`` (Rz Ry Rx) say where about the base is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from experiments.campaign import Campaign
from experiments.columns import POSITION, Column, joint_columns, table_format
from experiments.errors import CampaignError, fault
from experiments.header import FORMAT as CAMPAIGN_FORMAT
from experiments.header import parse_header
from experiments.tables import TableFile, read_table
from experiments.toml_file import read_toml
from experiments.validate import validate_table
from kinematics.screws import rotation_of

__all__ = ["FORMAT", "Feature", "Kind", "Touched", "read_touched"]

Array = npt.NDArray[np.float64]
Kind = Literal["plane", "sphere", "point"]
FORMAT = "clampid-touched/1"
OWN_KEYS = ("touches", "features", "tip_radius_m", "tip_std_m", "start_m", "start_rad")
FARTHEST_M = 100.0  # of a cell: what is farther is in millimetres
LARGEST_RADIUS_M = 1.0
MOST_TURNED = 4 * np.pi  # rad: no joint of an arm turns farther from its zero
KEYS: Mapping[Kind, tuple[str, ...]] = {
    "plane": ("point_m", "normal"),
    "sphere": ("centre_m", "radius_m"),
    "point": ("point_m",),
}


@dataclass(frozen=True)
class Feature:
    """A plane, sphere or point of the cell.

    Attributes
    ----------
    point
        ``(3,)`` m: any point of a plane, a sphere's centre, or the point.
    normal
        ``(3,)``: unit, of a plane, to the side that is touched; else zero.
    radius
        m, of a sphere; else 0.
    std
        m, one sigma of its place, per axis.
    """

    name: str
    kind: Kind
    point: Array
    normal: Array
    radius: float
    std: float


@dataclass(frozen=True)
class Touched:
    """Touches of one robot.

    Attributes
    ----------
    campaign
        Robot, tool, tips (its targets) and touches (its table ``poses``, whose x, y, z say nothing).
    features
        What can be touched.
    feature
        ``(N,)``: which of them each touch is of.
    tip_radius, tip_std
        m.
    start
        ``(4, 4)``: about where the base is in the cell, or None.
    """

    campaign: Campaign
    features: tuple[Feature, ...]
    feature: npt.NDArray[np.int64]
    tip_radius: float = 0.0
    tip_std: float = 0.0
    start: Array | None = None


def read_touched(path: Path) -> Touched:
    """Read a file of touches and its table.

    Raises
    ------
    CampaignError
        A file is missing or damaged, or a key, column or number is missing or cannot be meant.
    """
    raw = read_toml(path, "a file of touches", FORMAT)
    name = raw.get("touches")
    if not isinstance(name, str):
        raise fault(path, expected="the name of a table", found=repr(name), column="touches")
    known = {"tables": {"poses": name}, "format": CAMPAIGN_FORMAT}
    header = parse_header({**raw, **known}, path, OWN_KEYS)
    if header.instrument.position_std is None:
        raise fault(path, expected="one sigma of a touch in m", found="none", column="instrument.position_std_m")
    if not header.targets:
        raise fault(path, expected="the tip in the flange frame", found="none", column="targets_m")
    features = _features(raw.get("features"), path)
    table = _table(path.parent / name, header.robot.n, tuple(header.targets), [f.name for f in features])
    names = [f.name for f in features]
    campaign = Campaign(
        path.stem, path.parent, header.robot, header.gravity, header.tool, header.targets, header.instrument,
        {"poses": table}, "",
    )  # fmt: skip
    return Touched(
        campaign,
        features,
        np.array([names.index(str(found)) for found in table["feature"]], dtype=np.int64),
        _length(raw, "tip_radius_m", path, LARGEST_RADIUS_M),
        _length(raw, "tip_std_m", path, LARGEST_RADIUS_M),
        _start(raw, path),
    )


def _features(section: Any, path: Path) -> tuple[Feature, ...]:
    if not isinstance(section, Mapping) or not section:
        raise fault(path, expected="sections [features.NAME]", found=repr(section), column="features")
    return tuple(_feature(str(name), entry, path) for name, entry in section.items())


def _feature(name: str, entry: Any, path: Path) -> Feature:
    where = f"features.{name}"
    if not isinstance(entry, Mapping):
        raise fault(path, expected=f"a section [{where}]", found=repr(entry), column=where)
    found = entry.get("kind")
    kind: Kind | None = next((known for known in KEYS if known == found), None)
    if kind is None:
        raise fault(path, expected=f"one of {', '.join(KEYS)}", found=repr(found), column=f"{where}.kind")
    for key in entry:
        if key not in ("kind", "std_m", *KEYS[kind]):
            allowed = ", ".join(("kind", "std_m", *KEYS[kind]))
            raise fault(path, expected=f"one of {allowed} of a {kind}", found="an unknown key", column=f"{where}.{key}")
    point = _vector(entry, KEYS[kind][0], where, path)
    if np.linalg.norm(point) > FARTHEST_M:
        expected, away = f"a point within {FARTHEST_M:g} m", f"one {np.linalg.norm(point):g} m away (is it in mm?)"
        raise fault(path, expected=expected, found=away, column=f"{where}.{KEYS[kind][0]}")
    normal, radius = np.zeros(3), 0.0
    if kind == "plane":
        normal = _vector(entry, "normal", where, path)
        if np.linalg.norm(normal) < 1e-6:
            raise fault(path, expected="a direction", found="no length", column=f"{where}.normal")
        normal = normal / np.linalg.norm(normal)
    if kind == "sphere":
        radius = _length(entry, "radius_m", path, LARGEST_RADIUS_M, where)
        if radius == 0.0:
            raise fault(path, expected="a radius above 0 m", found="none", column=f"{where}.radius_m")
    return Feature(name, kind, point, normal, radius, _length(entry, "std_m", path, LARGEST_RADIUS_M, where))


def _vector(section: Mapping[str, Any], key: str, where: str, path: Path) -> Array:
    value = section.get(key)
    if isinstance(value, list) and len(value) == 3 and all(type(v) in (int, float) for v in value):
        point = np.array(value, dtype=np.float64)
        if np.isfinite(point).all():
            return point
    raise fault(path, expected="three finite numbers", found=repr(value), column=f"{where}.{key}".lstrip("."))


def _length(section: Mapping[str, Any], key: str, path: Path, most: float, where: str = "") -> float:
    value = section.get(key, 0.0)
    if type(value) not in (int, float) or not 0.0 <= value <= most:
        expected = f"a length in m from 0 to {most:g}"
        raise fault(path, expected=expected, found=repr(value), column=f"{where}.{key}".lstrip("."))
    return float(value)


def _start(raw: Mapping[str, Any], path: Path) -> Array | None:
    if "start_m" not in raw and "start_rad" not in raw:
        return None
    out = np.eye(4)
    out[:3, 3] = _vector(raw, "start_m", "", path)
    out[:3, :3] = rotation_of(_vector(raw, "start_rad", "", path))
    return out


def _table(path: Path, n: int, tips: tuple[str, ...], features: list[str]) -> pd.DataFrame:
    frame, source = read_table(path), TableFile(path)
    count = len(frame)
    frame = frame.assign(pose=np.arange(1, count + 1), visit=1, time_s=np.arange(float(count)))
    frame[list(POSITION)] = 0.0  # where a touch was measured nobody knows; its feature says it
    if "target" not in frame and len(tips) == 1:
        frame["target"] = tips[0]
    if not any(name in frame for name in joint_columns("dir{}", n)):
        frame[list(joint_columns("dir{}", n))] = 0
    form = table_format("poses", n)
    frame = validate_table(frame, replace(form, required=(*form.required, Column("feature", "text"))), source, tips)
    for row, name in enumerate(frame["feature"]):
        if str(name) not in features:
            expected = f"one of the features {', '.join(features)}"
            raise source.fault(expected=expected, found=repr(str(name)), row=row, column="feature")
    for name in joint_columns("q{}_rad", n):
        far = np.flatnonzero(np.abs(frame[name].to_numpy(float)) > MOST_TURNED)
        if far.size:
            raise _degrees(source, name, int(far[0]), float(frame[name].iloc[far[0]]))
    return frame


def _degrees(source: TableFile, name: str, row: int, value: float) -> CampaignError:
    return source.fault(
        expected="radians, within two turns of zero", found=f"{value:g} (are they degrees?)", row=row, column=name
    )
