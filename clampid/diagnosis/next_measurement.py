"""The next measurements of a verdict: to distinguish candidates, or to test effects that these rows cannot test."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy import stats

from clampid.display import number
from clampid.stages.rows import Array
from experiments.plans.model import Plan

__all__ = ["COOLING", "ENOUGH", "POWER", "SAME", "STATES", "TEMPERATURES", "Gain", "NextPlan", "NextPoses"]

SAME = 20.0
"""Candidates whose explained squares differ by less are not distinguished: odds of e^10, 22 000 to one."""
POWER = 0.9
ENOUGH = float((SAME**0.5 + stats.norm.isf(1 - POWER)) ** 2)
"""The noncentrality of which 90 % of measurements show more than :data:`SAME`."""
TEMPERATURES = {"cold": "as cold as at the start of these", "warm": "as warm as at the end of these"}
STATES = ("warm", "cold")
COOLING = 4 * 3600.0
"""s that a warm robot rests until it counts as cold; the time since switch-on goes on meanwhile."""


@dataclass(frozen=True)
class NextPoses:
    """Poses that distinguish candidates.

    Attributes
    ----------
    q, direction
        ``(m, n)`` rad and ±1: joint angles, and the side from which each joint comes.
    state
        ``warm`` or ``cold``: as the robot was at the end or at the start of the campaign's poses.
    before, after
        Evidence, in units of the noise's variance, between the closest two candidates among those that any poses
        distinguish.
    """

    q: Array
    direction: Array
    state: str
    before: float
    after: float

    @property
    def helps(self) -> bool:
        """Whether these are expected to distinguish the candidates in 9 of 10 campaigns."""
        return self.after >= ENOUGH

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


@dataclass(frozen=True)
class Gain:
    """The gain of a plan for one parameter that the rows test too weakly; SI.

    Attributes
    ----------
    name
        ``effect.parameter@place``.
    size
        Its usual size.
    before, after, best
        Detection limit (90 % probability): in these rows, with the plan, and with every measurement that was tried;
        infinite where there is none.
    aim
        The limit that the plan was to reach.
    retained
        Share of its columns that the model cannot absorb: now, and with the plan.
    """

    name: str
    unit: str
    size: float
    before: float
    after: float
    best: float
    aim: float
    retained: tuple[float, float]

    @property
    def possible(self) -> bool:
        """Whether the measurements tried can reach the aim at all."""
        return self.best <= self.aim

    def to_json(self) -> dict[str, Any]:
        """For programs; a limit that is infinite is None."""
        limits = {"limit_before": self.before, "limit_after": self.after, "limit_with_all_tried": self.best}
        return {
            "name": self.name,
            "unit": self.unit,
            "size": self.size,
            **{key: value if np.isfinite(value) else None for key, value in limits.items()},
            "retained_before": self.retained[0],
            "retained_after": self.retained[1],
            "aim": self.aim,
            "possible": self.possible,
            "helps": self.possible and self.after <= self.aim,
        }


@dataclass(frozen=True)
class NextPlan:
    """Measurements to take next, what they are for, and what is expected of them.

    Attributes
    ----------
    aim
        ``parting``: to distinguish candidates; ``testing``: to test parameters that these rows test too weakly.
    chosen
        Numbers in the pool that they were chosen from, of ``tried``.
    state
        ``warm`` or ``cold``: as the robot was at the end or at the start of the measurements so far.
    what, words
        The words for one and for several, and a description of these.
    plan
        For the runner; None where nothing helps.
    before, after
        Evidence, in units of the noise's variance, between the closest two candidates that can be distinguished.
    shared
        The share of its signal that this pair has in common: now, and after.
    never
        Pairs that no measurement tried distinguishes, by their labels, with the share in common and the evidence
        between them with all measurements tried.
    gains
        Parameter by parameter, for ``testing``.
    """

    aim: Literal["parting", "testing"]
    chosen: tuple[int, ...]
    tried: int
    state: str
    what: tuple[str, str]
    words: str
    plan: Plan | None
    before: float = 0.0
    after: float = 0.0
    shared: tuple[float, float] = (1.0, 1.0)
    never: tuple[tuple[str, str, float, float], ...] = ()
    gains: tuple[Gain, ...] = ()

    @property
    def helps(self) -> bool:
        """Whether it is expected to reach its aim in 9 of 10 campaigns, at least for some candidates or parameters."""
        if self.aim == "testing":
            return any(gain.possible and gain.after < gain.before for gain in self.gains)
        return self.after >= ENOUGH

    @property
    def count(self) -> str:
        """``12 poses``."""
        return f"{len(self.chosen)} {self.what[len(self.chosen) != 1]}"

    @property
    def nothing(self) -> str:
        """For people, of one without a plan: that nothing helps."""
        if self.aim == "parting":
            return self.sentence
        return f"no {self.what[1]} that this robot can take test them, not even all {self.tried} that were tried"

    @property
    def sentence(self) -> str:
        """For people: the gain for candidates that it distinguishes, and the pairs that it does not."""
        never = "; ".join(
            f"{a} from {b} ({_percent(share)} of their signal in common, a difference of "
            f"{number(float(np.sqrt(left)), 2)} σ)"
            for a, b, share, left in self.never
        )
        if not self.helps:
            what = f"no {self.what[1]} that this robot can take distinguish"
            return f"{what} {never or 'them'}, not even all {self.tried} that were tried"
        now, then, enough = (f"{number(float(np.sqrt(square)), 2)} σ" for square in (self.before, self.after, ENOUGH))
        gain = f"the closest two differ by {now}, these raise this to {then}; {enough} is enough in 9 of 10 campaigns"
        share = f"{_percent(self.shared[0])} of their signal is in common now, {_percent(self.shared[1])} then"
        said = f"{self.count} ({self.words}): {gain}; {share}"
        rest = f"; no {self.what[1]} distinguish {never}, not even all {self.tried} that were tried"
        return said + rest if never else said

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        data: dict[str, Any] = {
            "for": self.aim,
            "kind": None if self.plan is None else self.plan.kind,
            "count": len(self.chosen),
            "tried": self.tried,
            "what": self.words,
            "temperatures": self.state,
            "duration_s": None if self.plan is None else self.plan.duration,
            "helps": self.helps,
        }
        if self.aim == "testing":
            return data | {"detection_limits": [gain.to_json() for gain in self.gains]}
        return data | {
            "evidence_before": self.before,
            "evidence_after": self.after,
            "evidence_needed": SAME,
            "sigma_before": float(np.sqrt(self.before)),
            "sigma_after": float(np.sqrt(self.after)),
            "shared_before": self.shared[0],
            "shared_after": self.shared[1],
            "never": [
                {"candidates": [a, b], "shared": share, "sigma_with_all_tried": float(np.sqrt(left))}
                for a, b, share, left in self.never
            ],
        }


def _percent(share: float) -> str:
    """``97 %``, with enough digits that a share below 1 is not printed as 100 %."""
    for digits in (0, 1, 2):
        text = f"{100 * share:.{digits}f}"
        if float(text) < 100.0:
            return f"{text} %"
    return "all"
