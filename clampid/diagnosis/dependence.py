"""Dependences by name: which variables and places an effect of unknown physics may have, stage by stage.

If no known effect explains the residual, the verdict names a dependence: variables by their column names without unit
(``q4``, ``dir4``, ``time``) and a place (``joint5``, ``base``). :func:`clampid.diagnosis.effect_new.effect_text` makes
an effect file of it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from clampid.effect import EffectError, Stage, signal
from clampid.stages.stage_kind import kind_of
from experiments.columns import is_further, parted

__all__ = ["AXES", "Dependence", "Place", "Variable", "dependence"]

Basis = Literal["winding", "fourier", "sign", "powers", "sliding"]

AXES: Mapping[str, str] = {"rx": "rad", "ry": "rad", "rz": "rad", "x": "m", "y": "m", "z": "m"}
"""The six numbers of a small motion, in the chain's order, with their units."""


@dataclass(frozen=True)
class Variable:
    """A recorded variable as an effect reads it.

    Attributes
    ----------
    name
        Column name without unit, such as ``q4``; of a column beyond the contract with its unit.
    signals
        Signals of :data:`clampid.effect.SIGNALS` that it is read from.
    code
        Expressions of the row's signals ``x``: one, or for speeds two (sign of the motion, speed).
    index
        Which number of its signals it is, from 0; None where they have one only.
    basis
        What smooth functions of it are made of.
    scale
        What it is divided by to be of order one, SI; 1 for angles and signs.
    unit
        SI.
    """

    name: str
    signals: tuple[str, ...]
    code: tuple[str, ...]
    index: int | None
    basis: Basis
    scale: float
    unit: str

    @property
    def arguments(self) -> tuple[str, ...]:
        """Names of its arguments in a function of a shape, one an expression of :attr:`code`."""
        return (self.name,) if len(self.code) == 1 else (f"sign_{self.name}", self.name)


@dataclass(frozen=True)
class Place:
    """Where an effect acts: its station, and what a unit of it is there.

    Attributes
    ----------
    number
        From 1; 0 where the place has none.
    units
        Of each of its numbers: one at a joint or motor, three or six elsewhere.
    size
        What a factor may reasonably amount to, in that unit.
    """

    name: str
    station: str
    number: int
    units: Mapping[str, str]
    size: float


@dataclass(frozen=True)
class Dependence:
    """Variables, place and stage, all known to exist."""

    stage: Stage
    variables: tuple[Variable, ...]
    place: Place


@dataclass(frozen=True)
class _Kind:
    """A kind of variable: how each of its numbers is read."""

    signals: tuple[str, ...]
    code: tuple[str, ...]
    basis: Basis
    scale: float = 1.0
    unit: str = ""
    numbered: bool = True


_ANGLE, _HOUR, _WARM = "rad", 3600.0, 10.0
_FURTHER_SCALE: Mapping[str, float] = {"s": _HOUR, "C": _WARM, "K": _WARM, "percent": 10.0, "Pa": 1e5}  # by unit
_MOTOR_LOAD = _Kind(("torque",), ("(x.transmission @ x.torque)[{i}]",), "powers", 10.0, "Nm")
_ANYWHERE: Mapping[str, _Kind] = {
    "q": _Kind(("q",), ("x.q[{i}]",), "winding", unit=_ANGLE),
    "motor": _Kind(("motor",), ("x.motor[{i}]",), "fourier", unit=_ANGLE),
    "time": _Kind(("elapsed",), ("x.elapsed",), "powers", _HOUR, "s", numbered=False),
    "temp_link": _Kind(("link_temperature",), ("x.link_temperature[{i}]",), "powers", _WARM, "K"),
    "temp_motor": _Kind(("motor_temperature",), ("x.motor_temperature[{i}]",), "powers", _WARM, "K"),
    "temp_ambient": _Kind(("ambient_temperature",), ("x.ambient_temperature",), "powers", _WARM, "K", numbered=False),
}
_KINDS: Mapping[Stage, Mapping[str, _Kind]] = {
    "free_air": {
        **_ANYWHERE,
        "tau": _MOTOR_LOAD,
        "qd": _Kind(("motor_motion", "motor_speed"), ("x.motor_motion[{i}]", "x.motor_speed[{i}]"), "sliding", 100.0,
                    "rad/s"),
        "qdd": _Kind(("joint_acceleration",), ("x.joint_acceleration[{i}]",), "powers", 1.0, "rad/s^2"),
    },
    "clamped": {
        **_ANYWHERE,
        "tau": _MOTOR_LOAD,
        "dir": _Kind(("motor_motion",), ("x.motor_motion[{i}]",), "sign"),
    },
    "poses": {
        **_ANYWHERE,
        "tau": _Kind(("torque",), ("x.torque[{i}]",), "powers", 100.0, "Nm"),
        "dir": _Kind(("direction",), ("x.direction[{i}]",), "sign"),
        **{
            axis: _Kind(("position",), (f"x.position[{k}]",), "powers", 1.0, "m", numbered=False)
            for k, axis in enumerate("xyz")
        },
    },
}  # fmt: skip
_SCALAR: Mapping[str, tuple[str, str, float]] = {  # station -> symbol, unit, size
    "joint_angle": ("dq", "rad", 1e-4),
    "joint_torque": ("tau", "Nm", 10.0),
    "motor_torque": ("tau_motor", "Nm", 0.5),
}
_STATIONS: Mapping[Stage, Mapping[str, str]] = {
    "free_air": {"joint": "joint_torque", "motor": "motor_torque"},
    "clamped": {"joint": "joint_angle", "motor": "motor_torque", "fixture": "fixture"},
    "poses": {
        "joint": "joint_angle", "link": "link_twist", "flange": "link_twist", "base": "base_twist",
        "tool": "target_shift", "instrument": "measurement",
    },
}  # fmt: skip
_NUMBERED = ("joint", "motor", "link")
_MOVED = 1e-4  # m and rad


