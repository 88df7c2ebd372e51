"""What a request of the line protocol asks for: a detector position, and the ways there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from offline_ik.checks import check_directions
from offline_ik.detector import Detector
from offline_ik.requests import number, numbers, switch
from offline_ik.ways import Ways, ways_to

__all__ = ["asked_of", "sides_of", "ways_of"]

Array = npt.NDArray[np.float64]


def sides_of(detector: Detector, given: Mapping[str, str]) -> Array | None:
    """From which sides joints are to come ``(n,)``."""
    asked = numbers(given, "direction")
    return None if asked is None else check_directions(detector.arm.n, asked)


def asked_of(given: Mapping[str, str], near: Array | None, sides: Array | None) -> dict[str, Any]:
    """What a request asks :meth:`offline_ik.detector.Detector.locate` for."""
    return {
        "gamma": number(given, "gamma"),
        "delta": number(given, "delta"),
        "r": number(given, "r"),
        "roll": None if given.get("roll") == "free" else number(given, "roll", 0.0),
        "near": near,
        "branch": given.get("branch", "nearest"),
        "direction": sides if sides is not None else None if near is None else "moved",
    }


def ways_of(given: Mapping[str, str], start: Array, sides: Array | None) -> Callable[[Detector], Ways]:
    """What finds the ways from a posture ``(n,)`` to where a request asks for."""
    branch, approach, asked = given.get("branch", "nearest"), switch(given, "approach"), asked_of(given, start, sides)

    def work(detector: Detector) -> Ways:
        answer = detector.locate(**asked)
        return ways_to(detector, answer, start=start, branch=branch, approach=approach, direction=sides)

    return work
