"""Point-to-point motion as a controller does it: all joints start and stop together, with trapezoidal speed.

With s going from 0 to 1 in ``duration`` T with a ``ramp`` r at both ends, the top speed is V = 1 / (T - r) and the
acceleration V / r; joint j moves by d_j s(t). Source: Lynch & Park, Modern Robotics, section 9.2.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Array", "Course", "peak_rates", "shortest"]

Array = npt.NDArray[np.float64]
SHORTEST_MOVE = 0.1  # s: no controller does less in one move


def shortest(travel: Array, speed: Array, acceleration: Array) -> tuple[Array, Array]:
    """Shortest duration and ramp of moves within limits.

    Parameters
    ----------
    travel
        ``(m, k)``: how far each axis goes, rad.
    speed, acceleration
        ``(k,)`` or ``(m, k)``: limits of each axis, rad/s and rad/s².

    Returns
    -------
    duration, ramp
        ``(m,)`` each, s; a move without travel takes the shortest time that there is.
    """
    size = np.abs(travel)
    with np.errstate(over="ignore"):
        rate = np.min(np.broadcast_to(speed, size.shape) / np.maximum(size, 1e-300), axis=-1)
        gain = np.min(np.broadcast_to(acceleration, size.shape) / np.maximum(size, 1e-300), axis=-1)
        flat = rate**2 / gain < 1.0  # else the top speed is never reached
    duration = np.where(flat, 1.0 / rate + rate / gain, 2.0 / np.sqrt(gain))
    ramp = np.where(flat, rate / gain, 1.0 / np.sqrt(gain))
    # A slower move with the same shape is within the same limits.
    factor = np.maximum(SHORTEST_MOVE / np.maximum(duration, 1e-300), 1.0)
    return np.asarray(duration * factor), np.asarray(ramp * factor)


def peak_rates(travel: Array, duration: Array, ramp: Array) -> tuple[Array, Array]:
    """Top speeds and accelerations ``(m, k)`` of moves by ``travel`` ``(m, k)`` in ``duration`` and ``ramp`` ``(m,)``.

    rad/s and rad/s².
    """
    top = np.abs(travel) / (duration - ramp)[:, None]
    return top, top / ramp[:, None]


@dataclass(frozen=True)
class Course:
    """Moves through ``knots`` ``(m + 1, n)`` rad, move i in ``duration[i]`` with ``ramp[i]`` s."""

    knots: Array
    duration: Array
    ramp: Array
    dwell: float

    @property
    def length(self) -> float:
        """Time from start to end, s."""
        return float(np.sum(self.duration) + self.dwell * len(self.knots))

    @property
    def starts(self) -> Array:
        """When each move starts ``(m,)``, s."""
        return np.asarray(self.dwell + np.concatenate([[0.0], np.cumsum(self.duration + self.dwell)[:-1]]))

    def phase(self, time: Array) -> tuple[npt.NDArray[np.int64], Array]:
        """Which move is the last begun at ``time`` ``(N,)``, s, and how long ago it began ``(N,)``, s."""
        starts = self.starts
        move = np.clip(np.searchsorted(starts, time, side="right") - 1, 0, len(starts) - 1)
        return move, np.asarray(time - starts[move])

    def at(self, time: Array) -> tuple[Array, Array, Array]:
        """Joint angles, speeds and accelerations ``(N, n)``, rad and s, at times ``(N,)``, s."""
        k, since = self.phase(time)
        T, r = self.duration[k], self.ramp[k]
        t = np.clip(since, 0.0, T)
        top = 1.0 / (T - r)
        up, down = t < r, t > T - r
        s = np.where(up, 0.5 * top * t**2 / r, np.where(down, 1.0 - 0.5 * top * (T - t) ** 2 / r, top * (t - 0.5 * r)))
        moving = (since > 0) & (since < T)
        rate = np.where(moving, np.where(up, top * t / r, np.where(down, top * (T - t) / r, top)), 0.0)
        gain = np.where(moving & up, top / r, np.where(moving & down, -top / r, 0.0))
        step = self.knots[k + 1] - self.knots[k]
        return self.knots[k] + s[:, None] * step, rate[:, None] * step, gain[:, None] * step