def dependence(depends_on: Sequence[str], at: str, stage: Stage | None = None, joints: int | None = None) -> Dependence:
    """Look up variables and a place by name.

    Parameters
    ----------
    depends_on
        Column names without unit: ``q4``, ``dir2``, ``time``, ``temp_link2``, ``tau3``, ``qd1``, ``z``, ``motor3``. Of
        poses also columns beyond the contract, with their unit, such as ``humidity_percent``.
    at
        ``joint4``, ``motor4``, ``link4``, ``flange``, ``tool``, ``base``, ``fixture``, ``instrument``.
    stage
        Where it acts; by default the first of poses, free_air and clamped that has them all.
    joints
        How many axes the robot has; None: not known.

    Raises
    ------
    EffectError
        A variable or the place does not exist in the stage; the message says what does.
    """
    if stage is not None and stage not in _STATIONS:
        raise EffectError(f"stage {stage!r} is not known; known: {', '.join(_STATIONS)}")
    if not depends_on:
        raise EffectError("expected at least one variable that the effect depends on, found none")
    for name in depends_on:
        if depends_on.count(name) > 1:
            raise EffectError(f"variable {name!r} is named twice; expected each once")
    for name in (*depends_on, at) if joints is not None else ():
        number = _split(name)[1]
        if number > (joints or 0) and signal(name) is None:
            raise EffectError(f"{name!r}: the robot has {joints} axes; expected a number from 1 to {joints}")
    chosen = stage or _first(depends_on, at)
    place = _place(at, chosen)
    variables = tuple(_variable(name, chosen) for name in depends_on)
    for v in variables:
        if v.signals == ("position",) and at != "instrument":
            raise EffectError(
                f"variable {v.name!r} is a reading of the instrument, which a command to the robot does not have; an "
                f"effect of it can sit at the instrument only, found {at!r}"
            )
    return Dependence(chosen, variables, place)


def _first(depends_on: Sequence[str], at: str) -> Stage:
    """The first stage that knows all names; if none does, the first that knows the place, to say what is wrong."""
    stages = sorted(_STATIONS, key=lambda stage: not kind_of(stage).points)
    placed = [s for s in stages if _split(at)[0] in _STATIONS[s]]
    fitting = [s for s in placed if all(_split(name)[0] in _KINDS[s] for name in depends_on)]
    return (fitting or placed or stages)[0]


def _split(name: str) -> tuple[str, int]:
    """``("temp_link", 2)`` from ``temp_link2``; 0 without a number, -1 with one that cannot be."""
    found = re.fullmatch(r"([a-z_]+?)([0-9]*)", name)
    if found is None:
        return name, 0
    digits = found[2]
    if not digits:
        return found[1], 0
    return found[1], int(digits) if re.fullmatch("[1-9][0-9]?", digits) else -1


def _variable(name: str, stage: Stage) -> Variable:
    head, number = _split(name)
    kind = _KINDS[stage].get(head)
    if kind is None and signal(name) is not None and name.startswith("temp_"):  # any other sensor
        return Variable(name, (name,), (f"x.{name}",), None, "powers", _WARM, "K")
    if kind_of(stage).points and is_further(name) and _split(parted(name)[0])[0] not in _KINDS[stage]:
        return Variable(name, (name,), (f"x.{name}",), None, "powers", _FURTHER_SCALE.get(parted(name)[1], 1.0), "")
    if kind is None or kind.numbered != (number > 0) or number < 0:
        known = ", ".join(_listed((k, v.numbered) for k, v in _KINDS[stage].items()))
        raise EffectError(f"variable {name!r} is not known in {stage}; known: {known}")
    code = tuple(c.format(i=number - 1) for c in kind.code)
    index = number - 1 if kind.numbered else "xyz".find(name) if name in "xyz" else None
    return Variable(name, kind.signals, code, index, kind.basis, kind.scale, kind.unit)


def _place(at: str, stage: Stage) -> Place:
    head, number = _split(at)
    station = _STATIONS[stage].get(head)
    if station is None or (head in _NUMBERED) != (number > 0) or number < 0:
        known = ", ".join(_listed((k, k in _NUMBERED) for k in _STATIONS[stage]))
        raise EffectError(f"nothing acts at {at!r} in {stage}; known: {known}")
    if station in _SCALAR:
        symbol, unit, size = _SCALAR[station]
        return Place(at, station, number, {symbol: unit}, size)
    if station in ("measurement", "target_shift"):
        return Place(at, station, number, {axis: AXES[axis] for axis in "xyz"}, _MOVED)
    return Place(at, station, number, AXES, _MOVED)


def _listed(names: Iterator[tuple[str, bool]]) -> list[str]:
    """``q1, q2, …`` for what is numbered, the name itself for what is not."""
    return [f"{name}1, {name}2, …" if numbered else name for name, numbered in names]
