"""What a ``campaign.toml`` states as known beforehand: the base, targets, certified distances, where sensors sit.

``[base]``, ``[targets_std_m]``, ``[[distance]]`` and ``[sensors]``. A statement comes with its standard deviation: it
weighs against what is measured as one more measurement, and is no constraint.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from experiments.errors import fault
from experiments.keys import frozen, is_number, missing, number, refuse_unknown, section_of, vector
from kinematics.screws import rotation_of

__all__ = ["SECTIONS", "UNREAD", "CertifiedDistance", "Sensor", "Stated", "StatedBase", "parse_stated"]

FloatArray = npt.NDArray[np.float64]

SECTIONS = ("base", "targets_std_m", "distance", "sensors")
UNREAD = ("flange_sensor", "fixed_points_m", "fixed_points_std_m", "inclinometer", "displacement")
"""Sections of the campaign format whose tables are not read."""

FARTHEST_BASE_M = 100.0  # of a tracker: beyond, millimetres
MOST_TURNED = 4.0 * np.pi  # rad: beyond, degrees
WORST_BASE_STD_M = 1.0
WORST_BASE_STD_RAD = np.pi
WORST_TARGET_STD_M = 0.02  # a drawing is better than that: beyond, millimetres
LONGEST_M = 100.0
WORST_DISTANCE_STD_M = 1e-3  # a scale bar is certified to micrometres
NOMINAL_OFF_M = 0.05  # by how much targets may stand farther apart or closer than declared
_PLACES = ("base", "column", "flange", "ambient", "none")


@dataclass(frozen=True)
class StatedBase:
    """Where the robot's base stands in the instrument's frame.

    Attributes
    ----------
    position, rpy
        ``(3,)``, m and rad; the rotation is Rz·Ry·Rx.
    position_std, rpy_std
        ``(3,)``: standard deviations; infinite where not known.
    """

    position: FloatArray
    rpy: FloatArray
    position_std: FloatArray
    rpy_std: FloatArray

    @property
    def pose(self) -> FloatArray:
        """``(4, 4)``: base to instrument frame."""
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = rotation_of(self.rpy), self.position
        return out


@dataclass(frozen=True)
class CertifiedDistance:
    """A certified distance between two targets, m, with its standard deviation."""

    between: tuple[str, str]
    value: float
    std: float


@dataclass(frozen=True)
class Sensor:
    """Where a temperature sensor sits (``none``: nowhere that counts), and its weight in that place's mean."""

    at: str
    weight: float = 1.0


@dataclass(frozen=True)
class Stated:
    """All that a campaign states as known beforehand.

    Attributes
    ----------
    base
        None: not stated.
    targets_std
        Target → ``(3,)``, m, in the flange frame's axes.
    sensors
        Name → place, of the columns ``temp_<name>_C``.
    """

    base: StatedBase | None = None
    targets_std: Mapping[str, FloatArray] = field(default_factory=dict)
    distances: tuple[CertifiedDistance, ...] = ()
    sensors: Mapping[str, Sensor] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """What was stated, for programs; infinite standard deviations are None."""
        out: dict[str, Any] = {}
        if self.base is not None:
            known = {"position_m": self.base.position.tolist(), "rpy_rad": self.base.rpy.tolist()}
            stds = {"position_std_m": self.base.position_std, "rpy_std_rad": self.base.rpy_std}
            out["base"] = known | {k: [s if math.isfinite(s) else None for s in v.tolist()] for k, v in stds.items()}
        if self.targets_std:
            out["targets_std_m"] = {name: std.tolist() for name, std in self.targets_std.items()}
        if self.distances:
            out["distance"] = [{"between": list(d.between), "value_m": d.value, "std_m": d.std} for d in self.distances]
        if self.sensors:
            out["sensors"] = {name: {"at": s.at, "weight": s.weight} for name, s in self.sensors.items()}
        return out


