"""Temperatures: every motor is a body warmed by its own motion, every link one warmed by its motor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.virtual_robot.description import Array
from experiments.virtual_robot.plant import Heat

HEAT_STEP = 10.0  # s; a hundredth of the shortest time constant


@dataclass(frozen=True)
class Temperatures:
    """Temperatures in °C: motors (N, n), links (N, n), ambient (N,)."""

    motor: Array
    link: Array
    ambient: Array


@dataclass(frozen=True)
class History:
    """A session's temperatures on a grid of times, s."""

    time: Array
    motor: Array
    link: Array
    ambient: Array

    def at(self, time: Array) -> Temperatures:
        """Return the temperatures at times of the session, s, (N,)."""

        def column(values: Array) -> Array:
            return np.column_stack([np.interp(time, self.time, v) for v in values.T])

        return Temperatures(column(self.motor), column(self.link), np.interp(time, self.time, self.ambient))


def session(heat: Heat, time: Array, activity: Array) -> History:
    """Integrate a session from switch-on.

    Parameters
    ----------
    heat
        The bodies.
    time
        Ends of segments of work, s, increasing, (m,).
    activity
        How hard each motor worked in each segment; 1 keeps it at its full rise in the end, (m, n).
    """
    grid = np.arange(0.0, time[-1] + 2 * HEAT_STEP, HEAT_STEP)
    work = activity[np.minimum(np.searchsorted(time, grid), len(time) - 1)]
    ambient = heat.ambient + heat.swing * np.sin(2 * np.pi * grid / heat.period + heat.phase)
    motor, link = np.empty((len(grid), len(heat.motor_time))), np.empty((len(grid), len(heat.motor_time)))
    m, k = ambient[0] + heat.start[0], ambient[0] + heat.start[1]
    for i, air in enumerate(ambient):
        motor[i], link[i] = m, k
        m_next = m + HEAT_STEP * ((air - m) / heat.motor_time + heat.motor_rise / heat.motor_time * work[i])
        k = k + HEAT_STEP * ((air - k) / heat.link_time + (m - k) / heat.contact_time)
        m = m_next
    return History(grid, motor, link, ambient)


def read_sensors(true: Temperatures, sigma: float, rng: np.random.Generator) -> dict[str, Array]:
    """Return the temperature columns of a table: noisy, and quantised to 0.01 K."""
    n = true.motor.shape[1]
    columns = {f"temp_link{i + 1}_C": true.link[:, i] for i in range(n)}
    columns |= {f"temp_motor{i + 1}_C": true.motor[:, i] for i in range(n)}
    columns["temp_ambient_C"] = true.ambient
    return {name: np.round(v + sigma * rng.standard_normal(len(v)), 2) for name, v in columns.items()}
