"""The effects that a demo had hidden, and the values that the model found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import zip_longest
from typing import Any

from clampid.display import readable, with_error
from clampid.effect import Effect
from clampid.models.model import Model
from clampid.report.style import Section, as_table
from clampid.report.verdict import truth_section
from clampid.slots import Slot, find_parameter, unit_of
from kinematics.robot import RobotDescription

__all__ = ["truth_and_found"]

Json = Mapping[str, Any]
_UNITS = {
    "_rad_Nm": "rad/Nm", "_m_Nm": "m/Nm", "_m_N": "m/N", "_1_K": "1/K", "_kg_m": "kg m", "_Nm_rad": "Nm/rad",
    "_N_m": "N/m", "_rad_s": "rad/s", "_rad": "rad", "_Nm": "Nm", "_kg": "kg", "_m": "m",
}  # fmt: skip
"""How the virtual robot's names end, and the unit that this says; longer ends first."""
_CAPTION = (
    "The virtual robot has formulas and parameters of its own, so hidden and fitted numbers of an effect cannot "
    "always be compared one by one. Standard errors are those of the fit."
)


def truth_and_found(
    truth: Sequence[Json] | None, model: Model, effects: Mapping[str, Effect], robot: RobotDescription
) -> Section | None:
    """Section "What had been hidden": each effect and the model's; None where the truth is not known."""
    section = truth_section(truth)
    if section is None or not truth:
        return section
    rows = [row for hidden in truth for row in _rows(hidden, model, effects, robot)]
    return replace(section, blocks=(as_table(("Effect", "At", "Hidden#", "", "Found", "#"), rows, _CAPTION),))


def _rows(hidden: Json, model: Model, effects: Mapping[str, Effect], robot: RobotDescription) -> list[tuple[str, ...]]:
    """One effect's numbers, hidden and found side by side."""
    effect, place = str(hidden.get("effect", "")), str(hidden.get("where", ""))
    left = [_hidden(name, value) for name, value in (hidden.get("parameters") or {}).items()]
    right = _found(effect, place, model, effects, robot) or [("not in the model", "")]
    pairs = zip_longest(left, right, fillvalue=("", ""))
    return [
        (effect if k == 0 else "", place if k == 0 else "", one[1], one[0], *own) for k, (one, own) in enumerate(pairs)
    ]


def _hidden(name: str, value: Any) -> tuple[str, str]:
    """A hidden number's name without its unit, and the number with it."""
    end = next((end for end in _UNITS if name.endswith(end)), "")
    words = name.removesuffix(end).replace("_", " ")
    return words, readable(float(value), _UNITS.get(end, "")) if isinstance(value, (int, float)) else str(value)


def _found(
    effect: str, place: str, model: Model, effects: Mapping[str, Effect], robot: RobotDescription
) -> list[tuple[str, str]]:
    """The value in the first stage that has the effect there."""
    for stage in model.stages.values():
        own = [k for k, s in enumerate(stage.slots) if s.effect == effect and place in (s.place, "", "robot")]
        if own:
            return [_number(effects, robot, stage.slots[k], stage.theta[k], stage.std[k]) for k in own]
    return []


def _number(
    effects: Mapping[str, Effect], robot: RobotDescription, slot: Slot, value: float, std: float
) -> tuple[str, str]:
    parameter = find_parameter(slot, effects)
    meaning = f", {parameter.meaning}" if parameter.meaning else ""
    return f"{parameter.name}{meaning}", with_error(float(value), float(std), unit_of(slot, effects, robot))
