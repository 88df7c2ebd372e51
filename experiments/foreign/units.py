"""What kind of number each column of a campaign holds, named without its unit, and the units that files write it in."""

from __future__ import annotations

import re
from typing import Literal

import numpy as np
import numpy.typing as npt

__all__ = ["DATE", "UNITS", "Kind", "campaign_name", "kind_of", "to_si", "units_of"]

FloatArray = npt.NDArray[np.float64]
Kind = Literal["angle", "length", "temperature", "time", "torque", "speed", "count", "text", "extra"]

DATE = "date"  # a unit of time: a date and time of day, read by a pattern
UNITS: dict[str, dict[str, float]] = {
    "angle": {
        "rad": 1.0, "deg": np.pi / 180, "mrad": 1e-3, "gon": np.pi / 200, "arcsec": np.pi / 648000, "rev": 2 * np.pi,
    },
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "inch": 0.0254},
    "temperature": {"degC": 1.0, "K": 1.0, "degF": 5 / 9},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0, DATE: 1.0},
    "torque": {"Nm": 1.0, "mNm": 1e-3},
    "speed": {"rad/s": 1.0, "deg/s": np.pi / 180, "rpm": np.pi / 30},
}  # fmt: skip
"""Kind → unit → factor to SI (°C for temperatures); the first of each is the campaign's own."""
ZEROS = {"degC": 0.0, "K": -273.15, "degF": -160 / 9}  # in °C, where the unit says 0

_KINDS: tuple[tuple[str, Kind, str], ...] = (
    (r"temp_\w+", "temperature", "C"),
    (r"time", "time", "s"),
    (r"(fixture_)?[xyz]|distance", "length", "m"),
    (r"(q|motor)\d+|fixture_r[xyz]", "angle", "rad"),
    (r"qd\d+", "speed", "rad_s"),
    (r"tau\d+", "torque", "Nm"),
    (r"pose|visit|run|sweep|joint|dir\d+", "count", ""),
    (r"target|anchor", "text", ""),
)


def kind_of(name: str) -> Kind:
    """What a campaign's column holds; ``extra`` for one that the campaign format does not know."""
    return next((kind for pattern, kind, _ in _KINDS if re.fullmatch(pattern, name)), "extra")


def units_of(kind: str) -> tuple[str, ...]:
    """The units that a kind of number may have in a file; none for names, counts and extra columns."""
    return tuple(UNITS.get(kind, ()))


def campaign_name(name: str) -> str:
    """The campaign's column of a name without unit: ``q1_rad`` for ``q1``."""
    suffix = next((suffix for pattern, _, suffix in _KINDS if re.fullmatch(pattern, name)), "")
    return f"{name}_{suffix}" if suffix else name


def to_si(numbers: FloatArray, unit: str) -> FloatArray:
    """Numbers in SI units, temperatures in °C; as they are without a unit."""
    factor = next((units[unit] for units in UNITS.values() if unit in units), 1.0)
    return factor * numbers + ZEROS.get(unit, 0.0)
