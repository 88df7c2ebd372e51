"""Slots: one number of one effect at one place. A model's parameter vector is a tuple of slots and their values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np
import numpy.typing as npt

from clampid.effect import AT_A_SLIDE, Effect, EffectError, Parameter, Stage
from clampid.roles import FRAMES
from kinematics.robot import RobotDescription

__all__ = [
    "Layout",
    "Prior",
    "Slot",
    "Term",
    "beyond_limit",
    "excludes_zero",
    "find_parameter",
    "fixed_slots",
    "has_value",
    "no_such_effect",
    "number_of",
    "on_bound",
    "parse_term",
    "slots_of",
    "slots_of_terms",
    "unit_of",
]


@dataclass(frozen=True, order=True)
class Slot:
    """One number: a parameter of an effect at a place, such as ``backlash.gap@joint3``."""

    effect: str
    parameter: str
    place: str

    @property
    def label(self) -> str:
        """``effect.parameter@place``."""
        return f"{self.effect}.{self.parameter}@{self.place}"

    @property
    def number(self) -> int:
        """Number of its joint, motor or link, from 0; raises ``ValueError`` if its place has none."""
        return number_of(self.place)


def number_of(place: str) -> int:
    """Number of the joint, motor or link at a place such as ``joint3``, from 0; ``ValueError`` if it has none."""
    return int(place.lstrip("abcdefghijklmnopqrstuvwxyz")) - 1


@dataclass(frozen=True)
class Prior:
    """What is known of some slots before rows are seen: values ``(k,)`` and covariance ``(k, k)``, SI.

    Attributes
    ----------
    follows, slope
        Slots ``(f,)`` that the values follow, and how, ``(k, f)``: the covariance is that of what is off
        mean + slope times those slots' values. None: they follow nothing.
    """

    slots: tuple[Slot, ...]
    mean: npt.NDArray[np.float64]
    covariance: npt.NDArray[np.float64]
    follows: tuple[Slot, ...] = ()
    slope: npt.NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Term:
    """An effect at one place, or (``place=None``) wherever it can sit."""

    effect: str
    place: str | None = None

    @property
    def label(self) -> str:
        """``effect@place`` or ``effect``."""
        return self.effect if self.place is None else f"{self.effect}@{self.place}"


@dataclass(frozen=True)
class Layout:
    """How many of everything there are: joints, targets, anchors and sessions; which joints are coupled."""

    joints: int
    targets: tuple[str, ...] = ()
    sessions: tuple[str, ...] = ("session1",)
    wrist: tuple[int, ...] = ()
    anchors: tuple[str, ...] = ()

    def places(self, effect: Effect, parameter: Parameter) -> tuple[str, ...]:
        """Names of the places of a parameter, in the order of its column of values."""
        match parameter.per:
            case "joint":
                return tuple(f"joint{i + 1}" for i in range(self.joints))
            case "link":
                return tuple(f"link{i + 1}" for i in range(self.joints))
            case "target":
                return self.targets
            case "anchor":
                return self.anchors
            case "session":
                return self.sessions
            case _:
                return (effect.at,)

    def allowed(self, effect: Effect, stage: Stage | None = None) -> tuple[str, ...]:
        """Where an effect can sit (in a stage): joints or links, or its one place."""
        if effect.per == "robot":
            return (effect.at,)
        chosen = self.wrist if stage in effect.coupled_only else tuple(range(self.joints))
        return tuple(f"{effect.per}{i + 1}" for i in chosen)


def slots_of(
    effect: Effect, layout: Layout, stage: Stage | None = None, places: Sequence[str] | None = None
) -> tuple[Slot, ...]:
    """All slots of an effect, or those at the given joints or links (with what belongs to no place of its own)."""
    wanted = layout.allowed(effect, stage) if places is None else tuple(places)
    found: list[Slot] = []
    for parameter in effect.parameters:
        for place in layout.places(effect, parameter):
            if parameter.per in ("joint", "link") and place not in wanted:
                continue
            found.append(Slot(effect.name, parameter.name, place))
    return tuple(found)


def no_such_effect(name: str, catalogue: Mapping[str, Effect]) -> str:
    """For people: that no effect has this name, and which ones may be meant."""
    near = get_close_matches(name.lower().replace("-", "_"), catalogue, 3)
    hint = f"did you mean {' or '.join(near)}?" if near else "`clampid effects` lists them all"
    return f"no effect is called {name!r}; {hint}"


def parse_term(text: str, catalogue: Mapping[str, Effect], layout: Layout) -> Term:
    """Read ``effect`` or ``effect@joint3``.

    Raises
    ------
    EffectError
        The effect is not known, or cannot sit there; the message says what exists.
    """
    name, _, place = text.strip().partition("@")
    if name not in catalogue:
        raise EffectError(no_such_effect(name, catalogue))
    if not place:
        return Term(name)
    allowed = layout.allowed(catalogue[name])
    if catalogue[name].per == "link" and place.startswith("joint"):
        place = "link" + place.removeprefix("joint")
    if place not in allowed:
        raise EffectError(f"effect {name} cannot sit at {place!r}; it can at: {', '.join(allowed)}")
    return Term(name, place)


def find_parameter(slot: Slot, catalogue: Mapping[str, Effect]) -> Parameter:
    """The parameter that a slot is a value of."""
    found = catalogue[slot.effect].by_name.get(slot.parameter)
    if found is None:
        raise EffectError(f"effect {slot.effect} has no parameter {slot.parameter!r}")
    return found


def unit_of(slot: Slot, catalogue: Mapping[str, Effect], robot: RobotDescription) -> str:
    """The unit of a slot's value on this robot: where a joint slides, angles are lengths and torques forces."""
    unit = find_parameter(slot, catalogue).unit
    if not slot.place.startswith("joint") or robot.joints[slot.number].kind != "prismatic":
        return unit
    return AT_A_SLIDE.get(unit, unit)


