"""Answers of the line protocol as text."""

from __future__ import annotations

import json
from functools import lru_cache
from typing import Any

from offline_ik.answer import Answer, Solution

__all__ = ["answered", "solutions_of"]

_TEMPLATE = (
    '{"q_rad": [#], "motor_rad": [#], "position_error_m": %.3g, "angle_error_rad": %.3g, '
    '"std_m": %.6g, "std_rad": %.6g, "radius95_m": %.6g, "tangential_std_m": %.6g, "radial_std_m": %.6g, '
    '"tangential_std_pixels": %.6g, "model_std_m": %.6g, "approach_std_m": %.6g, "roll_rad": %.12g, '
    '"status": %d, "turn": %d, "largest_move_rad": %.6g, "approach_direction": [#], "singular": %s}'
)


def answered(answer: Answer) -> dict[str, Any]:
    """What the server says of an answer; the cell is in its state."""
    return {
        "reachable": answer.reachable,
        "reasons": list(answer.reasons),
        "nearest": answer.nearest,
        "asked": answer.asked,
    }


def solutions_of(answer: Answer) -> str:
    """Position and solutions as JSON members, by one template: the encoder would take as long as the solver."""
    x, y, z = answer.target[:3, 3].tolist()
    solutions = ", ".join(map(_told, answer.solutions))
    return f', "detector_position_m": [{x:.9f}, {y:.9f}, {z:.9f}], "solutions": [{solutions}]'


@lru_cache
def _template(n: int) -> str:
    return _TEMPLATE.replace("#", ", ".join(["%.12g"] * n))


def _told(solution: Solution) -> str:
    u = solution.uncertainty
    return _template(len(solution.q)) % (
        *solution.q.tolist(), *solution.motor.tolist(), solution.position_error, solution.angle_error, u.std_m,
        u.std_rad, u.radius95_m,
        u.tangential_m, u.radial_m, u.tangential_m / u.pixel, u.model_m, u.approach_m, solution.roll, solution.status,
        solution.turn, solution.distance, *solution.direction.tolist(), json.dumps(solution.singular),
    )  # fmt: skip
