"""Answers of the line protocol as text."""

from __future__ import annotations

import json
from functools import lru_cache

from offline_ik.answer import Answer, Solution

__all__ = ["members_of"]

_TEMPLATE = (
    '{"q_rad": [#], "motor_rad": [#], "position_error_m": %.3g, "angle_error_rad": %.3g, '
    '"std_m": %.6g, "std_rad": %.6g, "radius95_m": %.6g, "tangential_std_m": %.6g, "radial_std_m": %.6g, '
    '"tangential_std_pixels": %.6g, "model_std_m": %.6g, "approach_std_m": %.6g, "roll_rad": %.12g, '
    '"status": %d, "turn": %d, "largest_move_rad": %.6g, "approach_direction": [#], "singular": %s}'
)


def members_of(answer: Answer) -> str:
    """What is said of a position, as JSON members to be spliced in; ``nearest`` is left to who looks for it.

    By templates: the encoder would take as long as the solver. The cell is in the server's state.
    """
    asked = ", ".join([f'"{name}": {"null" if value is None else repr(value)}' for name, value in answer.asked.items()])
    reachable, reasons = ("true", "[]") if answer.reachable else ("false", json.dumps(answer.reasons))
    x, y, z = answer.target[:3, 3].tolist()
    solutions = ", ".join(map(_told, answer.solutions))
    return (
        f', "reachable": {reachable}, "reasons": {reasons}, "asked": {{{asked}}}, '
        f'"detector_position_m": [{x:.9f}, {y:.9f}, {z:.9f}], "solutions": [{solutions}]'
    )


@lru_cache
def _template(n: int) -> str:
    return _TEMPLATE.replace("#", ", ".join(["%.12g"] * n))


def _told(solution: Solution) -> str:
    u = solution.uncertainty
    return _template(len(solution.q)) % (
        *solution.q.tolist(), *solution.motor.tolist(), solution.position_error, solution.angle_error, u.std_m,
        u.std_rad, u.radius95_m, u.tangential_m, u.radial_m, u.tangential_m / u.pixel, u.model_m, u.approach_m,
        solution.roll, solution.status, solution.turn, solution.distance, *solution.direction.tolist(),
        json.dumps(solution.singular) if solution.singular else "[]",
    )  # fmt: skip
