"""Hides effects in a robot: by name, at a place, with a magnitude that is a factor on a clearly visible default."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np

from experiments.virtual_robot.kinds import KINDS, Kind
from experiments.virtual_robot.outside import OUTSIDE_KINDS
from experiments.virtual_robot.plant import Plant
from experiments.virtual_robot.sampling import Site
from experiments.virtual_robot.sizes import Sight

OUTSIDE: tuple[str, ...] = tuple(OUTSIDE_KINDS)
HIDEABLE: tuple[str, ...] = tuple(KINDS)
LARGEST_MAGNITUDE = 1000.0  # a default size is clearly visible; a thousand of them is no robot


@dataclass(frozen=True)
class Hidden:
    """An effect to hide.

    Attributes
    ----------
    effect
        One of `HIDEABLE`, the effects outside any library included.
    where
        Such as ``joint3``, ``link2``, ``tool``; drawn where not given.
    magnitude
        Factor on the default size.
    """

    effect: str
    where: str | None = None
    magnitude: float = 1.0

    def __post_init__(self) -> None:
        if self.effect not in KINDS:
            near = get_close_matches(self.effect, KINDS, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise ValueError(f"effect {self.effect!r} cannot be hidden{hint}; known are {', '.join(HIDEABLE)}")
        if not abs(self.magnitude) <= LARGEST_MAGNITUDE:  # NaN neither
            raise ValueError(
                f"{self.effect}: expected a finite magnitude of at most {LARGEST_MAGNITUDE:g} times the default size, "
                f"found {self.magnitude:g}"
            )
        kind = KINDS[self.effect]
        if self.where is not None and not kind.accepts(self.where):
            raise ValueError(f"{self.effect}@{self.where}: expected {kind.wanted}, found {self.where!r}")

    @classmethod
    def parse(cls, text: str) -> Hidden:
        """Read ``effect``, ``effect@joint3``, ``effect:2.0`` or ``effect@joint3:2.0``."""
        head, colon, factor = text.strip().partition(":")
        effect, at, where = head.partition("@")
        try:
            magnitude = float(factor) if colon else 1.0
        except ValueError:
            raise ValueError(f"{text!r}: expected a number after ':', found {factor!r}") from None
        if at and not where:
            raise ValueError(f"{text!r}: expected a place such as joint3 after '@', found none")
        return cls(effect, where or None, magnitude)


def hide(
    site: Site, baseline: Plant, hidden: Sequence[Hidden], seed: np.random.SeedSequence
) -> tuple[Plant, list[dict[str, Any]]]:
    """Return the plant with the effects in it, and what was hidden, as ``[{"effect", "where", "parameters"}]``.

    What an effect draws, and its size, depend on its name and place only, not on what else is hidden.
    """
    plant = baseline
    recorded: list[dict[str, Any]] = []
    if not hidden:
        return plant, recorded
    sight = Sight(site, baseline)
    for item in hidden:
        kind = KINDS[item.effect]
        rng = np.random.default_rng([*seed.generate_state(2), zlib.crc32(item.effect.encode())])
        where, index = _place(kind, item, baseline, rng)
        new, parameters = kind.put(plant, index, item.magnitude, sight, rng)
        seen = any(parameters.values()) and (site.weighed or sight.rms(new, plant) > 0)
        if item.magnitude and not seen:
            raise ValueError(f"{item.effect}@{where}: leaves no trace on {site.robot.name!r} as it is described")
        plant = new
        recorded.append({"effect": item.effect, "where": where, "parameters": parameters})
    return plant, recorded


def _place(kind: Kind, item: Hidden, plant: Plant, rng: np.random.Generator) -> tuple[str, int]:
    if not kind.numbered:
        return kind.noun, 0
    usual = kind.places(plant)
    drawn = int(rng.choice(usual)) if len(usual) else 0  # drawn in any case: the stream stays the same
    index = drawn if item.where is None else int(item.where.removeprefix(kind.noun)) - 1
    if not 0 <= index < plant.n:
        raise ValueError(f"{item.effect}@{item.where}: expected {kind.noun}1 to {kind.noun}{plant.n}")
    return f"{kind.noun}{index + 1}", index
