"""A robot in memory, behind the four methods of a link: it moves in straight lines at a given pace."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from clampid.verbs.errors import CallError

START = (0.1, -1.2, 1.2, 0.1, 0.4, 0.0)


class MemoryLink:
    """Moves for ``seconds`` whatever the way.

    Attributes
    ----------
    sent
        Postures of every move that was accepted.
    residual
        rad, by which it misses every end, as real robots do.
    """

    def __init__(self, seconds: float = 0.1, residual: float = 0.0) -> None:
        self.seconds, self.residual = seconds, residual
        self.sent: list[np.ndarray] = []
        self.called: list[float] = []  # when `move` was called
        self.stopped: list[float] = []
        self.failed = ""
        self.age = 0.0
        self.slow = 0.0  # s that `move` waits for the controller
        self.refuses = ""
        self.executes, self.stops_at_once = True, False
        self._lock = threading.Lock()
        self._way = np.array([START, START])
        self._begun, self._takes = -1e9, 0.0

    def _share(self) -> float:
        return min((time.monotonic() - self._begun) / self._takes, 1.0) if self._takes else 1.0

    def posture(self) -> np.ndarray:
        with self._lock:
            return self._here()

    def _here(self) -> np.ndarray:
        at = self._share() * (len(self._way) - 1)
        k = min(int(at), len(self._way) - 2)
        return np.asarray(self._way[k] + (at - k) * (self._way[k + 1] - self._way[k]))

    def move(self, postures: np.ndarray, speed: float) -> None:
        self.called.append(time.perf_counter())
        if self.refuses:
            raise CallError(self.refuses)
        if self.slow:
            time.sleep(self.slow)
        with self._lock:
            if self._share() < 1:
                raise CallError("another move is under way")
            self._way = np.vstack([self._here(), np.atleast_2d(postures) + self.residual])
            self._begun, self._takes = time.monotonic(), self.seconds
            self.sent.append(np.array(postures))

    def state(self) -> Mapping[str, Any]:
        with self._lock:
            told: dict[str, Any] = {"moving": self._share() < 1, "age_s": self.age}
        return told | ({"failed": self.failed} if self.failed else {})

    def stop(self) -> None:
        self.stopped.append(time.perf_counter())
        with self._lock:
            here = self._here()
            self._way, self._begun = np.array([here, here]), -1e9

    def put(self, posture: np.ndarray) -> None:
        """Move it by hand."""
        with self._lock:
            self._way, self._begun = np.array([posture, posture]), -1e9
