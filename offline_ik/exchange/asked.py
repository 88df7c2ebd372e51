"""The content of a request of the line protocol: a detector position, and the move there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from offline_ik.cell.checks import check_directions
from offline_ik.exchange.requests import number, numbers, switch
from offline_ik.inverse.detector import Detector
from offline_ik.motion.simulation import Position, Simulation, simulate_move, simulate_straight

__all__ = ["asked_of", "sides_of", "simulated_at_once", "simulation_of"]

Array = npt.NDArray[np.float64]


def sides_of(detector: Detector, given: Mapping[str, str]) -> Array | None:
    """From which sides joints are to come ``(n,)``."""
    asked = numbers(given, "direction")
    return None if asked is None else check_directions(detector.arm.n, asked)


def asked_of(given: Mapping[str, str], near: Array | None, sides: Array | None) -> dict[str, Any]:
    """What a request asks :meth:`offline_ik.inverse.detector.Detector.locate` for."""
    return {
        "gamma": number(given, "gamma"),
        "delta": number(given, "delta"),
        "r": number(given, "r"),
        "roll": None if given.get("roll") == "free" else number(given, "roll", 0.0),
        "near": near,
        "branch": given.get("branch", "nearest"),
        "direction": sides if sides is not None else None if near is None else "moved",
    }


def simulation_of(given: Mapping[str, str], start: Array, sides: Array | None) -> Callable[[Detector], Simulation]:
    """What simulates the move from a posture ``(n,)`` to where a request asks for."""
    asked = asked_of(given, start, sides)
    position = Position(asked["gamma"], asked["delta"], asked["r"], asked["roll"])
    branch, approach = given.get("branch", "nearest"), switch(given, "approach")

    def work(detector: Detector) -> Simulation:
        return simulate_move(detector, position, start=start, branch=branch, approach=approach, direction=sides)

    return work


def simulated_at_once(
    detector: Detector, given: Mapping[str, str], start: Array, sides: Array | None
) -> Simulation | None:
    """The same move simulated, where it takes no longer than an answer on the server's loop may; else None."""
    if switch(given, "approach"):
        return None
    answer = detector.at_once(**asked_of(given, start, sides))
    return None if answer is None else simulate_straight(detector, answer, start, sides)
