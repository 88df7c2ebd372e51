"""Poses that part candidates which the measured ones cannot tell apart, as a verdict lists them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from scipy import stats

from clampid.stages.rows import Array

__all__ = ["ENOUGH", "SAME", "TEMPERATURES", "NextPoses"]

SAME = 20.0  # explained beyond another candidate less than this: these data cannot tell the two apart
POWER = 0.9
ENOUGH = float((SAME**0.5 + stats.norm.isf(1 - POWER)) ** 2)
"""The noncentrality of which 90 % of measurements show more than :data:`SAME`."""
TEMPERATURES = {"cold": "as cold as at the start of these", "warm": "as warm as at the end of these"}


@dataclass(frozen=True)
class NextPoses:
    """Poses that part candidates.

    Attributes
    ----------
    q, direction
        ``(m, n)`` rad and ±1: joint angles, and the side from which each joint comes.
    state
        ``warm`` or ``cold``: as the robot was at the end or at the start of the campaign's poses.
    before, after
        Evidence, in units of the noise's variance, that the closest pair of candidates can be told apart by.
    """

    q: Array
    direction: Array
    state: str
    before: float
    after: float

    @property
    def helps(self) -> bool:
        """Whether these are expected to tell the candidates apart in 9 of 10 campaigns."""
        return self.after >= ENOUGH

    @property
    def sentence(self) -> str:
        """For people."""
        gain = f"evidence between the closest two: {self.before:.3g} now, {self.after:.3g} after, {SAME:g} tell them"
        if not self.helps:
            return f"no poses of this robot with these targets part them ({gain} apart; {len(self.q)} poses tried)"
        return f"{len(self.q)} poses, measured {TEMPERATURES[self.state]} ({gain} apart)"

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "poses": [
                {"q_rad": q.tolist(), "direction": d.astype(int).tolist()}
                for q, d in zip(self.q, self.direction, strict=True)
            ],
            "temperatures": self.state,
            "evidence_before": self.before,
            "evidence_after": self.after,
            "evidence_needed": SAME,
            "helps": self.helps,
        }
