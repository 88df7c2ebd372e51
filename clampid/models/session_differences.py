"""How a quantity that each session has of its own differs from session to session.

What all sessions have in common may be hidden by something else (a scale of the instrument by the lengths of the arm, a
mass by the springs that carry it); what differs between them is not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

import numpy as np

from clampid.effect import Effect
from clampid.models.model import StageModel
from clampid.slots import find_parameter

__all__ = ["SessionDifference", "session_differences"]


@dataclass(frozen=True)
class SessionDifference:
    """One parameter in one session less that in another, SI."""

    parameter: str
    session: str
    less: str
    value: float
    std: float
    unit: str

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return asdict(self)


def session_differences(stage: StageModel, effects: Mapping[str, Effect]) -> tuple[SessionDifference, ...]:
    """Differences of what was asked for session by session; nothing of a single session."""
    own: dict[str, list[int]] = {}
    for k, slot in enumerate(stage.slots):
        effect = effects.get(slot.effect)
        if effect is not None and effect.search.opt_in and effect.of_session:
            own.setdefault(f"{slot.effect}.{slot.parameter}", []).append(k)
    found = []
    for name, places in own.items():
        unit = find_parameter(stage.slots[places[0]], effects).unit
        for a, b in combinations(places, 2):
            C = stage.covariance
            variance = float(C[a, a] + C[b, b] - 2.0 * C[a, b])
            value = float(stage.theta[b] - stage.theta[a])
            std = float(np.sqrt(max(variance, 0.0)))
            found.append(SessionDifference(name, stage.slots[b].place, stage.slots[a].place, value, std, unit))
    return tuple(found)
