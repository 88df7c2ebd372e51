"""Runs of a log that repeat the motion of an earlier run.

Noise of two runs is independent; what a model lacks of a motion, or what is wrong with the accelerations taken from it,
comes back in every run that repeats it. Such runs are one piece of evidence, however often they were driven. Tests
therefore flip, and leave out, the same stretch of all of them together, as one cluster. Source: Liang & Zeger,
Longitudinal data analysis using generalized linear models, Biometrika 73, 1986 (errors correlated within clusters).
"""

from __future__ import annotations

import numpy as np

from clampid.stages.rows import Array, Integers

__all__ = ["with_repeats"]

SAME_MOTION = 0.01  # of the joints' excursion, rms: a controller repeats a program within some milliseconds


def with_repeats(unit: Integers, run: Integers, time: Array, q: Array) -> Integers:
    """Units ``(N,)`` in which rows of a run that repeats an earlier one are of the units of the rows that they repeat.

    Parameters
    ----------
    unit, run
        ``(N,)``: of independent rows as far as noise goes, and runs; rows of a run follow each other.
    time, q
        ``(N,)``, s, ascending in a run, and ``(N, n)``, rad.
    """
    out = unit.copy()
    first: list[tuple[Integers, Array]] = []  # rows of runs that repeat none, and their times since the run began
    for number in np.unique(run):
        rows = np.flatnonzero(run == number).astype(np.int64)
        elapsed = time[rows] - time[rows[0]]
        for earlier, clock in first:
            nearest = _nearest(clock, elapsed)
            if _same(q[rows], elapsed, q[earlier], clock):
                out[rows] = out[earlier[nearest]]
                break
        else:
            first.append((rows, elapsed))
    return out


def _nearest(clock: Array, elapsed: Array) -> Integers:
    """Which reading of an ascending clock ``(k,)`` is nearest to each time ``(m,)``."""
    after = np.clip(np.searchsorted(clock, elapsed), 1, max(len(clock) - 1, 1))
    after = np.minimum(after, len(clock) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(elapsed - clock[before] <= clock[after] - elapsed, before, after).astype(np.int64)


def _same(q: Array, elapsed: Array, earlier: Array, clock: Array) -> bool:
    """Whether two runs have one motion, rad ``(m, n)`` and ``(k, n)``, each with the times since it began, s."""
    longer, shorter = max(elapsed[-1], clock[-1]), min(elapsed[-1], clock[-1])
    if shorter < (1.0 - SAME_MOTION) * longer:
        return False
    excursion = np.sqrt(np.mean((earlier - earlier.mean(axis=0)) ** 2))
    if not excursion or np.abs(q[0] - earlier[0]).max() > excursion:  # most runs that differ begin elsewhere
        return False
    there = np.stack([np.interp(elapsed, clock, joint) for joint in earlier.T], axis=1)
    return bool(np.sqrt(np.mean((q - there) ** 2)) <= SAME_MOTION * excursion)
