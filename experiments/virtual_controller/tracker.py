"""The instrument: a laser tracker on a socket, which measures the true place of the tool.

========================  =============================================================================================
``measure N [TARGET]``    N points at 500 Hz from now on: ``points_m``, ``std_m``, ``temperature_C``, ``time_s``, …
``targets``               names of the targets on the tool, and where they are on the flange by design
``gauges``                  dial gauges at a clamped flange: ``gauges`` along and about the base's axes, m and rad
``temperatures``          sensors on motors and links and in the air: ``motor_C``, ``link_C``, ``ambient_C``
========================  =============================================================================================

Points are in the instrument's own frame. Without a line of sight, ``measure`` answers ``{"error": "line of sight
lost"}``.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any

import numpy as np

from experiments.virtual_controller.arm import Arm
from experiments.virtual_controller.clock import Clock
from experiments.virtual_controller.errors import ControllerError
from experiments.virtual_robot.description import Array
from experiments.virtual_robot.draw import TARGETS

__all__ = ["LOST", "WORDS", "Tracker"]

PERIOD = 0.002  # s between two points
MAX_POINTS = 5000  # in one request
LOST = "line of sight lost"
WORDS = frozenset({"measure", "targets", "gauges", "temperatures"})


class Tracker:
    """The instrument of one robot.

    Parameters
    ----------
    arm
        The robot that it sees.
    clock
        Simulated time.
    """

    def __init__(self, arm: Arm, clock: Clock) -> None:
        self._arm, self._clock = arm, clock
        self._rng = np.random.default_rng([arm.seed, 28])
        self.lost = 0  # requests that will find no line of sight
        self.silent_until = 0.0  # on the wall clock, s

    async def answer(self, line: str) -> dict[str, Any]:
        """Answer a line of the protocol."""
        await asyncio.sleep(max(self.silent_until - self._clock.wall(), 0.0))
        word, *words = line.split()[:4] or [""]
        if word == "measure":
            return await self._measure(words)
        if line.strip() == "targets":
            return {"targets_m": {name: list(point) for name, point in TARGETS.items()}}
        if line.strip() == "gauges":
            return self._gauges()
        if line.strip() == "temperatures":
            return self._temperatures()
        raise ControllerError("expected 'measure N [TARGET]', 'targets', 'gauges' or 'temperatures'")

    def fall_silent(self, seconds: float) -> None:
        """Answer nothing for a while, s of the wall clock."""
        self.silent_until = self._clock.wall() + seconds

    async def _measure(self, words: list[str]) -> dict[str, Any]:
        names = list(TARGETS)
        count = int(words[0]) if words and words[0].isdecimal() and len(words[0]) < 6 else 0
        target = words[1] if len(words) > 1 else names[0]
        if not 1 <= count <= MAX_POINTS or len(words) > 2:
            raise ControllerError(f"expected 'measure N [TARGET]' with N from 1 to {MAX_POINTS}")
        if target not in names:
            raise ControllerError(f"target {target[:20]!r}: expected one of {', '.join(names)}")
        if self.lost:
            self.lost -= 1
            return {"error": LOST}
        begin = self._clock.now()
        times: Array = begin + PERIOD * np.arange(count, dtype=float)
        await asyncio.sleep(max(self._clock.left(float(times[-1])), 0.0))
        points = self._seen(times)[:, names.index(target)]
        points = points + self._arm.plant.instrument.sigma * self._rng.standard_normal(points.shape)
        air = self._arm.climate(float(times[-1])).ambient[0]
        return {
            "target": target,
            "time_s": round(begin, 4),
            "period_s": PERIOD,
            "points_m": np.round(points, 7).tolist(),
            "std_m": self._arm.plant.instrument.sigma,
            "temperature_C": self._read(air),
        }

    def _seen(self, times: Array) -> Array:
        """Targets without noise; while the robot stands they are worked out once."""
        still = self._arm.track.stands(float(times[0]), float(times[-1]))
        if still:
            return np.repeat(self._arm.points([float(times[-1])]), len(times), axis=0)
        return self._arm.points([float(time) for time in times])

    def _gauges(self) -> dict[str, Any]:
        now = self._clock.now()
        read = self._arm.gauges(now)
        if read is None:
            raise ControllerError("the flange is not clamped")
        return {"time_s": round(now, 4), "gauges": np.round(read, 8).tolist()}

    def _temperatures(self) -> dict[str, Any]:
        now = self._clock.now()
        true = self._arm.climate(now)
        read: Mapping[str, Any] = {
            "motor_C": [self._read(value) for value in true.motor[0]],
            "link_C": [self._read(value) for value in true.link[0]],
            "ambient_C": self._read(true.ambient[0]),
        }
        return {"time_s": round(now, 4), **read}

    def _read(self, celsius: float) -> float:
        """The reading of a sensor: with noise, in steps of 0.01."""
        sigma = self._arm.plant.instrument.temperature_sigma
        return round(float(celsius + sigma * self._rng.standard_normal()), 2)