def parse_stated(raw: Mapping[str, Any], targets: Mapping[str, FloatArray], joints: int, path: Path) -> Stated:
    """Check the sections of a ``campaign.toml`` that state something.

    Parameters
    ----------
    raw
        The file's content.
    targets
        Nominal targets in the flange frame, m, ``(3,)`` each.
    joints
        How many the robot has.
    path
        The file, for messages.

    Raises
    ------
    CampaignError
        A key is unknown or missing, or a number is in a wrong unit or contradicts another.
    """
    for key in UNREAD:
        if key in raw:
            stated = ", ".join(f"[{name}]" for name in SECTIONS)
            raise fault(
                path,
                expected=f"sections that are read; of what is known beforehand: {stated}",
                found=f"[{key}], which belongs to the campaign format and is not supported yet",
                column=key,
            )
    return Stated(
        _base(raw, path), _targets_std(raw, targets, path), _distances(raw, targets, path), _sensors(raw, joints, path)
    )


def _base(raw: Mapping[str, Any], path: Path) -> StatedBase | None:
    if "base" not in raw:
        return None
    section = section_of(raw, "base", path)
    refuse_unknown(section, ("position_m", "rpy_rad", "position_std_m", "rpy_std_rad"), path, "base")
    place, place_std = _stated_with(section, "position_m", "position_std_m", path)
    turn, turn_std = _stated_with(section, "rpy_rad", "rpy_std_rad", path)
    if np.isinf(place_std).all() and np.isinf(turn_std).all():
        expected = "position_m with position_std_m, or rpy_rad with rpy_std_rad, with a finite standard deviation"
        raise fault(path, expected=expected, found="nothing that is known", column="base")
    for key, values, worst, unit, wrong in (
        ("position_m", place, FARTHEST_BASE_M, "m", "millimetres"),
        ("rpy_rad", turn, MOST_TURNED, "rad", "degrees"),
        ("position_std_m", place_std, WORST_BASE_STD_M, "m", "millimetres"),
        ("rpy_std_rad", turn_std, WORST_BASE_STD_RAD, "rad", "degrees"),
    ):
        bad = np.abs(values[np.isfinite(values)]).max(initial=0.0)
        if bad > worst:
            std = "; inf: not known" if "std" in key else ""
            expected = f"numbers in {unit}, none above {worst:.4g} (is it in {wrong}?{std})"
            raise fault(path, expected=expected, found=f"{bad:g}", column=f"base.{key}")
    return StatedBase(place, turn, place_std, turn_std)


def _stated_with(section: Mapping[str, Any], key: str, std: str, path: Path) -> tuple[FloatArray, FloatArray]:
    """A vector and its standard deviations; without either of them nothing is known of it."""
    if key not in section and std not in section:
        return frozen(np.zeros(3)), frozen(np.full(3, np.inf))
    for wanted, other in ((key, std), (std, key)):
        if wanted not in section:
            raise fault(path, expected=f"base.{wanted} with base.{other}", found="none", column=f"base.{wanted}")
    return vector(section, key, f"base.{key}", path), _three_std(section, std, f"base.{std}", path, infinite=True)


def _three_std(
    section: Mapping[str, Any],
    key: str,
    where: str,
    path: Path,
    *,
    infinite: bool,
    number_of: str = "one number or three",
) -> FloatArray:
    value = section[key]
    values = value if isinstance(value, list) else [value] * 3
    good = [
        (is_number(v) and v > 0.0) or (infinite and isinstance(v, float) and v == math.inf) for v in values
    ]  # fmt: skip
    if len(values) != 3 or not all(good):
        or_inf = " or inf" if infinite else ""
        raise fault(path, expected=f"one number or three above 0{or_inf}", found=repr(value), column=where)
    return frozen(np.array(values, dtype=np.float64))


