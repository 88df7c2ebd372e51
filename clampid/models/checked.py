"""What a model file may say: every key known, every number a finite number of a size that can be meant, nothing twice.

A parameter that does not exist would be dropped in silence by what computes with the model; here it is an error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Any

import numpy as np

from clampid.catalogue import catalogue
from clampid.effect import STAGES, Effect
from clampid.slots import Layout, Slot, find_parameter
from kinematics.section import Section, shown

__all__ = ["check_model", "check_slot"]

MOST_JOINTS = 50
MOST_NAMES = 10_000
LONGEST_NAME = 200  # characters of a name
LONGEST_PATH = 4096
LARGEST_TOOL = 1e4  # kg
RIGID = 1e-6  # of a rotation written with all its digits
FARTHEST_INSTRUMENT = 1e5  # m: of an instrument from its robot, with room for coordinates of a hall or a site
LARGEST_VALUE = {
    "rad": 100.0,
    "m": 100.0,
    "kg": 1e5,
    "kg m": 1e6,
    "kg m^2": 1e7,
    "s": 1e9,
    "rad/s": 1e6,
    "Nm": 1e8,
    "N": 1e8,
}
"""Of a value, by its unit: beyond, it is in another unit or spoiled."""
LARGEST_OF_ALL = 1e15


def check_model(data: Mapping[str, Any]) -> None:
    """Refuse what a model file cannot mean.

    Parameters
    ----------
    data
        Of the JSON, of the newest version.

    Raises
    ------
    ValueError
        A key is not known or missing, a value is of another kind or size, a parameter does not exist or comes twice.
    """
    at = Section(data, "")
    at.has("format")
    at.text("robot")
    for key in ("robot_file", "user_effects"):
        at.text(key, default=None, longest=LONGEST_PATH)
    layout = _layout(at.section("layout"))
    at.integer("seed", 0)
    at.number("holdout", 0.0, 1.0)
    at.flag("joint")
    sessions = _tables(at, "sessions")
    for session in sessions:
        _session(session)
    if sessions and len(sessions) != len(layout.sessions):
        raise at.fault("layout.sessions", f"{len(sessions)} names", str(len(layout.sessions)))
    stages = at.section("stages")
    for name in stages.keys():  # noqa: SIM118 - not a dict
        if name not in STAGES:
            raise stages.fault(name, f"one of {', '.join(STAGES)}", "no stage of this name")
        _stage(stages.section(name), layout)
    for part in _tables(at, "ledger"):
        part.text("stage", STAGES)
        for key in ("effects", "added"):
            part.texts(key, longest=LONGEST_NAME)
        for key in ("rms", "heldout_rms", "noise_floor"):
            part.number(key, 0.0)
        part.section("evidence")
        part.done()
    at.done()


def check_slot(slot: Slot, effects: Mapping[str, Effect], layout: Layout) -> None:
    """Refuse a parameter that its effect does not have, or not there.

    Raises
    ------
    ValueError
        It does not exist; the message says what does.
    """
    effect = effects[slot.effect]
    if slot.parameter not in effect.by_name:
        near = next(iter(get_close_matches(slot.parameter, list(effect.by_name), n=1)), None)
        hint = f"did you mean {near!r}?" if near else f"known: {', '.join(list(effect.by_name)[:12])}"
        raise ValueError(f"effect {slot.effect} has no parameter {slot.parameter!r}; {hint}")
    places = layout.places(effect, effect.by_name[slot.parameter])
    if slot.place not in places:
        some = f"{', '.join(places[:8])}{' …' if len(places) > 8 else ''}" or "nowhere in this model"
        raise ValueError(f"{slot.effect}.{slot.parameter} cannot sit at {slot.place!r}; it can at: {some}")


def _tables(at: Section, key: str) -> list[Section]:
    found = at.sections(key, optional=at.value(key, "a list") == [])
    if len(found) > MOST_NAMES:
        raise at.fault(key, f"at most {MOST_NAMES}", str(len(found)))
    return found


def _layout(at: Section) -> Layout:
    joints = at.integer("joints", 1, MOST_JOINTS)
    targets, anchors, sessions = (
        at.texts(k, longest=LONGEST_NAME, once=True) for k in ("targets", "anchors", "sessions")
    )
    wrist = at.value("wrist", "a list of joints")
    if not isinstance(wrist, list) or any(type(joint) is not int or not 0 <= joint < joints for joint in wrist):
        raise at.fault("wrist", f"joints from 0 to {joints - 1}", shown(wrist))
    at.done()
    return Layout(joints, targets, sessions, tuple(wrist), anchors)


def _session(at: Section) -> None:
    at.text("name")
    at.text("fingerprint")
    at.number("tool_mass_kg", 0.0, LARGEST_TOOL, "kg")
    at.texts("targets", longest=LONGEST_NAME)
    for key, count, most in (("tool_com_m", 3, 100.0), ("gravity_m_s2", 3, 100.0), ("temperature_C", 2, 1e4)):
        at.vector(key, count, -most, most, default=None)
    _rigid(at, "base_reference")
    anchors = at.section("anchors_m")
    for name in anchors.keys():  # noqa: SIM118 - not a dict
        anchors.vector(name)
    at.done()


SAID_TWICE = 1e-6  # of what a file says twice
READ_ELSEWHERE = ("outliers", "base_parameters", "observability", "bootstrap", "told", "ranges")


def _stage(at: Section, layout: Layout) -> None:
    at.texts("effects", longest=LONGEST_NAME)
    slots: set[Slot] = set()
    for part in _tables(at, "parameters"):
        slot = Slot(*(part.text(key) for key in ("effect", "parameter", "at")))
        if slot in slots:
            raise part.fault("", "a parameter of its own", f"{slot.label} twice")
        slots.add(slot)
        most = LARGEST_OF_ALL
        if slot.effect in catalogue():
            try:
                check_slot(slot, catalogue(), layout)
            except ValueError as error:
                raise ValueError(f"key {part.place}: {error}") from None
            most = LARGEST_VALUE.get(find_parameter(slot, catalogue()).unit, LARGEST_OF_ALL)
        part.number("value", -most, most)
        part.number("std", 0.0)
        part.flag("identified")
        part.done()
    for k, row in enumerate(_matrix(at, "covariance", len(slots), len(slots))):
        if row[k] < 0:
            raise at.fault(f"covariance[{k + 1}]", "variances that are not negative", shown(row[k]))
    _covariance(at, len(slots))
    _numbers(at, "held_out")
    for key, count, width in (("lean_rad", layout.joints, 3), ("by_springs", len(slots), layout.joints)):
        if at.content.get(key) is not None:
            _matrix(at, key, count, width)
        else:
            at.has(key)
    at.texts("not_identifiable")
    for key in ("held_out", "lean_rad", "by_springs", *READ_ELSEWHERE):
        if key not in at.content:
            raise at.fault(key, "this key, if only with null", "no such key")
    for key in READ_ELSEWHERE:
        at.has(key)  # what reads them says what is wrong
        _no_flags(at, key, at.content.get(key))
    at.done()


def _covariance(at: Section, count: int) -> None:
    """Covariances are the same either way, and no larger than their variances allow."""
    found = np.array(at.content["covariance"], dtype=float).reshape(count, count)
    std = np.sqrt(np.diag(found))
    allowed = np.outer(std, std)
    wrong = np.abs(found) > allowed * (1 + SAID_TWICE)
    wrong |= np.abs(found - found.T) > allowed * SAID_TWICE
    if wrong.any():
        k, j = map(int, np.argwhere(wrong)[0])
        raise at.fault(
            f"covariance[{k + 1}]",
            "a covariance: the same either way, and at most the product of both standard errors",
            f"{found[k, j]:.6g} and {found[j, k]:.6g} of parameters {k + 1} and {j + 1}, {allowed[k, j]:.6g} at most",
        )


def _rigid(at: Section, key: str) -> None:
    """A homogeneous transformation that turns and moves, and nothing else; or null."""
    if at.value(key, "numbers", None) is None:
        return
    rows = np.array(_matrix(at, key, 4, 4), dtype=float)
    turn, far = rows[:3, :3], np.abs(rows[:3, 3]).max()
    with np.errstate(all="ignore"):
        stiff = np.abs(turn @ turn.T - np.eye(3)).max() < RIGID and np.linalg.det(turn) > 0
    if not (stiff and far <= FARTHEST_INSTRUMENT and np.array_equal(rows[3], [0, 0, 0, 1])):
        raise at.fault(key, f"a rotation and a shift of at most {FARTHEST_INSTRUMENT:g} m", shown(rows.tolist()))


def _matrix(at: Section, key: str, count: int, width: int) -> list[list[float]]:
    """``count`` lists of ``width`` finite numbers."""
    _numbers(at, key)
    expected = f"{count} lists of {width} finite numbers"
    rows = at.value(key, expected)
    if not isinstance(rows, list) or len(rows) != count:
        raise at.fault(key, expected, shown(rows))
    for k, row in enumerate(rows):
        whole = isinstance(row, list) and len(row) == width
        if not whole or not {list, dict}.isdisjoint(map(type, row)):
            raise at.fault(f"{key}[{k + 1}]", f"{width} finite numbers", shown(row))
    return rows


def _numbers(at: Section, key: str) -> None:
    """Lists of lists of finite numbers, or null."""
    value = at.value(key, "numbers", None)
    for one in _leaves(value) if value is not None else ():
        number = type(one) is float or (isinstance(one, int | float) and not isinstance(one, bool))
        if not number or not abs(one) < math.inf:
            raise at.fault(key, "lists of finite numbers", shown(one))


def _no_flags(at: Section, key: str, value: Any) -> None:
    """Refuse true and false where numbers or names stand; whether a base parameter is identified is neither."""
    if key == "base_parameters" and isinstance(value, list):
        value = [{k: v for k, v in one.items() if k != "identified"} if isinstance(one, dict) else one for one in value]
    flag = next((one for one in _leaves(value) if isinstance(one, bool)), None)
    if flag is not None:
        raise at.fault(key, "numbers and names", shown(flag))


def _leaves(value: Any) -> Iterator[Any]:
    """What stands in lists and tables within each other, as JSON has them."""
    if isinstance(value, dict):
        value = list(value.values())
    if not isinstance(value, list):
        yield value
    elif {list, dict}.isdisjoint(map(type, value)):
        yield from value
    else:
        for one in value:
            yield from _leaves(one)
