"""Base parameters of inertia and gravity: their value, their name in physical terms, and their form in a model file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from clampid.effect import Effect
from clampid.role_slots import axis_of, role_of
from clampid.slots import Slot, find_parameter

__all__ = ["BaseParameter", "base_json", "base_name", "label_of", "read_base"]

_DIGITS = 4  # of a coefficient in a name: a tenth of a millimetre in a metre


@dataclass(frozen=True)
class BaseParameter:
    """A linear combination of inertial parameters that the data determine, although not its single terms.

    Attributes
    ----------
    name
        In words, such as ``m·c_x of link 3 + 0.425 m · m of link 4``.
    terms
        (parameter, coefficient), the first with coefficient 1. First moments and inertias are about the point on the
        link's own joint, in base axes at the zero pose; those of a tool are in the flange frame.
    value, std
        Value of the combination, described part included, and its standard error; SI.
    described
        Value of the combination by the robot's description; 0 if that has no masses.
    known
        Whether the fit determines it to within the reasonable size of its first term.
    """

    name: str
    unit: str
    terms: tuple[tuple[Slot, float], ...]
    value: float
    std: float
    described: float
    known: bool


def base_json(parameter: BaseParameter) -> dict[str, Any]:
    """A base parameter for a model file; SI."""
    return {
        "name": parameter.name,
        "unit": parameter.unit,
        "value": parameter.value,
        "std": parameter.std,
        "described": parameter.described,
        "identified": parameter.known,
        "terms": [
            {"effect": slot.effect, "parameter": slot.parameter, "at": slot.place, "coefficient": coefficient}
            for slot, coefficient in parameter.terms
        ],
    }


def read_base(data: Mapping[str, Any]) -> BaseParameter:
    """A base parameter as :func:`base_json` wrote it."""
    terms = tuple((Slot(t["effect"], t["parameter"], t["at"]), float(t["coefficient"])) for t in data["terms"])
    value, std, described = (float(data[key]) for key in ("value", "std", "described"))
    return BaseParameter(data["name"], data["unit"], terms, value, std, described, bool(data["identified"]))


def label_of(effect: str, parameter: str) -> str:
    """A parameter without its place, in words: ``m·c_x``, ``I_xy``, ``rotor inertia``, ``viscous_friction.B``."""
    slot = Slot(effect, parameter, "")
    match role_of(slot):
        case "mass":
            return "m"
        case "first_moment":
            return f"m·c_{axis_of(slot)}"
        case "inertia_tensor":
            return f"I_{axis_of(slot)}"
        case "rotor_inertia":
            return "rotor inertia"
        case _:
            return f"{effect}.{parameter}"


def base_name(terms: Sequence[tuple[Slot, float]], effects: Mapping[str, Effect]) -> str:
    """The name of a combination of parameters, such as ``m·c_x of link 3 + 0.425 m · m of link 4``.

    Parameters
    ----------
    terms
        (parameter, coefficient). Consecutive terms of one kind with equal coefficients become one term of the name.
    effects
        All known effects, by name.
    """
    own = find_parameter(terms[0][0], effects).unit
    parts: list[str] = []
    for (effect, parameter, size, minus), group in groupby(terms, key=_kind):
        places = [slot.place for slot, _ in group]
        what = f"{label_of(effect, parameter)} of {_places(places)}"
        unit = _ratio(own, find_parameter(Slot(effect, parameter, places[0]), effects).unit)
        factor = "" if size == "1" and not unit else f"{size}{f' {unit}' if unit else ''} · "
        sign = ("−" if minus else "") if not parts else (" − " if minus else " + ")
        parts.append(f"{sign}{factor}{what}")
    return "".join(parts)


def _kind(term: tuple[Slot, float]) -> tuple[str, str, str, bool]:
    """Key of the terms that are written together: effect, parameter, size and sign of the coefficient."""
    slot, coefficient = term
    exact = float(f"{abs(coefficient):.8g}")  # removes rounding errors, so that equal lengths get equal digits
    return slot.effect, slot.parameter, f"{exact:.{_DIGITS}g}", coefficient < 0


def _places(places: Sequence[str]) -> str:
    """``link 3``, ``links 3, 4 and 5``, ``the tool beyond what was declared``."""
    kind = places[0].rstrip("0123456789")
    numbers = [place[len(kind) :] for place in places]
    if not numbers[0]:
        return "the tool beyond what was declared" if kind == "tool" else kind
    if len(numbers) == 1:
        return f"{kind} {numbers[0]}"
    return f"{kind}s {', '.join(numbers[:-1])} and {numbers[-1]}"


def _ratio(unit: str, by: str) -> str:
    """The unit of a coefficient that turns ``by`` into ``unit``."""
    if unit == by:
        return ""
    powers = {"kg": 0, "kg m": 1, "kg m^2": 2}
    if unit in powers and by in powers:
        return {1: "m", 2: "m²", -1: "1/m", -2: "1/m²"}[powers[unit] - powers[by]]
    return f"{unit}/({by})" if by else unit
