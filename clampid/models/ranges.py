"""The ranges on which a pose model was identified, and which part of a request lies outside them.

Of every joint's angle and gravity torque, of every link's temperature and of the tool's mass a model keeps the lowest
and the highest of the rows that it was fitted to, each by itself, over all sessions: the robot is theirs together. A
value is beyond where it leaves that range by more than :data:`RANGE_MARGIN` of its width. Angles of joints that turn
count but for whole turns, because the arm stands there as it does here. Torques are those of the described links with
the declared tool, which is what a command knows as well.

Beyond a range the stated uncertainty grows. Geometry, springs, bending and ratios are laws: their covariance through
the Jacobian grows by itself. Of an effect that is an empirical form (``known_within`` in its file) the form itself is
only known inside, and that rule stands in :func:`doubt`: each of its amplitudes there has, beside its standard error
and apart from it, a standard deviation of its own size times the distance outside in widths of the range, of its own
size at most. So it begins at nothing at the edge, and one width outside the effect is as uncertain as it is large.

There is no such rule for curves of any shape (``joint_angle_curve``), whose covariance opens to what was assumed of
them before any row was seen, as they fade to zero; none for the tool's mass, which acts through the torques; and none
for laws: whether a spring still is one under twice the load, rows inside do not tell. These are only said.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from clampid.effect import Effect
from clampid.slots import Slot
from clampid.stages.rows import Array, Bools, Integers, Rows
from experiments.temperatures import REFERENCE_TEMPERATURE

__all__ = [
    "QUANTITIES",
    "RANGE_MARGIN",
    "Beyond",
    "Empirical",
    "Ranges",
    "beyond_rows",
    "doubt",
    "empirical",
    "place_of",
    "ranges_of",
    "read_ranges",
    "reads_temperature",
]

RANGE_MARGIN = 0.02  # of a range's width, by which values may leave it: noise, and poses that were meant to be the same
QUANTITIES = ("angle", "gravity torque", "link temperature")
"""What is kept for each joint or link; rad (m of a joint that slides), Nm, degC."""

SIGNALS = ("q", "torque", "link_temperature")  # the same as effects read them
UNITS = ("rad", "Nm", "degC")
KEYS = ("q_rad", "gravity_torque_Nm", "link_temperature_C")
LEAST_WIDTH = (0.1, 1.0, 5.0)  # rad, Nm, K: by which a range counts as wide at least, such as of a joint that stood
LEAST_MASS = 1.0  # kg


class Beyond(NamedTuple):
    """One quantity beyond the range that a model was identified on; a named tuple, for servers make many.

    Attributes
    ----------
    quantity
        One of :data:`QUANTITIES`, or ``tool mass``.
    at
        ``joint2``, ``link3`` or ``tool``.
    value
        What is asked: rad (or m), Nm, degC or kg. An angle is turned by whole turns to the side of the range.
    lower, upper
        The range, in the same unit.
    unit
        Of these.
    """

    quantity: str
    at: str
    value: float
    lower: float
    upper: float
    unit: str

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        identified = [self.lower, self.upper]
        return {"quantity": self.quantity, "at": self.at, "value": self.value, "identified": identified,
                "unit": self.unit}  # fmt: skip


@dataclass(frozen=True)
class Ranges:
    """What a pose model was identified on.

    Attributes
    ----------
    lower, upper
        ``(3, n)``, in the order of :data:`QUANTITIES`; not a number where nothing was recorded.
    kinds
        ``(n,)``: of the joints; revolute ones stand after a whole turn as before.
    tool_mass
        kg, the least and the largest.
    """

    lower: Array
    upper: Array
    kinds: tuple[str, ...]
    tool_mass: tuple[float, float]

    @cached_property
    def width(self) -> Array:
        """``(3, n)``: of the ranges, as distances from them are counted."""
        return np.asarray(np.maximum(self.upper - self.lower, np.array(LEAST_WIDTH)[:, None]))

    @cached_property
    def middle(self) -> Array:
        """``(3, n)``."""
        return 0.5 * (self.lower + self.upper)

    @cached_property
    def reach(self) -> Array:
        """``(3, n)``: how far from the middle a value may be."""
        return 0.5 * (self.upper - self.lower) + RANGE_MARGIN * self.width

    @cached_property
    def turns(self) -> Bools:
        """``(n,)``: which joints stand after a whole turn as before."""
        return np.array([kind == "revolute" for kind in self.kinds])

    def turned(self, q: Array) -> Array:
        """Joint angles ``(…, n)``, rad, turned by whole turns to the side of the range."""
        whole = np.floor((q - self.middle[0]) / (2 * np.pi) + 0.5)
        return np.asarray(q - 2 * np.pi * np.where(self.turns, whole, 0.0))

    def distance(self, values: Array) -> Array:
        """By how many widths values ``(…, 3, n)``, angles already turned, are beyond; 0 inside or where not known."""
        return np.asarray(np.fmax((np.abs(values - self.middle) - self.reach) / self.width, 0.0))

    def beyond(self, values: Array) -> tuple[Beyond, ...]:
        """What of values ``(3, n)``, angles already turned, is beyond."""
        return tuple(
            self._beyond(k, i, float(values[k, i])) for k, i in np.argwhere(self.distance(values) > 0).tolist()
        )

    def beyond_temperature(self, temperature: float) -> tuple[Beyond, ...]:
        """The links for which one temperature of all of them, degC, is beyond."""
        values = np.full(self.lower.shape, np.nan)
        values[QUANTITIES.index("link temperature")] = temperature
        return self.beyond(values)

    def beyond_mass(self, mass: float) -> tuple[Beyond, ...]:
        """The tool's mass, kg, if it is beyond."""
        low, high = self.tool_mass
        margin = RANGE_MARGIN * max(high - low, LEAST_MASS)
        return () if low - margin <= mass <= high + margin else (Beyond("tool mass", "tool", mass, low, high, "kg"),)

    def _beyond(self, kind: int, index: int, value: float) -> Beyond:
        at = place_of(kind, index)
        unit = "m" if kind == 0 and self.kinds[index] == "prismatic" else UNITS[kind]
        return Beyond(QUANTITIES[kind], at, value, float(self.lower[kind, index]), float(self.upper[kind, index]), unit)

    def to_json(self) -> dict[str, Any]:
        """For the model file; null where nothing was recorded."""
        pairs = np.stack([self.lower, self.upper], axis=-1)
        known = [[None if np.isnan(pair).any() else pair.tolist() for pair in kind] for kind in pairs]
        return {
            **dict(zip(KEYS, known, strict=True)),
            "tool_mass_kg": list(self.tool_mass),
            "joint_kinds": list(self.kinds),
        }


