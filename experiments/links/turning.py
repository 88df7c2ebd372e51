"""Whether the joints move, from one status to the next: an arm still brakes after its program was aborted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from experiments.links.values import Status

__all__ = ["SHORTEST_STATUS_INTERVAL", "Turning", "turns"]

Array = npt.NDArray[np.float64]

SHORTEST_STATUS_INTERVAL = 0.01  # s at least between two statuses that are compared
PACE = 5e-3  # rad/s above which a joint moves: encoder noise is less, and only an arm about to stop is slower


class Turning:
    """Compares each status with one before it, by the controller's clock, or by when they came where it has none."""

    def __init__(self) -> None:
        self._before: Status | None = None
        self._moves: bool | None = None

    def seen(self, status: Status) -> Status:
        """The same status, with whether the joints turn; not known of the first one."""
        before = self._before
        apart = -1.0 if before is None or before.boot != status.boot else _time(status) - _time(before)
        if before is not None and 0.0 <= apart < SHORTEST_STATUS_INTERVAL:
            return replace(status, moves=self._moves)
        self._before = status
        self._moves = None
        if before is not None and apart > 0.0:
            self._moves = turns(before.joints, status.joints, apart)
        return replace(status, moves=self._moves)


def turns(before: Array, now: Array, apart: float) -> bool:
    """Whether joints ``(n,)``, rad, turn that were seen so many seconds apart."""
    return bool(np.abs(now - before).max() > PACE * apart)


def _time(status: Status) -> float:
    return status.received if status.clock is None else status.clock
