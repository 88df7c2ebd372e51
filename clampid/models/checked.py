"""What a model file may say: every key known, every number a finite number of a size that can be meant, nothing twice.

A parameter that does not exist would be dropped in silence by what computes with the model; here it is an error.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Any

from clampid.catalogue import catalogue
from clampid.effect import STAGES, Effect
from clampid.slots import Layout, Slot, find_parameter
from kinematics.escaping import has_controls

__all__ = ["check_model", "check_slot"]

MOST_JOINTS = 50
MOST_NAMES = 10_000
LONGEST = 200  # characters of a name
LARGEST_TOOL = 1e4  # kg
LARGEST = {"rad": 100.0, "m": 100.0, "kg": 1e5, "kg m": 1e6, "kg m^2": 1e7, "s": 1e9, "rad/s": 1e6, "Nm": 1e8, "N": 1e8}
"""Of a value, by its unit: beyond, it is in another unit or spoiled."""
LARGEST_OF_ALL = 1e15

MODEL = (
    "format", "robot", "robot_file", "layout", "seed", "holdout", "user_effects", "joint", "sessions", "stages",
    "ledger",
)  # fmt: skip
LAYOUT = ("joints", "targets", "anchors", "sessions", "wrist")
SESSION = (
    "name", "fingerprint", "base_reference", "targets", "anchors_m", "tool_mass_kg", "temperature_C", "tool_com_m",
    "gravity_m_s2",
)  # fmt: skip
STAGE = (
    "effects", "parameters", "covariance", "held_out", "outliers", "not_identifiable", "base_parameters",
    "observability", "bootstrap", "told", "lean_rad", "by_springs", "ranges",
)  # fmt: skip
PARAMETER = ("effect", "parameter", "at", "value", "std", "identified")
ROUND = ("stage", "effects", "added", "rms", "heldout_rms", "noise_floor", "evidence")


class _CheckError(ValueError):
    """What is wrong in a model file, without the file's name."""


def check_model(data: Mapping[str, Any]) -> None:
    """Refuse what a model file cannot mean.

    Parameters
    ----------
    data
        Of the JSON, its ``format`` already looked at.

    Raises
    ------
    ValueError
        A key is not known, a value is of another kind or size, a parameter does not exist or comes twice.
    """
    _keys("the model", data, MODEL)
    _name("robot", data.get("robot"))
    for key in ("robot_file", "user_effects"):
        if data.get(key) is not None:
            _name(key, data[key], 4096)
    layout = _layout(data.get("layout"))
    for key in ("seed", "holdout"):
        _number(key, data.get(key))
    sessions = _list("sessions", data.get("sessions"), MOST_NAMES)
    for k, session in enumerate(sessions, 1):
        _session(f"session {k}", session)
    if sessions and len(sessions) != len(layout.sessions):
        raise _CheckError(f"layout.sessions: expected {len(sessions)} names, found {len(layout.sessions)}")
    stages = _table("stages", data.get("stages"))
    for name, stage in stages.items():
        if name not in STAGES:
            raise _CheckError(f"stage {name!r} is not known; known: {', '.join(STAGES)}")
        _stage(name, stage, layout)
    for k, part in enumerate(_list("ledger", data.get("ledger"), MOST_NAMES), 1):
        _keys(f"round {k}", part, ROUND)
        for key in ("rms", "heldout_rms", "noise_floor"):
            _number(f"round {k}: {key}", part.get(key), low=0.0)


def check_slot(slot: Slot, effects: Mapping[str, Effect], layout: Layout) -> None:
    """Refuse a parameter that its effect does not have, or not there.

    Raises
    ------
    ValueError
        It does not exist; the message says what does.
    """
    effect = effects[slot.effect]
    if slot.parameter not in effect.by_name:
        raise _CheckError(
            f"effect {slot.effect} has no parameter {slot.parameter!r}{_near(slot.parameter, effect.by_name)}"
        )
    places = layout.places(effect, effect.by_name[slot.parameter])
    if slot.place not in places:
        some = f"{', '.join(places[:8])}{' …' if len(places) > 8 else ''}" or "nowhere in this model"
        raise _CheckError(f"{slot.effect}.{slot.parameter} cannot sit at {slot.place!r}; it can at: {some}")


