"""Answers of the line protocol as text."""

from __future__ import annotations

import json
from functools import lru_cache

from offline_ik.answer import Answer, Solution

__all__ = ["members_of"]

_ANSWER = (
    ', "reachable": %s, "reasons": %s, "asked": {"gamma_rad": %r, "delta_rad": %r, "r_m": %r, "roll_rad": %s}, '
    '"detector_position_m": [%.9f, %.9f, %.9f], "solutions": [%s]'
)
_SOLUTION = (
    '{"q_rad": [#], "motor_rad": [#], "position_error_m": %.3g, "angle_error_rad": %.3g, '
    '"std_m": %.6g, "std_rad": %.6g, "radius95_m": %.6g, "tangential_std_m": %.6g, "radial_std_m": %.6g, '
    '"tangential_std_pixels": %.6g, "model_std_m": %.6g, "approach_std_m": %.6g, "roll_rad": %.12g, '
    '"status": %d, "turn": %d, "largest_move_rad": %.6g, "approach_direction": [#], "singular": %s}'
)


def members_of(answer: Answer) -> str:
    """What is said of a position, as JSON members to be spliced in; ``nearest`` is left to who looks for it.

    By templates: the encoder would take as long as the solver. The cell is in the server's state.
    """
    asked, solutions = answer.asked, answer.solutions
    roll = asked["roll_rad"]
    return _ANSWER % (
        "true" if solutions else "false", json.dumps(answer.reasons) if answer.reasons else "[]",
        asked["gamma_rad"], asked["delta_rad"], asked["r_m"], "null" if roll is None else repr(roll),
        *answer.target[:3, 3].tolist(), ", ".join([_told(solution) for solution in solutions]),
    )  # fmt: skip


@lru_cache
def _template(n: int) -> str:
    return _SOLUTION.replace("#", ", ".join(["%.12g"] * n))


def _told(solution: Solution) -> str:
    u, q = solution.uncertainty, solution.q.tolist()
    tangential = u.tangential_m
    return _template(len(q)) % (
        *q, *solution.motor.tolist(), solution.position_error, solution.angle_error, u.std_m,
        u.std_rad, u.radius95_m, tangential, u.radial_m, tangential / u.pixel, u.model_m, u.approach_m,
        solution.roll, solution.status, solution.turn, solution.distance, *solution.direction.tolist(),
        json.dumps(solution.singular) if solution.singular else "[]",
    )  # fmt: skip
