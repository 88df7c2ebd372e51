"""What a ``campaign.toml`` states as known beforehand: the base, targets, certified distances, where sensors sit.

``[base]``, ``[targets_std_m]``, ``[[distance]]`` and ``[sensors]``. A statement comes with its standard deviation: it
weighs against what is measured as one more measurement, and is no constraint.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from kinematics.fixed_angles import rotation_of
from kinematics.section import Section, shown
from kinematics.typing_ import frozen_array

__all__ = ["UNREAD", "CertifiedDistance", "Sensor", "Stated", "StatedBase", "stated_in"]

FloatArray = npt.NDArray[np.float64]

UNREAD = ("flange_sensor", "fixed_points_m", "fixed_points_std_m", "displacement")
"""Sections of the campaign format whose tables are not read."""

FARTHEST_BASE_M = 100.0  # of a tracker: beyond, millimetres
MOST_TURNED = 4.0 * np.pi  # rad: beyond, degrees
WORST_BASE_STD_M = 1.0
WORST_BASE_STD_RAD = np.pi
WORST_INCLINATION_STD_RAD = 5e-3  # a level sees what settles; beyond, degrees
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
    inclinometer_std
        Of one reading of the table ``inclination``, rad; None: not stated.
    """

    base: StatedBase | None = None
    targets_std: Mapping[str, FloatArray] = field(default_factory=dict)
    distances: tuple[CertifiedDistance, ...] = ()
    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    inclinometer_std: float | None = None

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
        if self.inclinometer_std is not None:
            out["inclinometer"] = {"std_rad": self.inclinometer_std}
        return out


def stated_in(root: Section, targets: Mapping[str, FloatArray], joints: int) -> Stated:
    """What the sections of a ``campaign.toml`` state.

    Parameters
    ----------
    root
        The file.
    targets
        Nominal targets in the flange frame, m, ``(3,)`` each.
    joints
        How many the robot has.

    Raises
    ------
    CampaignError
        A key is unknown or missing, or a number is in a wrong unit or contradicts another.
    """
    stds, sensors = root.section("targets_std_m", optional=True), root.section("sensors", optional=True)
    known = {name: stds.three(name, WORST_TARGET_STD_M, "m") for name in targets if stds.has(name)}
    stds.done()
    places = {name: _sensor(sensors, name, joints) for name in sensors.keys()}  # noqa: SIM118 - not a dict
    distances = tuple(_distance(at, targets) for at in root.sections("distance", optional=True))
    inclinometer = root.section("inclinometer", optional=True)
    level = inclinometer.number("std_rad", 0.0, WORST_INCLINATION_STD_RAD, unit="rad", above=True, default=None)
    inclinometer.done()
    return Stated(_base(root), MappingProxyType(known), distances, MappingProxyType(places), level)


def _base(root: Section) -> StatedBase | None:
    if not root.has("base"):
        return None
    at = root.section("base")
    place, place_std = _with_std(at, "position", "m", FARTHEST_BASE_M, WORST_BASE_STD_M)
    turn, turn_std = _with_std(at, "rpy", "rad", MOST_TURNED, WORST_BASE_STD_RAD)
    at.done()
    if np.isinf(place_std).all() and np.isinf(turn_std).all():
        expected = "position_m with position_std_m, or rpy_rad with rpy_std_rad, with a finite standard deviation"
        raise root.fault("base", expected, "nothing that is known")
    return StatedBase(place, turn, place_std, turn_std)


def _with_std(at: Section, name: str, unit: str, farthest: float, worst: float) -> tuple[FloatArray, FloatArray]:
    """A vector and its standard deviations; without either of them nothing is known of it."""
    key, std = f"{name}_{unit}", f"{name}_std_{unit}"
    given = [one for one in (key, std) if at.has(one)]
    if not given:
        return frozen_array(np.zeros(3)), frozen_array(np.full(3, np.inf))
    for wanted in (key, std):
        if wanted not in given:
            raise at.fault(wanted, f"base.{wanted} with base.{given[0]}", "none")
    return at.vector(key, 3, -farthest, farthest, unit), at.three(std, worst, unit, infinite=True)


def _distance(at: Section, targets: Mapping[str, FloatArray]) -> CertifiedDistance:
    names = ", ".join(targets) or "it declares none"
    expected = f"two targets of [targets_m] ({names})"
    between = at.value("between", expected)
    if (
        not isinstance(between, list)
        or len(between) != 2
        or between[0] == between[1]
        or not all(isinstance(one, str) and one in targets for one in between)
    ):
        raise at.fault("between", expected, shown(between))
    value = at.number("value_m", 0.0, LONGEST_M, "m", above=True)
    std = at.number("std_m", 0.0, WORST_DISTANCE_STD_M, "m", above=True)
    at.done()
    nominal = float(np.linalg.norm(targets[between[0]] - targets[between[1]]))
    if abs(nominal - value) > NOMINAL_OFF_M:
        expected = (
            f"a distance within {NOMINAL_OFF_M:g} m of {nominal:.6g} m, as far as {between[0]} and {between[1]} are "
            "apart in [targets_m] (is it in another unit?)"
        )
        raise at.fault("value_m", expected, f"{value:g}")
    return CertifiedDistance((between[0], between[1]), value, std)


def _sensor(sensors: Section, name: str, joints: int) -> Sensor:
    if not isinstance(sensors.content[name], Mapping):
        raise sensors.fault(name, 'a place, such as {at = "link2"}', shown(sensors.content[name]))
    entry = sensors.section(name)
    expected = f"{', '.join(_PLACES)}, link1 … link{joints} or motor1 … motor{joints}"
    place = entry.value("at", expected)
    numbered = re.fullmatch(r"(?:link|motor)([1-9]\d?)", place, re.ASCII) if isinstance(place, str) else None
    if place not in _PLACES and not (numbered and int(numbered[1]) <= joints):
        raise entry.fault("at", expected, shown(place))
    sensor = Sensor(place, entry.number("weight", 0.0, default=1.0, above=True))
    entry.done()
    return sensor