def _targets_std(raw: Mapping[str, Any], targets: Mapping[str, FloatArray], path: Path) -> Mapping[str, FloatArray]:
    section = section_of(raw, "targets_std_m", path)
    refuse_unknown(section, tuple(targets), path, "targets_std_m")
    out = {}
    for name in section:
        where = f"targets_std_m.{name}"
        out[name] = _three_std(section, name, where, path, infinite=False)
        if out[name].max() > WORST_TARGET_STD_M:
            expected = f"a standard deviation in m, not above {WORST_TARGET_STD_M:g} (is it in millimetres?)"
            raise fault(path, expected=expected, found=f"{out[name].max():g}", column=where)
    return MappingProxyType(out)


def _distances(raw: Mapping[str, Any], targets: Mapping[str, FloatArray], path: Path) -> tuple[CertifiedDistance, ...]:
    listed = raw.get("distance", [])
    if not isinstance(listed, Sequence) or not all(isinstance(d, Mapping) for d in listed):
        raise fault(path, expected="sections [[distance]]", found=repr(listed), column="distance")
    return tuple(_distance(d, f"distance[{k + 1}]", targets, path) for k, d in enumerate(listed))


def _distance(
    section: Mapping[str, Any], where: str, targets: Mapping[str, FloatArray], path: Path
) -> CertifiedDistance:
    refuse_unknown(section, ("between", "value_m", "std_m"), path, where)
    between = section.get("between")
    names = ", ".join(targets) or "it declares none"
    two = isinstance(between, list) and len(between) == 2 and between[0] != between[1]
    if not isinstance(between, list) or not two or not all(isinstance(b, str) and b in targets for b in between):
        found = missing("between", section) if between is None else repr(between)
        raise fault(path, expected=f"two targets of [targets_m] ({names})", found=found, column=f"{where}.between")
    value, std = (number(section, key, f"{where}.{key}", path) for key in ("value_m", "std_m"))
    if not 0.0 < value <= LONGEST_M:
        expected = f"a distance in m, above 0 and not above {LONGEST_M:g} (is it in millimetres?)"
        raise fault(path, expected=expected, found=f"{value:g}", column=f"{where}.value_m")
    if not 0.0 < std <= WORST_DISTANCE_STD_M:
        expected = f"one sigma in m, above 0 and not above {WORST_DISTANCE_STD_M:g} (is it in another unit?)"
        raise fault(path, expected=expected, found=f"{std:g}", column=f"{where}.std_m")
    nominal = float(np.linalg.norm(targets[between[0]] - targets[between[1]]))
    if abs(nominal - value) > NOMINAL_OFF_M:
        expected = (
            f"a distance within {NOMINAL_OFF_M:g} m of {nominal:.6g} m, as far as {between[0]} and {between[1]} are "
            "apart in [targets_m] (is it in another unit?)"
        )
        raise fault(path, expected=expected, found=f"{value:g}", column=f"{where}.value_m")
    return CertifiedDistance((between[0], between[1]), value, std)


def _sensors(raw: Mapping[str, Any], joints: int, path: Path) -> Mapping[str, Sensor]:
    out = {}
    for name, entry in section_of(raw, "sensors", path).items():
        where = f"sensors.{name}"
        if not isinstance(entry, Mapping):
            raise fault(path, expected='a place, such as {at = "link2"}', found=repr(entry), column=where)
        refuse_unknown(entry, ("at", "weight"), path, where)
        at = entry.get("at")
        numbered = re.fullmatch(r"(?:link|motor)(\d+)", at) if isinstance(at, str) else None
        if not (at in _PLACES or (numbered and 1 <= int(numbered[1]) <= joints)):
            expected = f"{', '.join(_PLACES)}, link1 … link{joints} or motor1 … motor{joints}"
            found = missing("at", entry) if at is None else repr(at)
            raise fault(path, expected=expected, found=found, column=f"{where}.at")
        weight = number(entry, "weight", f"{where}.weight", path) if "weight" in entry else 1.0
        if weight <= 0.0:
            raise fault(path, expected="a weight above 0", found=f"{weight:g}", column=f"{where}.weight")
        out[name] = Sensor(str(at), weight)
    return MappingProxyType(out)