def place_of(kind: int, index: int) -> str:
    """``joint2`` or ``link3``: where the one of :data:`QUANTITIES` is, from 0."""
    return f"{'link' if kind == 2 else 'joint'}{index + 1}"


def read_ranges(data: Mapping[str, Any] | None) -> Ranges | None:
    """The ranges of a model file; None of one that does not have them."""
    if data is None:
        return None
    nothing = [np.nan, np.nan]
    pairs = np.array([[nothing if pair is None else pair for pair in data[key]] for key in KEYS], dtype=float)
    low, high = (float(mass) for mass in data["tool_mass_kg"])
    return Ranges(pairs[..., 0], pairs[..., 1], tuple(data["joint_kinds"]), (low, high))


def ranges_of(rows: Rows, outliers: Bools) -> Ranges:
    """The ranges of the pose rows of a fit, those rejected ``(N,)`` left out."""
    values, masses = _recorded(rows.take(~outliers)), rows.pose.tool_mass[~outliers]
    known = np.isfinite(values)
    lower = np.where(known, values, np.inf).min(axis=0, initial=np.inf)
    upper = np.where(known, values, -np.inf).max(axis=0, initial=-np.inf)
    nothing = ~known.any(axis=0)
    lower[nothing], upper[nothing] = np.nan, np.nan
    kinds = tuple(joint.kind for joint in rows.robot.joints)
    return Ranges(lower, upper, kinds, (float(masses.min()), float(masses.max())))


