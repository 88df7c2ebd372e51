"""The number of rows of a torque log that are sampled closely enough to resolve the motion, so that they count."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clampid.stages.log_facts import WINDOW, facts_of, log_parts
from experiments.campaign import Campaign
from experiments.log_windows import windows

__all__ = ["Resolution", "resolution_of"]


@dataclass(frozen=True)
class Resolution:
    """Of ``moving`` rows in motion, ``step_s`` apart, ``rows`` show the motion."""

    rows: int
    moving: int
    step_s: float

    def to_json(self) -> dict[str, float]:
        """For programs."""
        return {"rows": self.rows, "moving": self.moving, "step_s": self.step_s}


def resolution_of(campaigns: Sequence[Campaign]) -> Resolution | None:
    """The resolution of the tables free_air and wrist of campaigns; None where all rows count, or there are none."""
    parts = log_parts(campaigns)
    if not parts:
        return None
    facts = facts_of(parts)
    if not facts.motions.way.trusted:
        return None
    rows = moving = 0
    for p, part in enumerate(parts):
        for w in windows(part.table, facts.motions.columns, WINDOW, facts.halo):
            motion = facts.motions.of(p, w).of(slice(w.start, w.stop))
            moves = np.any(np.abs(motion.speed) > facts.rest, axis=1)
            moving += int(np.count_nonzero(moves))
            rows += int(np.count_nonzero(moves & motion.resolved))
    return Resolution(rows, moving, facts.step)
