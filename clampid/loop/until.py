"""Conditions that end a run early, such as ``--until "std(backlash@joint2) < 5 arcsec"``."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from clampid.display import number
from clampid.models.model import Model
from experiments.plans.errors import PlanError

__all__ = ["Until", "parse_until"]

_UNITS: dict[str, tuple[float, str]] = {
    "rad": (1.0, "rad"), "mrad": (1e-3, "rad"), "urad": (1e-6, "rad"), "µrad": (1e-6, "rad"),
    "deg": (math.pi / 180, "rad"), "arcmin": (math.pi / 10800, "rad"), "arcsec": (math.pi / 648000, "rad"),
    "m": (1.0, "m"), "mm": (1e-3, "m"), "um": (1e-6, "m"), "µm": (1e-6, "m"), "Nm": (1.0, "Nm"), "kg": (1.0, "kg"),
    "rad/Nm": (1.0, "rad/Nm"), "mrad/Nm": (1e-3, "rad/Nm"), "urad/Nm": (1e-6, "rad/Nm"), "µrad/Nm": (1e-6, "rad/Nm"),
}  # fmt: skip
_CONDITION = re.compile(r"std\(\s*([a-z_]+)(?:\.(\w+))?@(\w+)\s*\)\s*<\s*([0-9.eE+-]+)\s*(\S+)")


@dataclass(frozen=True)
class Until:
    """One condition: the standard error of a parameter is below a number, SI.

    Attributes
    ----------
    text
        The condition as typed.
    effect, parameter, place
        Which parameter; with ``parameter`` None all of the effect at this place.
    below, unit
        The bound, SI, and the unit in which it was typed.
    factor
        Of that unit: SI value of one unit.
    """

    text: str
    effect: str
    parameter: str | None
    place: str
    below: float
    unit: str
    factor: float = 1.0

    def shown(self, value: float) -> str:
        """A standard error, SI, in the unit of the condition."""
        return f"{number(value / self.factor)} {self.unit}" if math.isfinite(value) else "not known"

    def reached(self, model: Model) -> tuple[float, bool]:
        """The largest standard error of these parameters (SI), and whether it is below the bound.

        Of several stages the one with the smallest counts. Infinite while no stage identifies the parameters.
        """
        best = math.inf
        for stage in model.stages.values():
            mine = [
                k
                for k, slot in enumerate(stage.slots)
                if slot.effect == self.effect and slot.place == self.place and self.parameter in (None, slot.parameter)
            ]
            if mine and all(stage.identified[k] for k in mine):
                std = np.sqrt(np.diag(stage.covariance))
                best = min(best, float(max(std[k] for k in mine)))
        return best, best < self.below


def parse_until(text: str) -> tuple[Until, ...]:
    """Read conditions, joined by ``and``.

    Raises
    ------
    PlanError
        A condition cannot be read, or its effect, parameter or unit is not known.
    """
    return tuple(_condition(part.strip()) for part in re.split(r"\s+and\s+", text.strip()))


def _condition(text: str) -> Until:
    from clampid.catalogue import catalogue

    found = _CONDITION.fullmatch(text)
    if found is None:
        raise PlanError(f"--until: expected std(EFFECT@PLACE) < NUMBER UNIT, found {text[:80]!r}")
    name, parameter, place, number, unit = found.groups()
    try:
        below = float(number)
    except ValueError:
        below = -1.0
    if not 0.0 < below < math.inf:
        raise PlanError(f"--until: expected a number above 0, found {number!r}")
    effects = catalogue()
    if name not in effects:
        raise PlanError(f"--until: expected an effect of `clampid effects`, found {name!r}")
    if unit not in _UNITS:
        raise PlanError(f"--until: expected a unit of {', '.join(_UNITS)}, found {unit!r}")
    factor, si = _UNITS[unit]
    known = {p.name: p.unit for p in effects[name].parameters}
    if parameter is not None and parameter not in known:
        raise PlanError(f"--until: {name}: expected one of {', '.join(known)}, found {parameter!r}")
    meant = [known[parameter]] if parameter is not None else list(known.values())
    if any(one != si for one in meant):
        raise PlanError(f"--until: {name}: expected a unit of {', '.join(dict.fromkeys(meant))}, found {unit}")
    return Until(text, name, parameter, place, below * factor, unit, factor)
