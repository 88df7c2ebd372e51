"""States of motion: when a joint counts as at rest, and which way it last moved."""

from __future__ import annotations

import numpy as np

from experiments.signals.typing_ import Array, Integers

__all__ = ["carried_sign", "rest_threshold", "speed_counts", "threshold_of_counts"]

_DROPPED_BITS = 44  # of a float64's 52 of mantissa: 256 bins an octave
_LOWEST = (1023 - 40) << 8  # the bin of 2^-40
_BINS = 64 << 8
_NORMAL = 1.4826  # median absolute deviation to standard deviation of a normal
_SIGMAS = 6.0
_FIRST_GUESS = (
    8.0  # times the speed of the slowest eighth: a joint that rests a quarter of the time is then at 5.4 sigma
)
_LIMIT_SHARE = 0.02
_ROUNDS = 50
GONE = 0.5  # of the way that a speed says; in motion it is all of it, in overshoot none


def rest_threshold(speed: Array) -> Array:
    """The speed below which a joint counts as at rest: six standard deviations of its speed's noise.

    Parameters
    ----------
    speed
        Speeds ``(N, n)`` [rad/s], with whatever noise differentiation has left in them.

    Returns
    -------
    Array
        ``(n,)`` [rad/s]; see `threshold_of_counts`.
    """
    return threshold_of_counts(speed_counts(speed), np.abs(speed).max(axis=0, initial=0.0))


def speed_counts(speed: Array) -> Integers:
    """How many speeds fall into each of the bins that `threshold_of_counts` reads; counts of parts of a log add up.

    Parameters
    ----------
    speed
        Speeds ``(N, n)`` [rad/s].

    Returns
    -------
    Integers
        ``(n, bins)``: 256 bins an octave, from 2^-40 to 2^24 rad/s; what is below is in the first.
    """
    # The leading bits of a positive float are its logarithm, to within the width of a bin, and exact to compute.
    leading = np.abs(np.ascontiguousarray(speed, dtype=np.float64)).view(np.int64) >> _DROPPED_BITS
    bins = np.clip(leading - _LOWEST, 0, _BINS - 1)
    return np.array([np.bincount(column, minlength=_BINS) for column in bins.T], dtype=np.int64).reshape(-1, _BINS)


def threshold_of_counts(counts: Integers, top: Array) -> Array:
    """The threshold of rest from `speed_counts`.

    The rows at rest are those below the threshold, and their noise sets the threshold: 1.4826 times the median size of
    the speeds below it is the noise's standard deviation, and the threshold is six of them, which noise exceeds once in
    5e8 rows. Which share of the log the joint rests does not matter, as long as slow motion is rarer than rest. At most
    2 % of the top speed, for a joint that hardly ever rests. Speeds of exactly zero are rest without saying how
    large the noise is where there is some (an encoder that now and then moves by one count), and are left out.

    Parameters
    ----------
    counts
        ``(n, bins)``.
    top
        The largest speed of each joint ``(n,)`` [rad/s].

    Returns
    -------
    Array
        ``(n,)`` [rad/s]. Source: the median absolute deviation as a scale of a normal: Huber, Robust Statistics (1981),
        section 5.1, iterated as a truncated sample.
    """
    edges = (((np.arange(_BINS, dtype=np.int64) + _LOWEST + 1) << _DROPPED_BITS).view(np.float64)).copy()
    out = np.zeros(len(counts))
    for j, column in enumerate(counts):
        below = np.cumsum(np.where(np.arange(_BINS) > 0, column, 0))
        limit = _LIMIT_SHARE * float(top[j])
        threshold = min(_FIRST_GUESS * _order_statistic(below, edges, 0.125 * below[-1]), limit)
        for _ in range(_ROUNDS):
            inside = below[max(int(np.searchsorted(edges, threshold, side="right")) - 1, 0)]
            moved = min(_SIGMAS * _NORMAL * _order_statistic(below, edges, 0.5 * inside), limit)
            if moved == threshold:
                break
            threshold = moved
        out[j] = threshold
    return out + 1e-12


def _order_statistic(below: Integers, edges: Array, rank: float) -> float:
    """The bin's upper edge at which ``rank`` of the counted speeds are below; 0 where there are none."""
    return float(edges[int(np.searchsorted(below, rank))]) if rank > 0 else 0.0


def carried_sign(speed: Array, threshold: Array, run: Integers, position: Array, time: Array) -> Array:
    """Sign of the present or, at rest, of the last motion in the run ``(N, n)``; 0 before the first.

    A smoothed speed overshoots at the begin and end of a motion and has the wrong sign there for a few rows. In a log
    of few rows a second the overshoot exceeds any threshold of rest. So a row counts as moving only if the neighbouring
    positions have moved at least half as far, in that direction, as its speed says. Other rows keep the last sign.

    Parameters
    ----------
    speed
        ``(N, n)``, rad/s, smoothed.
    threshold
        ``(n,)``, rad/s: the speed of rest.
    run, time
        ``(N,)``: numbers of the runs, and stamps, s.
    position
        ``(N, n)``, rad, as measured.
    """
    start = np.r_[True, run[1:] != run[:-1]][: len(run)]
    last = np.r_[start[1:], True][: len(run)]
    rows = np.arange(len(run))
    after, before = np.where(last, rows, np.minimum(rows + 1, len(run) - 1)), np.where(start, rows, rows - 1)
    span = time[after] - time[before]
    # What is known anew in a row, at a run's start or in motion, as four times the row and 0, 1 or 2 for its sign: the
    # largest so far is the last, and says which.
    rest = 4 * np.arange(1, len(run) + 1)
    at_start = np.where(start, rest + 1, 0)
    out = np.empty(speed.shape, order="F")
    for j, column in enumerate(speed.T):
        gone = (position[after, j] - position[before, j]) * np.sign(column)
        moving = (np.abs(column) > threshold[j]) & (gone >= GONE * np.abs(column) * span)
        known = np.where(moving, rest + 1 + np.sign(column).astype(np.int64), at_start)
        out[:, j] = (np.maximum.accumulate(known) & 3) - 1
    return out
