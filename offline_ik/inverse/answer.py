"""The answer to one requested detector position: the postures that reach it, or the reasons why none does.

Named tuples: a server makes them for every request, and frozen dataclasses take six times as long to be made.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from clampid.models.ranges import Beyond
from offline_ik.inverse.uncertainty import Uncertainty

__all__ = ["Answer", "Solution"]

Array = npt.NDArray[np.float64]


class Solution(NamedTuple):
    """One posture that puts the detector there.

    Attributes
    ----------
    q, motor
        ``(n,)``, rad: what to command at the joints, and at the motors.
    position_error, angle_error
        What the identified model has left to the asked pose, m and rad.
    roll
        The detector's roll about its normal, rad.
    singular
        Which of ``wrist``, ``elbow``, ``shoulder`` are near a singularity.
    status, turn
        KUKA's bits.
    distance
        The largest joint move from the posture at hand, rad.
    direction
        ``(n,)``: of each joint's approach, ±1, 0 unknown.
    extrapolating
        What is beyond that on which the model was identified.
    """

    q: Array
    motor: Array
    position_error: float
    angle_error: float
    uncertainty: Uncertainty
    roll: float
    singular: tuple[str, ...]
    status: int
    turn: int
    distance: float
    direction: Array
    extrapolating: tuple[Beyond, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "q_rad": self.q.tolist(),
            "motor_rad": self.motor.tolist(),
            "position_error_m": self.position_error,
            "angle_error_rad": self.angle_error,
            "std_m": self.uncertainty.std_m,
            "std_rad": self.uncertainty.std_rad,
            "uncertainty": self.uncertainty.to_json(),
            "roll_rad": self.roll,
            "singular": list(self.singular),
            "status": self.status,
            "turn": self.turn,
            "largest_move_rad": self.distance,
            "approach_direction": self.direction.tolist(),
            "extrapolating": [beyond.to_json() for beyond in self.extrapolating],
        }


class Answer(NamedTuple):
    """What became of one asked position.

    Attributes
    ----------
    target
        ``(4, 4)``: the asked pose in the convention's frame (at the first solution's roll, where that is free).
    reasons
        Why there is no solution, branch by branch put together.
    nearest
        The nearest detector position that can be reached, where the asked one cannot: gamma, delta, r, how far off.
    """

    asked: dict[str, float | None]
    target: Array
    solutions: tuple[Solution, ...]
    reasons: tuple[str, ...]
    nearest: dict[str, float] | None
    convention: dict[str, Any]
    cell: dict[str, Any]

    @property
    def reachable(self) -> bool:
        """Whether there is any solution."""
        return bool(self.solutions)

    def to_json(self) -> dict[str, Any]:
        """The JSON of ``clampid ik``."""
        return {
            "reachable": self.reachable,
            "solutions": [s.to_json() for s in self.solutions],
            "reasons": list(self.reasons),
            "nearest": self.nearest,
            "asked": self.asked,
            "detector_position_m": self.target[:3, 3].tolist(),
            "detector_rotation": self.target[:3, :3].tolist(),
            "convention": self.convention,
            "cell": self.cell,
        }