def _layout(data: Any) -> Layout:
    _keys("layout", data, LAYOUT)
    joints = data.get("joints")
    if isinstance(joints, bool) or not isinstance(joints, int) or not 1 <= joints <= MOST_JOINTS:
        raise _CheckError(f"layout.joints: expected 1 to {MOST_JOINTS}, found {_shown(joints)}")
    names = {}
    for key in ("targets", "anchors", "sessions"):
        names[key] = tuple(_name(f"layout.{key}", n) for n in _list(f"layout.{key}", data.get(key, []), MOST_NAMES))
        _once(f"layout.{key}", names[key])
    wrist = _list("layout.wrist", data.get("wrist"), MOST_JOINTS)
    for joint in wrist:
        if isinstance(joint, bool) or not isinstance(joint, int) or not 0 <= joint < joints:
            raise _CheckError(f"layout.wrist: expected joints from 0 to {joints - 1}, found {_shown(joint)}")
    return Layout(joints, names["targets"], names["sessions"], tuple(wrist), names["anchors"])


def _session(where: str, data: Any) -> None:
    _keys(where, data, SESSION)
    _name(f"{where}: name", data.get("name"))
    _number(f"{where}: tool_mass_kg", data.get("tool_mass_kg"), 0.0, LARGEST_TOOL)
    for key, most in (("tool_com_m", 100.0), ("gravity_m_s2", 100.0), ("temperature_C", 1e4)):
        if data.get(key) is not None:
            for value in _list(f"{where}: {key}", data[key], 3):
                _number(f"{where}: {key}", value, -most, most)


def _stage(where: str, data: Any, layout: Layout) -> None:
    _keys(where, data, STAGE)
    for label in _list(f"{where}: effects", data.get("effects"), MOST_NAMES):
        _name(f"{where}: effects", label)
    slots = []
    parameters = _list(f"{where}: parameters", data.get("parameters"), MOST_NAMES)
    for part in parameters:
        _keys(f"{where}: a parameter", part, PARAMETER)
        slot = Slot(*(_name(f"{where}: {key}", part.get(key)) for key in ("effect", "parameter", "at")))
        slots.append(slot)
        most = LARGEST_OF_ALL
        if slot.effect in catalogue():
            check_slot(slot, catalogue(), layout)
            most = LARGEST.get(find_parameter(slot, catalogue()).unit, LARGEST_OF_ALL)
        _number(f"{where}: {slot.label}", part.get("value"), -most, most)
        _number(f"{where}: std of {slot.label}", part.get("std"), 0.0)
        if not isinstance(part.get("identified"), bool):
            raise _CheckError(
                f"{where}: identified of {slot.label}: expected true or false, found {_shown(part.get('identified'))}"
            )
    _once(f"{where}: parameters", [slot.label for slot in slots])
    rows = _list(f"{where}: covariance", data.get("covariance"), MOST_NAMES)
    for k, row in enumerate(rows):
        for j, value in enumerate(_list(f"{where}: covariance", row, MOST_NAMES)):
            _number(f"{where}: covariance", value, 0.0 if j == k else -math.inf)


def _keys(where: str, data: Any, known: Sequence[str]) -> None:
    for key in _table(where, data):
        if key not in known:
            raise _CheckError(f"{where}: the key {_shown(key)} is not known{_near(key, known)}")


def _near(name: str, known: Sequence[str] | Mapping[str, Any]) -> str:
    near = get_close_matches(name, list(known), n=1)
    return f"; did you mean {near[0]!r}?" if near else f"; known: {', '.join(list(known)[:12])}"


def _table(where: str, data: Any) -> Mapping[str, Any]:
    if not isinstance(data, Mapping):
        raise _CheckError(f"{where}: expected an object, found {_shown(data)}")
    return data


def _list(where: str, data: Any, most: int) -> Sequence[Any]:
    if not isinstance(data, list):
        raise _CheckError(f"{where}: expected a list, found {'nothing' if data is None else _shown(data)}")
    if len(data) > most:
        raise _CheckError(f"{where}: expected at most {most}, found {len(data)}")
    return data


def _name(where: str, value: Any, longest: int = LONGEST) -> str:
    if not isinstance(value, str) or len(value) > longest or has_controls(value):
        raise _CheckError(f"{where}: expected printable text of at most {longest} characters, found {_shown(value)}")
    return value


def _number(where: str, value: Any, low: float = -LARGEST_OF_ALL, high: float = math.inf) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        bounds = f" from {low:g} to {high:g}" if math.isfinite(low) and math.isfinite(high) else ""
        raise _CheckError(f"{where}: expected a number{bounds}, found {_shown(value)}")


def _once(where: str, names: Sequence[str]) -> None:
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise _CheckError(f"{where}: {_shown(twice[0])} comes twice")


def _shown(value: Any) -> str:
    text = f"{value!r}" if not isinstance(value, list | dict) else f"a {type(value).__name__} of {len(value)}"
    return text if len(text) <= 60 else f"{text[:57]}…"
