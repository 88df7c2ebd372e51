"""Unidirectional approach: through an intermediate point, so that clearance and friction lie on the same side always.

A joint that comes to rest from an unknown side stands anywhere between the two. Coming from a chosen side it stands at
one of them, which the model knows. The side is the one on which gravity presses anyway, where it does: what the load
holds need not be pushed. Or it is the one that is asked for. Source: the thesis' own proposal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from offline_ik.cell.checks import check_directions
from offline_ik.errors import TargetError

if TYPE_CHECKING:
    from offline_ik.inverse.answer import Answer
    from offline_ik.inverse.detector import Detector

__all__ = ["Approach", "approach_through"]

Array = npt.NDArray[np.float64]

BACK = 0.03  # rad: further than any clearance and any wind-up


@dataclass(frozen=True)
class Approach:
    """A way to a position with its last part in known directions.

    Attributes
    ----------
    answer
        Solved for these directions.
    through
        ``(n,)``: the intermediate posture, rad.
    direction
        ``(n,)``: of the last part.
    asked
        ``(n,)``: what was asked of it, 0 where it was left to gravity.
    gain
        Root mean square of where the detector would stand with the directions left to chance, less what is left, m.
    """

    answer: Answer
    through: Array
    direction: Array
    spread: float
    left: float
    asked: Array

    @property
    def gain(self) -> float:
        """By how much the standard deviation falls, m."""
        return self.spread - self.left

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "through_q_rad": self.through.tolist(),
            "direction": self.direction.tolist(),
            "direction_asked": self.asked.tolist(),
            "std_without_m": self.spread,
            "std_with_m": self.left,
            "gain_m": self.gain,
        }


def approach_through(
    detector: Detector,
    answer: Answer,
    *,
    near: Sequence[float] | Array | None = None,
    direction: Sequence[float] | Array | None = None,
    back: float = BACK,
) -> Approach:
    """The approach to the first solution of an answer.

    Parameters
    ----------
    near
        The present posture; without it the solution's own.
    direction
        ``(n,)``: from which side each joint is to come, ±1; where 0 and without, the side on which gravity presses.
    back
        How far before the end the intermediate point lies, rad; less where a joint's limit is nearer.

    Raises
    ------
    ValueError
        The answer has no solution.
    TargetError
        A direction is none, or a limit is in the way of one that was asked for.
    """
    if not answer.solutions:
        raise ValueError("expected an answer with a solution, found none: there is nothing to approach")
    first = answer.solutions[0]
    sides = np.zeros(detector.arm.n) if direction is None else check_directions(detector.arm.n, direction)
    pressing = detector.solver.forward.one(np.concatenate([first.q, detector.still.vector]))[3]
    side = np.where(pressing < 0, -1.0, 1.0)
    # From below its lower limit no joint can come.
    side = np.where(first.q - side * back < detector.lower, -1.0, side)
    side = np.where(first.q - side * back > detector.upper, 1.0, side)
    side = np.where(sides == 0, side, sides)
    _refuse_beyond(detector, first.q, sides, back)
    asked = answer.asked
    found = detector.locate(
        _number(asked["gamma_rad"]), _number(asked["delta_rad"]), _number(asked["r_m"]), first.roll,
        near=first.q, direction=side,
    )  # fmt: skip
    end = found.solutions[0] if found.solutions else first
    towards = detector.towards(detector.to_base(found.target), first.roll)
    unknown = detector.propagation.at(end.q, detector.still, towards)
    through = np.clip(end.q - side * back, detector.lower, detector.upper)
    kept = found if found.solutions else answer._replace(solutions=(first,))
    return Approach(kept, through, side, unknown.std_m, end.uncertainty.std_m, sides)


def _refuse_beyond(detector: Detector, q: Array, asked: Array, back: float) -> None:
    """Refuse a direction of approach for which a limit leaves no room."""
    room = np.where(asked > 0, q - detector.lower, detector.upper - q)
    for i in np.flatnonzero((asked != 0) & (room < back)).tolist():
        raise TargetError(
            f"direction: {detector.robot.joints[i].name} cannot come from {'below' if asked[i] > 0 else 'above'}: it "
            f"is {room[i]:.3g} rad from its limit, and the approach needs {back:g}"
        )


def _number(value: float | None) -> float:
    return math.nan if value is None else value
