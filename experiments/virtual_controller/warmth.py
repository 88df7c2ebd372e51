"""Temperatures since switch-on, computed on request: memory does not grow with the hours.

The bodies and the step are those of `experiments.virtual_robot.heat`; only how far the axes went in each step is new.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from experiments.virtual_robot.description import Array
from experiments.virtual_robot.heat import HEAT_STEP, Temperatures
from experiments.virtual_robot.plant import Heat

__all__ = ["Warmth"]

BRISK = 0.05  # of the top speed, on average, warms a motor to its full rise in the end, as `Session` has it
HARDEST = 1.5
STEPS_KEPT = 40  # steps: what the recording asks for is younger


class Warmth:
    """Temperatures of one robot.

    Parameters
    ----------
    heat
        Its bodies.
    speed
        Top speeds of the axes, rad/s, (n,).
    travel
        How far each axis has gone in all until a time, rad, (n,).
    """

    def __init__(self, heat: Heat, speed: Array, travel: Callable[[float], Array]) -> None:
        self._heat, self._speed, self._travel = heat, speed, travel
        air = self._air(0.0)
        self._rows: deque[tuple[Array, Array, float]] = deque(
            [(air + heat.start[0], air + heat.start[1], air)], maxlen=STEPS_KEPT
        )
        self._gone = travel(0.0)
        self.steps = 0  # done

    @property
    def time(self) -> float:
        """Time until which the temperatures are computed, s."""
        return self.steps * HEAT_STEP

    def advance(self, time: float) -> None:
        """Compute the temperatures until a time that has passed, s."""
        while self.time + HEAT_STEP <= time:
            self._step()

    def _step(self) -> None:
        heat = self._heat
        motor, link, air = self._rows[-1]
        gone = self._travel(self.time + HEAT_STEP)
        work = np.minimum((gone - self._gone) / HEAT_STEP / (BRISK * self._speed), HARDEST)
        self._gone = gone
        self.steps += 1
        self._rows.append(
            (
                motor + HEAT_STEP * ((air - motor) / heat.motor_time + heat.motor_rise / heat.motor_time * work),
                link + HEAT_STEP * ((air - link) / heat.link_time + (motor - link) / heat.contact_time),
                self._air(self.time),
            )
        )

    def at(self, times: Sequence[float]) -> Temperatures:
        """Return the temperatures at times that have passed, s; the last step goes on until the next one."""
        return Temperatures(*(self._between(times, which) for which in range(3)))

    def motor(self, times: Sequence[float]) -> Array:
        """Return the motors' temperatures, °C, (N, n)."""
        return self._between(times, 0)

    def _between(self, times: Sequence[float], which: int) -> Array:
        self.advance(max(times))
        first = self.steps - len(self._rows) + 1
        rows = []
        for time in times:
            at = min(max(time / HEAT_STEP - first, 0.0), len(self._rows) - 1.0)
            low = int(at)
            high = min(low + 1, len(self._rows) - 1)
            rows.append(self._rows[low][which] * (1 - (at - low)) + self._rows[high][which] * (at - low))
        return np.array(rows, dtype=float)

    def _air(self, time: float) -> float:
        heat = self._heat
        return float(heat.ambient + heat.swing * np.sin(2 * np.pi * time / heat.period + heat.phase))
