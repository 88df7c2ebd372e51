"""Touches of features with a known tip: the robot's postures as its tip touched planes, spheres and points of a cell.

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
from typing import Literal, cast

import numpy as np
import numpy.typing as npt
import pandas as pd

from experiments.campaign import Campaign
from experiments.columns import POSITION, Column, joint_columns, table_format
from experiments.errors import CampaignError
from experiments.header import LONGEST_PATH, header_in
from experiments.tables import TableFile, read_table
from experiments.toml_file import read_toml
from experiments.validate import validate_table
from kinematics.fixed_angles import rotation_of
from kinematics.section import Section

__all__ = ["FORMAT", "Feature", "Kind", "Touched", "read_touched"]

Array = npt.NDArray[np.float64]
Kind = Literal["plane", "sphere", "point"]
FORMAT = "clampid-touched/1"
FARTHEST_M = 100.0  # of a cell: larger numbers are in millimetres
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
    root = read_toml(path, "a file of touches", FORMAT)
    header = header_in(root, path.parent)
    if header.instrument.position_std is None:
        raise root.fault("instrument.position_std_m", "one sigma of a touch in m", "none")
    if not header.targets:
        raise root.fault("targets_m", "the tip in the flange frame", "none")
    features = _features(root.section("features"))
    radius, std = (root.number(key, 0.0, LARGEST_RADIUS_M, "m", 0.0) for key in ("tip_radius_m", "tip_std_m"))
    start, file = _start(root), path.parent / root.text("touches", longest=LONGEST_PATH)
    root.done()
    table = _table(file, header.robot.n, tuple(header.targets), [f.name for f in features])
    names = [f.name for f in features]
    campaign = Campaign(
        path.stem, path.parent, header.robot, header.gravity, header.tool, header.targets, header.instrument,
        {"poses": table}, "",
    )  # fmt: skip
    return Touched(
        campaign,
        features,
        np.array([names.index(str(found)) for found in table["feature"]], dtype=np.int64),
        radius,
        std,
        start,
    )


def _features(section: Section) -> tuple[Feature, ...]:
    names = section.keys()
    if not names:
        raise section.fault("", "sections [features.NAME]", "none")
    return tuple(_feature(name, section.section(name)) for name in names)


def _feature(name: str, at: Section) -> Feature:
    kind = cast(Kind, at.text("kind", tuple(KEYS)))
    std = at.number("std_m", 0.0, LARGEST_RADIUS_M, "m", 0.0)
    point = at.vector(KEYS[kind][0], 3, -FARTHEST_M, FARTHEST_M, "m")
    normal, radius = np.zeros(3), 0.0
    if kind == "plane":
        normal = at.vector("normal", 3)
        length = float(np.linalg.norm(normal))
        if not 1e-6 < length < np.inf:
            raise at.fault("normal", "a direction", f"length {length:g}")
        normal = normal / length
    if kind == "sphere":
        radius = at.number("radius_m", 0.0, LARGEST_RADIUS_M, "m", above=True)
    at.done()
    return Feature(name, kind, point, normal, radius, std)


def _start(root: Section) -> Array | None:
    if not (root.has("start_m") or root.has("start_rad")):
        return None
    out = np.eye(4)
    out[:3, 3] = root.vector("start_m", 3, -FARTHEST_M, FARTHEST_M, "m")
    out[:3, :3] = rotation_of(root.vector("start_rad", 3, -MOST_TURNED, MOST_TURNED, "rad"))
    return out


def _table(path: Path, n: int, tips: tuple[str, ...], features: list[str]) -> pd.DataFrame:
    frame, source = read_table(path), TableFile(path)
    count = len(frame)
    columns: dict[str, object] = {str(name): frame[name] for name in frame.columns}
    columns |= {"pose": np.arange(1, count + 1), "visit": 1, "time_s": np.arange(float(count))}
    columns |= dict.fromkeys(POSITION, 0.0)  # a touch has no measured position; its feature determines it
    if "target" not in columns and len(tips) == 1:
        columns["target"] = tips[0]
    if not any(name in columns for name in joint_columns("dir{}", n)):
        columns |= dict.fromkeys(joint_columns("dir{}", n), 0)
    frame = pd.DataFrame(columns, index=frame.index)
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