def _recorded(rows: Rows) -> Array:
    """Angles, gravity torques and temperatures ``(N, 3, n)`` of pose rows; not a number where none was recorded."""
    warmth = np.where(rows.pose.link_recorded, rows.signals["link_temperature"] + REFERENCE_TEMPERATURE, np.nan)
    return np.stack([rows.signals["q"], rows.signals["gravity_torque"], warmth], axis=1)


def beyond_rows(
    ranges: Ranges, rows: Rows, slots: Sequence[Slot], effects: Mapping[str, Effect]
) -> tuple[Bools, list[tuple[Beyond, int]]]:
    """Where pose rows are beyond what a model was identified on.

    Parameters
    ----------
    slots
        The model's. If one of their effects reads temperatures, a link without a sensor counts as of 20 degC, as it
        does in the prediction.

    Returns
    -------
    rows
        ``(N,)``: which are beyond in anything.
    quantities
        What is, at its furthest value, and in how many rows; the most first.
    """
    values = _recorded(rows)
    if reads_temperature(slots, effects):
        values[:, 2] = rows.signals["link_temperature"] + REFERENCE_TEMPERATURE
    values[:, 0] = ranges.turned(values[:, 0])
    distance = ranges.distance(values)
    far: Bools = np.asarray((distance > 0).any(axis=(1, 2)))
    found = []
    for k, i in np.argwhere((distance > 0).any(axis=0)).tolist():
        furthest = float(values[np.argmax(distance[:, k, i]), k, i])
        found.append((ranges._beyond(k, i, furthest), int((distance[:, k, i] > 0).sum())))
    masses = rows.pose.tool_mass
    for mass in np.unique(masses).tolist():
        for other in ranges.beyond_mass(mass):
            far = far | (masses == mass)
            found.append((other, int((masses == mass).sum())))
    return far, sorted(found, key=lambda one: -one[1])


def reads_temperature(slots: Sequence[Slot], effects: Mapping[str, Effect]) -> bool:
    """Whether a model's prediction depends on the links' temperatures."""
    return any("link_temperature" in effects[slot.effect].needs for slot in slots)


class Empirical(NamedTuple):
    """The amplitudes of a model whose effects' form is only known inside the ranges.

    Attributes
    ----------
    parameter
        ``(E,)``: which of the model's parameters.
    kind, place
        ``(E,)``: the quantity and the joint or link, from 0, whose range they are known within.
    """

    parameter: Integers
    kind: Integers
    place: Integers


def empirical(slots: Sequence[Slot], effects: Mapping[str, Effect]) -> Empirical:
    """The amplitudes that :func:`doubt` is about.

    That a torque at a joint reaches other motors through a coupled transmission is left out: an amplitude goes by the
    joint that it is named after.
    """
    found = [
        (k, SIGNALS.index(within), slot.number)
        for k, slot in enumerate(slots)
        if (within := effects[slot.effect].known_within) and not effects[slot.effect].by_name[slot.parameter].shape
    ]
    table = np.array(found, dtype=np.int64).reshape(-1, 3)
    return Empirical(table[:, 0], table[:, 1], table[:, 2])


def doubt(which: Empirical, theta: Array, distance: Array) -> Array:
    """Standard deviations ``(E,)`` by which empirical amplitudes are less known than their covariance says.

    Parameters
    ----------
    theta
        ``(P,)``: the model's parameters.
    distance
        ``(3, n)``: see :meth:`Ranges.distance`.
    """
    return np.abs(theta[which.parameter]) * np.minimum(distance[which.kind, which.place], 1.0)
