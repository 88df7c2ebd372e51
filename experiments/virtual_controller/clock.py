"""Simulated time: it runs with the wall clock, ``speed`` times as fast, and can be made faster while it runs."""

from __future__ import annotations

import time
from collections.abc import Callable

from experiments.virtual_controller.errors import ControllerError

__all__ = ["MAX_SPEED", "Clock"]

MAX_SPEED = 1000.0


class Clock:
    """Seconds since switch-on.

    Parameters
    ----------
    speed
        Simulated seconds in a second, above 0 and at most `MAX_SPEED`.
    wall
        A clock that never runs back, s.
    """

    def __init__(self, speed: float = 1.0, wall: Callable[[], float] = time.monotonic) -> None:
        self.wall = wall
        self._simulated, self._since = 0.0, wall()
        self._speed = _checked(speed)

    @property
    def speed(self) -> float:
        """Simulated seconds in a second."""
        return self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        new = _checked(speed)
        wall = self.wall()
        self._simulated, self._since, self._speed = self.at(wall), wall, new

    def now(self) -> float:
        """Simulated time, s."""
        return self.at(self.wall())

    def at(self, wall: float) -> float:
        """Simulated time at a time of the wall clock not before the last change of speed, s."""
        return self._simulated + (max(wall, self._since) - self._since) * self._speed

    def left(self, until: float) -> float:
        """How long it takes on the wall clock until a simulated time, s; negative when that has passed."""
        return (until - self.now()) / self._speed


def _checked(speed: float) -> float:
    if not 0.0 < speed <= MAX_SPEED:
        raise ControllerError(f"speed: expected above 0 and at most {MAX_SPEED:g}, found {speed:g}")
    return speed
