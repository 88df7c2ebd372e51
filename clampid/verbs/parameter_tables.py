"""The parameters of a stage as tables: an effect each, its joints as columns, one unit a row.

A value is printed with the standard error of its last digits in brackets. What the data do not determine has no value;
it is named below the table.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from clampid.display import Scale, compact, places_text, scale_for, with_error

if TYPE_CHECKING:
    from clampid.effect import Effect
    from clampid.models.model import StageModel
    from clampid.verbs.output import Output
    from kinematics.description import RobotDescription

__all__ = ["show_parameters"]

MOST_NAMES_PER_UNIT = 12
"""Parameters of one effect at each place, beyond which nobody reads them one by one: a curve's harmonics."""
NOT_IDENTIFIABLE = "·"


@dataclass(frozen=True)
class _Cell:
    """One parameter at one place."""

    parameter: str
    place: str
    value: float
    std: float
    unit: str
    known: bool
    bound: bool


def _is_deviation(effect: Effect) -> bool:
    """Whether an effect's parameters are deviations from the description of links and frames."""
    from clampid.roles import FRAMES, WEIGHTS

    return any(p.role in FRAMES or (p.role in WEIGHTS and p.per == "link") for p in effect.parameters)


def show_parameters(
    name: str, stage: StageModel, effects: Mapping[str, Effect], robot: RobotDescription, out: Output
) -> None:
    """Print a table for each effect of a stage, and what is not identifiable in a line."""
    if not out.verbose:
        return
    for effect in dict.fromkeys(slot.effect for slot in stage.slots):
        cells = _cells(effect, stage, effects, robot)
        what = ", deviations from the description" if _is_deviation(effects[effect]) else ""
        side = _side(effect, effects, robot)
        for kind in dict.fromkeys(cell.place.rstrip("0123456789") for cell in cells):
            own = [cell for cell in cells if cell.place.rstrip("0123456789") == kind]
            _show(f"{name}: {effect.replace('_', ' ')}{what}{side}", own, out)
        on_bound = [f"{c.parameter} at {c.place}" for c in cells if c.known and c.bound]
        if on_bound:
            out.say(f"{effect}: on a physical limit, so that the interval has one side: {', '.join(on_bound)}")


def _cells(effect: str, stage: StageModel, effects: Mapping[str, Effect], robot: RobotDescription) -> list[_Cell]:
    from clampid.slots import fixed_slots, has_value, on_bound, unit_of

    theta, std = stage.theta.tolist(), stage.std.tolist()
    shown = [
        has_value(slot, effects, *one) for slot, *one in zip(stage.slots, theta, std, stage.identified, strict=True)
    ]
    errors = [0.0 if fixed else e for fixed, e in zip(fixed_slots(stage.slots, effects), std, strict=True)]
    return [
        _Cell(
            slot.parameter, slot.place, value, std, unit_of(slot, effects, robot), known, on_bound(slot, value, effects)
        )
        for slot, value, std, known in zip(stage.slots, theta, errors, shown, strict=True)
        if slot.effect == effect
    ]


def _side(effect: str, effects: Mapping[str, Effect], robot: RobotDescription) -> str:
    """The side of the gears, motor or joint, on which a number is stated that differs between them."""
    import numpy as np

    if not any(p.gearing for p in effects[effect].parameters):
        return ""
    return ", at the motor" if np.any(np.abs(np.diag(robot.transmission)) != 1.0) else ", at the joint"


def _show(title: str, cells: Sequence[_Cell], out: Output) -> None:
    places = list(dict.fromkeys(cell.place for cell in cells))
    names = list(dict.fromkeys(cell.parameter for cell in cells))
    if len(names) > MOST_NAMES_PER_UNIT * max(1, len({c.unit for c in cells})):
        _show_many(title, cells, places, out)
        return
    rows = []
    for parameter in names:
        own = {cell.place: cell for cell in cells if cell.parameter == parameter}
        known = [cell for cell in own.values() if cell.known]
        if not known:
            continue
        scale = scale_for(known[0].unit, [cell.value for cell in known])
        texts = [_text(own[p], scale) if p in own else "" for p in places]
        rows.append((f"{parameter} [{scale.unit}]" if scale.unit else parameter, *texts))
    if rows:
        out.table(title, ("", *places), rows)
    unknown: dict[str, list[str]] = {}
    for cell in cells:
        if not cell.known:
            unknown.setdefault(cell.parameter, []).append(cell.place)
    if unknown:
        listed = "; ".join(f"{parameter} at {places_text(at)}" for parameter, at in unknown.items())
        out.say(f"{title if not rows else title.partition(': ')[2].partition(',')[0]}: not identifiable: {listed}")


def _text(cell: _Cell, scale: Scale) -> str:
    return compact(cell.value, cell.std, scale) if cell.known else NOT_IDENTIFIABLE


def _show_many(title: str, cells: Sequence[_Cell], places: Sequence[str], out: Output) -> None:
    """Of a curve of each place, its number of parameters and their root sum of squares."""
    rows = []
    for place in places:
        own = [cell for cell in cells if cell.place == place and cell.known]
        if own:
            total = sum(cell.value**2 for cell in own) ** 0.5
            spread = sum(cell.std**2 for cell in own) ** 0.5
            rows.append((place, f"{len(own)}", with_error(total, spread, own[0].unit)))
    out.table(title, ("", "parameters", "root sum of squares"), rows)
