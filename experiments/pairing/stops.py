"""Finds when a log stands still.

Means over two adjacent windows are compared. Their difference is motion where it exceeds ``z`` standard deviations of
what still samples show. ``z`` follows from the false-alarm rate of a whole log, divided by the number of comparisons.
The noise comes from the quietest blocks, so that it is right also where most of the log is motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2, norm

__all__ = ["FALSE_ALARMS", "Stops", "find_stops"]

FloatArray = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

FALSE_ALARMS = 1e-3  # expected false detections of motion in a whole log of white noise
WINDOW_S = 0.1  # over which means are taken; one sample where the log is slower
MIN_STOP_S = 0.5  # shorter pauses are turning points of a motion
GAP_STEPS = 5  # sampling steps without a row: line of sight or connection lost
QUIET_QUANTILE = 0.1  # of blocks; at least so many are taken to stand still
ROBUST = 1.4826  # median absolute deviation to standard deviation of a normal


@dataclass(frozen=True)
class Stops:
    """Intervals in which a log stands still, in order of time.

    Attributes
    ----------
    start, end
        ``(S,)`` s on the log's clock: midway between the last moving and the first still sample.
    starts_seen, ends_seen
        ``(S,)``: whether motion was seen there; False where a gap or the end of the log cuts the stop.
    first, last
        ``(S,)``: rows of the samples that stand still, ``last`` exclusive; the window at each end is left out.
    center
        ``(S, k)``: medians of these samples.
    noise
        ``(k,)``: standard deviation of one still sample.
    mean_noise
        ``(k,)``: standard deviation of a difference of two windows' means.
    limit
        ``z``: how many of these are motion.
    step_s
        Median sampling step.
    """

    start: FloatArray
    end: FloatArray
    starts_seen: Bools
    ends_seen: Bools
    first: Integers
    last: Integers
    center: FloatArray
    noise: FloatArray
    mean_noise: FloatArray
    limit: float
    step_s: float

    def __len__(self) -> int:
        return len(self.start)


def find_stops(time: FloatArray, values: FloatArray, false_alarms: float = FALSE_ALARMS) -> Stops:
    """Find the stops of a log.

    Parameters
    ----------
    time
        ``(N,)`` s, increasing.
    values
        ``(N, k)``: positions or joint angles.
    false_alarms
        Expected false detections of motion in the whole log.

    Raises
    ------
    ValueError
        Fewer than 10 rows, or a time that does not increase.
    """
    if len(time) < 10:
        raise ValueError(f"expected at least 10 rows, found {len(time)}")
    steps = np.diff(time)
    if not np.all(steps > 0.0):
        raise ValueError(
            f"expected times that increase, found {time[int(np.argmin(steps > 0.0)) + 1]:.9g} s after more"
        )
    step = float(np.median(steps))
    window = max(1, round(WINDOW_S / step))
    values = values - np.median(values, axis=0)
    cuts = np.flatnonzero(steps > GAP_STEPS * step) + 1
    pieces = list(zip(np.r_[0, cuts], np.r_[cuts, len(time)], strict=True))
    shifts = np.full(values.shape, np.nan)
    for begin, end in pieces:
        shifts[begin:end] = _shifts(values[begin:end], window)
    noise, mean_noise = _noise(values, shifts, window)
    limit = float(norm.isf(false_alarms / (2 * values.size)))
    moving = np.any(np.abs(np.nan_to_num(shifts)) > limit * mean_noise, axis=1)
    found = [(*row, begin, end) for begin, end in pieces for row in _runs(moving, begin, end, window, time)]
    rows = np.array(found, dtype=np.int64).reshape(-1, 6)
    start, end, first, last, center = [], [], [], [], []
    for a, b, from_motion, to_motion, begin, stop in rows:
        trim = window if b - a > 4 * window else 0
        core = slice(a + trim * from_motion, b - trim * to_motion)
        middle = np.median(values[core], axis=0)
        near = limit * noise
        low, high = int(a), int(b)
        while from_motion and low > max(begin, a - window) and np.all(np.abs(values[low - 1] - middle) <= near):
            low -= 1
        while to_motion and high < min(stop, b + window) and np.all(np.abs(values[high] - middle) <= near):
            high += 1
        start.append(time[low] - step / 2 if from_motion else time[low])
        end.append(time[high - 1] + step / 2 if to_motion else time[high - 1])
        first.append(core.start)
        last.append(core.stop)
        center.append(middle)
    return Stops(
        np.array(start, dtype=float), np.array(end, dtype=float), rows[:, 2] == 1, rows[:, 3] == 1,
        np.array(first, dtype=np.int64), np.array(last, dtype=np.int64),
        np.array(center, dtype=float).reshape(-1, values.shape[1]), noise, mean_noise, limit, step,
    )  # fmt: skip


def _shifts(values: FloatArray, window: int) -> FloatArray:
    """Mean of the window from each row on, minus that of the window before ``(N, k)``; NaN near the ends."""
    out = np.full(values.shape, np.nan)
    if len(values) >= 2 * window:
        total = np.vstack([np.zeros(values.shape[1]), np.cumsum(values, axis=0)])
        means = (total[window:] - total[:-window]) / window
        out[window : len(values) - window + 1] = means[window:] - means[:-window]
    return out


def _noise(values: FloatArray, shifts: FloatArray, window: int) -> tuple[FloatArray, FloatArray]:
    """Standard deviations of one still sample and of a still shift ``(k,)``, from the quietest blocks."""
    size = max(8, min(window, len(values) // 10))
    count = max(1, len(values) // size)
    size = min(size, len(values))
    blocks = values[: count * size].reshape(count, size, -1)
    spread = blocks.var(axis=1, ddof=1)  # (blocks, k)
    jumps = np.abs(np.diff(values[: min(len(values), 200_000)], axis=0))
    tick = np.array([np.min(column[column > 0.0], initial=np.inf) for column in jumps.T])
    # A log that repeats its last digit when still has at least the noise of its rounding.
    floor = np.where(np.isfinite(tick), tick / np.sqrt(12), 0.0) + 1e-12
    variance = np.maximum(np.quantile(spread, QUIET_QUANTILE, axis=0), floor**2)
    still = np.ones(count, dtype=bool)
    for _ in range(10):
        still = np.all(spread <= variance * chi2.isf(1e-4, size - 1) / (size - 1), axis=1)
        if not still.any():
            break
        variance = np.maximum(np.median(spread[still], axis=0), floor**2)
    noise = np.sqrt(variance)
    rows = np.repeat(still, size)
    inside = shifts[: count * size][rows]
    inside = inside[np.all(np.isfinite(inside), axis=1)]
    robust = ROBUST * np.median(np.abs(inside), axis=0) if len(inside) else np.zeros_like(noise)
    return noise, np.maximum(robust, noise * np.sqrt(2 / window))


def _runs(moving: Bools, begin: int, end: int, window: int, time: FloatArray) -> list[tuple[int, int, int, int]]:
    """Still runs of one piece: rows, and whether motion was seen before and after."""
    still = np.r_[False, ~moving[begin:end], False]
    flips = np.flatnonzero(np.diff(still.astype(np.int8)))
    out = []
    for a, b in zip(begin + flips[::2], begin + flips[1::2], strict=True):
        if b - a > max(2, 2 * window) and time[b - 1] - time[a] >= MIN_STOP_S:
            out.append((int(a), int(b), int(a > begin), int(b < end)))
    return out
