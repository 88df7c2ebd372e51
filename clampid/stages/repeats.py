"""Runs of a log that repeat the motion of an earlier run.

Noise of two runs is independent; what a model lacks of a motion, or what is wrong with the accelerations taken from it,
comes back in every run that repeats it. Such runs are one piece of evidence, however often they were driven. Tests
therefore flip, and leave out, the same stretch of all of them together, as one cluster. Source: Liang & Zeger,
Longitudinal data analysis using generalized linear models, Biometrika 73, 1986 (errors correlated within clusters).

By how much the torques of such runs differ is a noise floor that no model has shaped: the pure error of a regression
with repeated points. Source: Draper & Smith, Applied regression analysis, 1998, sect. 2.1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clampid.stages.known_noise import upper_ends
from clampid.stages.rows import Array, Integers

__all__ = ["first_of_repeated", "nearest", "repeated_noise", "with_repeats"]

SAME_MOTION = 0.01  # of the joints' excursion, rms: a controller repeats a program within some milliseconds
BLOCKS = 20  # parts of a motion, from whose spread the uncertainty of the noise follows
FEWEST_ROWS = 100  # repeated rows: with fewer the noise is not known to a tenth
RESOLVED = 9  # decimals of a Nm: readings that differ by less are the same


class _Run(NamedTuple):
    """The rows of a run ``(m,)``, and their times since it began ``(m,)``, s."""

    rows: Integers
    elapsed: Array


def with_repeats(unit: Integers, run: Integers, time: Array, q: Array) -> Integers:
    """Units ``(N,)`` in which rows of a run that repeats an earlier one are of the units of the rows that they repeat.

    Parameters
    ----------
    unit, run
        ``(N,)``: of independent rows as far as noise goes, and runs; rows of a run follow each other.
    time, q
        ``(N,)``, s, ascending in a run, and ``(N, n)``, rad.
    """
    return np.asarray(unit[first_of_repeated(run, time, q)])


def first_of_repeated(run: Integers, time: Array, q: Array) -> Integers:
    """The row ``(N,)`` that each row repeats, of the first run with its motion; itself if it repeats none.

    Parameters as of :func:`with_repeats`.
    """
    out = np.arange(len(run))
    for first, *others in _alike(run, time, q):
        for rows, elapsed in others:
            out[rows] = first.rows[nearest(first.elapsed, elapsed)]
    return out


def repeated_noise(run: Integers, time: Array, q: Array, torque: Array) -> Array:
    """Upper ends ``(n,)``, Nm, of each motor's noise, as runs of one motion show it.

    It is the standard deviation of the torques at the same time of runs with the same motion, plus two standard errors;
    infinite where too little was repeated. What changes from run to run is in it, such as friction that warms up, and
    so is the rounding of the readings, which may be the same in every run. A copy of a run does not count, and neither
    does a motor whose torques are copies.

    Parameters
    ----------
    run, time
        ``(N,)``, and s, ascending in a run; rows of a run follow each other.
    q, torque
        ``(N, n)``, rad and Nm.
    """
    squares, freedom = [np.zeros((0, torque.shape[1]))], 0
    for first, *others in _alike(run, time, q):
        found = [torque[first.rows]]
        for rows, elapsed in others:
            again = torque[rows[nearest(elapsed, first.elapsed)]]
            found += [] if any(np.array_equal(again, known) for known in found) else [again]
        if len(found) > 1:
            squares.append(np.var(found, axis=0, ddof=1))
            freedom += (len(found) - 1) * len(first.rows)
    each = np.concatenate(squares)
    if freedom < FEWEST_ROWS or len(each) < BLOCKS:
        return np.full(torque.shape[1], np.inf)
    means = np.array([part.mean(axis=0) for part in np.array_split(each, BLOCKS)])
    means[:, ~np.any(each > 0.0, axis=0)] = np.nan
    return upper_ends((means + _resolution(torque) ** 2 / 12.0).T)


def _resolution(torque: Array) -> Array:
    """The smallest difference of two readings of each motor ``(n,)``, Nm; next to nothing unless they are rounded."""
    values = [np.unique(np.round(motor, RESOLVED)) for motor in torque.T]
    return np.array([np.diff(v).min() if len(v) > 1 else 0.0 for v in values])


def _alike(run: Integers, time: Array, q: Array) -> list[list[_Run]]:
    """The runs, those with one motion together, the first of them first."""
    out: list[list[_Run]] = []
    for number in np.unique(run):
        rows = np.flatnonzero(run == number).astype(np.int64)
        elapsed = time[rows] - time[rows[0]]
        for alike in out:
            if _same(q[rows], elapsed, q[alike[0].rows], alike[0].elapsed):
                alike.append(_Run(rows, elapsed))
                break
        else:
            out.append([_Run(rows, elapsed)])
    return out


def nearest(clock: Array | Integers, elapsed: Array | Integers) -> Integers:
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