def fixed_slots(slots: Sequence[Slot], catalogue: Mapping[str, Effect]) -> list[bool]:
    """Which slots a fit keeps where they start: constants, which have no standard error."""
    seen: set[tuple[str, str]] = set()
    out = []
    for slot in slots:
        fixed = find_parameter(slot, catalogue).fixed
        out.append(fixed == "everywhere" or (fixed == "first" and (slot.effect, slot.parameter) not in seen))
        seen.add((slot.effect, slot.parameter))
    return out


def on_bound(slot: Slot, value: float, catalogue: Mapping[str, Effect]) -> bool:
    """Whether an amplitude rests on a physical limit: fits keep it there, exactly, and its interval has one side.

    Zero, the usual limit, is the same for every gear.
    """
    parameter = find_parameter(slot, catalogue)
    return not parameter.shape and parameter.fixed == "nowhere" and value in parameter.bounds


CERTAIN = 3.0
"""Standard errors from zero: an amplitude that far off is no chance result."""


def excludes_zero(parameter: Parameter, value: float, std: float) -> bool:
    """Whether the data exclude that an amplitude is zero, even if they do not determine it to within its usual size.

    Frames are left out: one that no row separates from another can be many standard errors off. So are springs, which
    are never zero.
    """
    if parameter.shape or parameter.share or parameter.fixed != "nowhere" or parameter.role in (*FRAMES, "compliance"):
        return False
    return abs(value) > CERTAIN * std > 0.0


def has_value(slot: Slot, effects: Mapping[str, Effect], value: float, std: float, identified: bool) -> bool:
    """Whether a fitted value is shown to people: the data identify it, or at least exclude that it is zero."""
    return bool(identified) or excludes_zero(find_parameter(slot, effects), value, std)


def beyond_limit(parameter: Parameter, value: float) -> bool:
    """Whether a fitted value lies above its physical limit, as stated for this robot."""
    return value > parameter.bounds[1]


def slots_of_terms(
    terms: Iterable[Term], catalogue: Mapping[str, Effect], layout: Layout, stage: Stage | None = None
) -> tuple[Slot, ...]:
    """The slots of several terms, each once, in order."""
    found: dict[Slot, None] = {}
    for term in terms:
        places = None if term.place is None or catalogue[term.effect].per == "robot" else (term.place,)
        for slot in slots_of(catalogue[term.effect], layout, stage, places):
            found[slot] = None
    return tuple(found)
