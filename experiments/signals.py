"""What follows from a log without any model: speeds, states of motion, contiguous stretches.

Nothing here knows of effects or of a robot's parameters beyond its transmission.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.signal import savgol_filter

__all__ = ["acceleration", "held_sign", "rest_threshold", "segments", "speeds"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]


def speeds(q: Array, time: Array, run: Integers, window_s: float | None = None) -> Array:
    """Joint speeds ``(N, n)`` of a log without any, run by run.

    A local cubic over a short window is zero-phase, also at the ends of a run. The window is five samples, or
    ``window_s`` seconds for a fast log whose positions are rounded.
    """
    return _derivative(q, time, run, window_s, order=1)


def acceleration(speed: Array, time: Array, run: Integers, window_s: float | None = None) -> Array:
    """Joint accelerations ``(N, n)`` from speeds, as :func:`speeds` does it."""
    return _derivative(speed, time, run, window_s, order=1)


def _derivative(values: Array, time: Array, run: Integers, window_s: float | None, order: int) -> Array:
    out = np.zeros_like(values)
    for r in np.unique(run):
        rows = np.flatnonzero(run == r)
        if len(rows) < 5:
            if len(rows) > 1:
                out[rows] = np.gradient(values[rows], time[rows], axis=0)
            continue
        steps = np.diff(time[rows])
        step = float(np.median(steps))
        if np.any(np.abs(steps - step) > 0.2 * step):  # dropped or irregular samples: no common filter
            out[rows] = np.gradient(values[rows], time[rows], axis=0)
            continue
        width = 5 if window_s is None else max(5, 2 * int(window_s / step / 2) + 1)
        width = min(width, len(rows) - 1 + len(rows) % 2)
        out[rows] = savgol_filter(values[rows], width, 3, deriv=order, delta=step, axis=0)
    return out


def rest_threshold(speed: Array) -> Array:
    """The speed ``(n,)`` below which a joint counts as at rest.

    Eight times what the slowest quarter of the log shows (at rest that is the noise of the speed), and at most 2 % of
    the top speed, for a joint that hardly ever rests.
    """
    size = np.abs(speed)
    quarter = np.quantile(size, 0.125, axis=0)
    return np.asarray(np.minimum(8.0 * quarter, 0.02 * size.max(axis=0)) + 1e-12)


def held_sign(speed: Array, threshold: Array, run: Integers) -> Array:
    """Sign of the present or, at rest, of the last motion in the run ``(N, n)``; 0 before the first."""
    sign = np.where(np.abs(speed) > threshold, np.sign(speed), 0.0)
    start = np.r_[True, run[1:] != run[:-1]]
    out = np.zeros_like(sign)
    index = np.arange(len(sign))
    first = np.maximum.accumulate(np.where(start, index, 0))
    for j in range(sign.shape[1]):
        last = np.maximum.accumulate(np.where(sign[:, j] != 0, index, -1))
        known = last >= first
        out[known, j] = sign[last[known], j]
    return out


def segments(run: Integers, time: Array, used: Bools) -> Integers:
    """Number of the contiguous stretch of used rows that each row belongs to ``(N,)``; -1 where not used.

    A stretch ends with its run, where a row is not used, and where the clock jumps (more than 1.5 steps).
    """
    if len(run) == 0:
        return np.zeros(0, dtype=np.int64)
    step = np.median(np.diff(time)) if len(time) > 1 else 1.0
    new = np.r_[True, (run[1:] != run[:-1]) | (np.abs(np.diff(time) - step) > 0.5 * abs(step))]
    new |= used & ~np.r_[False, used[:-1]]
    return np.where(used, np.cumsum(new) - 1, -1)
