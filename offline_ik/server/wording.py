"""The answer of the line protocol for a position: flat members for JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from offline_ik.inverse.answer import Answer, Solution

if TYPE_CHECKING:
    from offline_ik.inverse.detector import Detector

__all__ = ["members_of"]


def members_of(detector: Detector, answer: Answer) -> dict[str, Any]:
    """Of one position; ``nearest`` is left to who looks for it, and the cell is in the server's state."""
    base = detector.to_base(answer.target)
    return {
        "reachable": answer.reachable,
        "reasons": answer.reasons,
        "asked": answer.asked,
        "detector_position_m": answer.target[:3, 3].tolist(),
        "solutions": [_solution_json(s) | detector.framing(base, s.q) for s in answer.solutions],
    }


def _solution_json(solution: Solution) -> dict[str, Any]:
    return {
        "q_rad": solution.q.tolist(),
        "motor_rad": solution.motor.tolist(),
        "position_error_m": solution.position_error,
        "angle_error_rad": solution.angle_error,
        **solution.uncertainty.stated(),
        "roll_rad": solution.roll,
        "status": solution.status,
        "turn": solution.turn,
        "largest_move_rad": solution.distance,
        "approach_direction": solution.direction.tolist(),
        "singular": solution.singular,
        "extrapolating": [beyond.to_json() for beyond in solution.extrapolating],
    }
