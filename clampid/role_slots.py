"""The parameters of a role, by place: the core asks for these and not for an effect's name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache

from clampid.catalogue import catalogue
from clampid.effect import Effect, EffectError, Parameter, Per
from clampid.roles import Role
from clampid.slots import Slot

__all__ = ["any_of_role", "axis_of", "effect_with", "has_role", "numbers_of_role", "role_of", "slot_of", "weight_slots"]

Effects = Mapping[str, Effect] | None  # None: those of the catalogue


def _parameter(slot: Slot, effects: Effects) -> Parameter | None:
    effect = (catalogue() if effects is None else effects).get(slot.effect)
    return None if effect is None else effect.by_name.get(slot.parameter)


def role_of(slot: Slot, effects: Effects = None) -> Role:
    """The role of a slot's parameter; empty where it has none, or its effect is not known."""
    parameter = _parameter(slot, effects)
    return "" if parameter is None else parameter.role


def axis_of(slot: Slot, effects: Effects = None) -> str:
    """The axis of a slot's parameter, such as ``x``, ``rz`` or ``xy``; empty where its role has none."""
    parameter = _parameter(slot, effects)
    return "" if parameter is None else parameter.axis


def has_role(slot: Slot, *roles: Role, per: Per | None = None, effects: Effects = None) -> bool:
    """Whether a slot is a number of one of these roles, and one for each of such places."""
    parameter = _parameter(slot, effects)
    return parameter is not None and parameter.role in roles and per in (None, parameter.per)


def any_of_role(slots: Iterable[Slot], *roles: Role, per: Per | None = None, effects: Effects = None) -> bool:
    """Whether any slot is a number of one of these roles."""
    return any(has_role(slot, *roles, per=per, effects=effects) for slot in slots)


def numbers_of_role(slots: Iterable[Slot], *roles: Role, per: Per | None = None, effects: Effects = None) -> list[int]:
    """Which of the slots, counted from 0, are numbers of one of these roles."""
    return [k for k, slot in enumerate(slots) if has_role(slot, *roles, per=per, effects=effects)]


def slot_of(role: Role, place: str, axis: str = "") -> Slot:
    """The slot in which the catalogue itself has a role at a place.

    Of several effects it is the one that leads its family and whose places are of that kind.

    Raises
    ------
    EffectError
        The catalogue has no such parameter.
    """
    kind = place.rstrip("0123456789")
    found = _leading().get((role, axis, kind)) or _leading().get((role, axis, ""))
    if found is None:
        raise EffectError(f"no effect of the catalogue has a parameter {role} {axis} at {place}")
    return Slot(*found, place)


def weight_slots(place: str) -> tuple[Slot, ...]:
    """The slots of mass and first moments, (m, m c_x, m c_y, m c_z), of a link or of the tool."""
    return (slot_of("mass", place), *(slot_of("first_moment", place, axis) for axis in "xyz"))


def effect_with(role: Role, effects: Mapping[str, Effect]) -> Effect:
    """The first effect that has parameters of a role.

    Raises
    ------
    EffectError
        None has.
    """
    found = next((e for e in effects.values() if role in e.roles), None)
    if found is None:
        raise EffectError(f"no effect has a parameter of the role {role}")
    return found


@cache
def _leading() -> Mapping[tuple[Role, str, str], tuple[str, str]]:
    """Role, axis and kind of place (empty: any) → effect and parameter; the first of each."""
    out: dict[tuple[Role, str, str], tuple[str, str]] = {}
    for effect in catalogue().values():
        for p in effect.parameters if effect.name == effect.family else ():
            if p.role:
                kind = p.per if p.per in ("joint", "link") else effect.at if p.per == "robot" else ""
                out.setdefault((p.role, p.axis, kind), (effect.name, p.name))
    return out
