"""Values of a cell file, each checked for what it can be: kind, count, and the size that its unit allows.

The bounds are wide of anything that stands in a hall. They are there for millimetres, degrees and kelvin in the place
of metres, radians and degrees Celsius.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from offline_ik.errors import CellError

__all__ = ["known", "number", "numbers", "positive", "sizes", "spread", "switch", "temperatures", "text", "whole"]

Array = npt.NDArray[np.float64]

COLDEST, HOTTEST = -273.15, 200.0  # °C: what a temperature of a robot may be
APART = 5e-3  # m: by how much targets must lie off a line


def known(where: str, part: Any, keys: Sequence[str]) -> Mapping[str, Any]:
    """A table with no other keys.

    Raises
    ------
    CellError
        It is none, or has.
    """
    if not isinstance(part, Mapping):
        raise CellError(f"{where}: expected a table, found {part!r}")
    for key in part:
        if key not in keys:
            raise CellError(f"{where or 'cell'}: the key {key!r} is not known; expected {', '.join(keys)}")
    return part


def numbers(where: str, value: Any, count: int, most: float = math.inf, unit: str = "") -> Array:
    """Finite numbers ``(count,)``, none larger than ``most``.

    Raises
    ------
    CellError
        They are something else.
    """
    plain = isinstance(value, list | tuple) and all(type(v) in (int, float) for v in value)
    if not plain or len(value) != count or not all(map(math.isfinite, value)):
        raise CellError(f"{where}: expected {count} finite numbers, found {value!r}")
    if max(map(abs, value), default=0.0) > most:
        raise CellError(f"{where}: expected {unit} of at most {most:g}, found {value!r}{_hint(unit)}")
    return np.asarray(value, dtype=float)


def sizes(where: str, value: Any, count: int, most: float) -> Array:
    """Positive lengths ``(count,)``, m.

    Raises
    ------
    CellError
        They are not positive, or larger than ``most``.
    """
    found = numbers(where, value, count, most, "metres")
    if (found <= 0).any():
        raise CellError(f"{where}: expected positive sizes, found {value!r}")
    return found


def temperatures(where: str, value: Any, count: int) -> Array:
    """Temperatures ``(count,)`` of a robot's joints, °C.

    Raises
    ------
    CellError
        They are not as many, or of no robot (kelvin?).
    """
    found = numbers(where, value, count)
    if not ((found > COLDEST) & (found < HOTTEST)).all():
        raise CellError(f"{where}: expected degC from {COLDEST:g} to {HOTTEST:g}, found {value!r}; are these kelvin?")
    return found


def number(where: str, value: Any, most: float = math.inf, unit: str = "") -> float:
    """A finite number from 0 to ``most``.

    Raises
    ------
    CellError
        It is something else.
    """
    if type(value) not in (int, float) or not math.isfinite(value) or value < 0:
        raise CellError(f"{where}: expected a number of at least 0, found {value!r}")
    if value > most:
        raise CellError(f"{where}: expected {unit or 'a number'} of at most {most:g}, found {value!r}{_hint(unit)}")
    return float(value)


def positive(where: str, value: Any, most: float = math.inf, unit: str = "") -> float:
    """A finite number above 0 and up to ``most``.

    Raises
    ------
    CellError
        It is something else.
    """
    if not number(where, value, most, unit) > 0:
        raise CellError(f"{where}: expected a positive number, found {value!r}")
    return float(value)


def whole(where: str, value: Any) -> int:
    """A whole number from 1.

    Raises
    ------
    CellError
        It is something else.
    """
    if type(value) is not int or value < 1:
        raise CellError(f"{where}: expected a whole number from 1, found {value!r}")
    return int(value)


def switch(where: str, value: Any) -> bool:
    """True or false.

    Raises
    ------
    CellError
        It is something else.
    """
    if not isinstance(value, bool):
        raise CellError(f"{where}: expected true or false, found {value!r}")
    return value


def text(where: str, value: Any) -> str:
    """A text.

    Raises
    ------
    CellError
        It is something else.
    """
    if not isinstance(value, str):
        raise CellError(f"{where}: expected a text, found {value!r}")
    return value


def spread(where: str, points: Mapping[str, Array]) -> Mapping[str, Array]:
    """Names and points ``(3,)``, m, from which a rigid motion can be told.

    Raises
    ------
    CellError
        They are fewer than three, or lie on a line, about which nothing tells the motion.
    """
    if not points:
        return points
    if len(points) < 3:
        raise CellError(f"{where}: expected at least three targets, found {len(points)}")
    placed = np.array(list(points.values()))
    off = np.linalg.svd(placed - placed.mean(axis=0), compute_uv=False)[1] / math.sqrt(len(points))
    if off < APART:
        raise CellError(
            f"{where}: expected targets at least {1e3 * APART:g} mm (root mean square) off a line, found "
            f"{', '.join(points)} within {1e3 * off:.1f} mm of one"
        )
    return points


def _hint(unit: str) -> str:
    return {"metres": "; are these millimetres?", "radians": "; are these degrees?"}.get(unit, "")
