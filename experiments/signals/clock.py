"""The clock of a log: contiguous stretches, missing samples, jumps, jitter, and samples that only repeat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from experiments.signals.typing_ import Array, Bools, Integers

__all__ = ["Gap", "gaps", "irregularity", "regular_time", "segments", "stale_rows", "typical_step"]

# Half a step either way: the nearest whole number of steps is then another one than 1.
HALF_STEP = 0.5
# How many standard errors apart two readings of a gap have to be for the positions to decide between them.
CERTAIN_PERIOD = 4.0
# A sample that is missing shows as two steps in one; between one and two steps lies one and a half.
MISSING = 0.5
# The finest difference in a log may be a third of its encoder's step, where readings are averaged or converted.
QUANTA = 3
# Rows looked at on either side of a repeated one: few enough for a speed to be the same in.
NEIGHBOURS = 3
# A source half as fast as the log holds one row in two; one that is faster than four fifths of it skips singly.
SHARE_OF_REPEATS = 0.2


def segments(run: Integers, time: Array, used: Bools) -> Integers:
    """Number of the contiguous stretch of used rows that each row belongs to ``(N,)``; -1 where not used.

    A stretch ends with its run, where a row is not used, and where the clock jumps (by more than half a step besides
    the step; the step is the median one within runs).
    """
    if len(run) == 0:
        return np.zeros(0, dtype=np.int64)
    step = typical_step(time, run)
    new = np.r_[True, (run[1:] != run[:-1]) | (np.abs(np.diff(time) - step) > HALF_STEP * step)]
    new |= used & ~np.r_[False, used[:-1]]
    return np.where(used, np.cumsum(new) - 1, -1)


def typical_step(time: Array, run: Integers) -> float:
    """Median time step within runs [s]; 1 where no run has two rows with different, increasing stamps."""
    steps = np.diff(time)[run[1:] == run[:-1]]
    steps = steps[steps > 0.0]
    return float(np.median(steps)) if steps.size else 1.0


def regular_time(time: Array) -> Array | None:
    """The evenly spaced times ``(L,)`` that increasing stamps ``(L,)`` of one stretch stand for, if they do.

    Stamps are printed with finitely many digits: 3, 3 and 4 ms are a third of 10 ms each, and a speed taken on the
    stamps as printed would show the printing. They stand for even steps if no stamp is farther from those than half
    of the last digit, or than a millionth of a step (the resolution of the number itself).
    """
    if len(time) < 3:
        return time
    count = np.arange(len(time), dtype=np.float64)
    step = (time[-1] - time[0]) / count[-1]
    even = time[0] + step * count
    off = time - even
    centre = 0.5 * (off.max() + off.min())  # the first stamp itself is rounded, too
    spread = 0.5 * float(np.ptp(off))
    if spread <= 1e-6 * step:
        return np.asarray(even)
    # The slope is known to one digit over the whole stretch only, which adds as much again at its ends.
    return np.asarray(even + centre) if spread <= 1.001 * _last_digit(time) and spread < HALF_STEP * step else None


def _last_digit(time: Array) -> float:
    """The unit of the last decimal that stamps ``(L,)`` are printed with [s]; 0 if they have more than seven."""
    for digits in range(8):
        scaled = time * 10.0**digits
        # Numbers of size t are stored to 1e-16·t; a stamp that is no multiple is off by far more than a thousandth.
        if np.max(np.abs(scaled - np.rint(scaled))) < 1e-3:
            return float(10.0**-digits)
    return 0.0


@dataclass(frozen=True)
class Gap:
    """One step of the clock that is not a step of the log.

    Attributes
    ----------
    row
        Index of the row after the gap.
    seconds
        What the clock says went by [s]; may be negative.
    step
        The run's usual step [s].
    kind
        ``dropped``: the step is two or more usual ones, and the positions do not contradict. ``jump``: the positions
        moved as in one usual step, or the clock went back or too short a way: the clock is wrong, not the sampling.
    missing
        Samples that are missing; 0 for a jump.
    """

    row: int
    seconds: float
    step: float
    kind: str
    missing: int


def gaps(q: Array, time: Array, run: Integers) -> tuple[Gap, ...]:
    """Find missing samples and jumps of the clock.

    A step counts when it is more than half a usual step away from the usual one *and* farther than six times the
    clock's own jitter (1.4826 times the median absolute deviation: of normal jitter, 1 step in 5e8 is so far out).
    While the robot moves, positions tell missing samples from a jump: time passed is distance over speed, with the
    speed read before and after. What they cannot separate by four standard errors counts as missing.

    Parameters
    ----------
    q
        Positions ``(N, n)`` [rad].
    time
        Stamps ``(N,)`` [s].
    run
        Numbers of the runs ``(N,)``, each of them contiguous.

    Returns
    -------
    tuple of Gap
        In the order of rows.
    """
    found = []
    for rows in _runs(run):
        if len(rows) < 5:  # too few to know what is usual
            continue
        steps = np.diff(time[rows])
        step = float(np.median(steps))
        if step <= 0.0:
            continue
        off = np.abs(steps - step)
        jitter = 1.4826 * float(np.median(off))
        for k in np.flatnonzero(off > np.maximum(HALF_STEP * step, 6.0 * jitter)):
            missing = max(int(np.rint(steps[k] / step)) - 1, 0)
            jumped = missing == 0 or _moved_one_step(q[rows], steps, int(k), step)
            kind = "jump" if jumped else "dropped"
            found.append(Gap(int(rows[k + 1]), float(steps[k]), step, kind, 0 if jumped else missing))
    return tuple(found)


def _runs(run: Integers) -> list[Integers]:
    if len(run) == 0:
        return []
    return [np.asarray(r) for r in np.split(np.arange(len(run)), np.flatnonzero(run[1:] != run[:-1]) + 1)]


def _moved_one_step(q: Array, steps: Array, k: int, step: float) -> bool:
    """Whether positions ``(L, n)`` say that one usual step went by between rows k and k + 1."""
    if k < 2 or k + 3 >= len(q):
        return False
    clean = steps[[k - 2, k - 1, k + 1, k + 2]]
    if np.any(np.abs(clean - step) > HALF_STEP * step):
        return False
    before, after = (q[k] - q[k - 2]) / (2.0 * step), (q[k + 3] - q[k + 1]) / (2.0 * step)
    speed = 0.5 * (before + after)
    size = float(np.linalg.norm(speed))
    if size == 0.0:
        return False
    passed = float(speed @ (q[k + 1] - q[k])) / size**2
    # The speed within the gap is known to half of how much it changes over it, and positions to their noise.
    noise = np.linalg.norm(q[k - 2 : k + 1].T @ [1.0, -2.0, 1.0]) + np.linalg.norm(
        q[k + 1 : k + 4].T @ [1.0, -2.0, 1.0]
    )
    error = (0.5 * float(np.linalg.norm(after - before)) * max(steps[k], step) + float(noise)) / size
    return bool(abs(passed - step) < abs(passed - steps[k]) and abs(steps[k] - step) > CERTAIN_PERIOD * error)


def irregularity(time: Array, run: Integers) -> float:
    """How irregular the usual steps of a log are: their standard deviation, as a share of the step.

    Gaps and jumps (more than half a step off) do not count, and neither does what the printing of the stamps explains:
    stamps that stand for even steps give 0.
    """
    variance, count = 0.0, 0
    for rows in _runs(run):
        if len(rows) < 5:
            continue
        steps = np.diff(time[rows])
        step = float(np.median(steps))
        breaks = np.flatnonzero(np.abs(steps - step) > HALF_STEP * abs(step)) + 1
        for piece in np.split(time[rows], breaks):
            if len(piece) > 2 and step > 0.0:
                even = regular_time(piece) is not None
                variance += 0.0 if even else float(np.sum((np.diff(piece) / step - 1.0) ** 2))
                count += len(piece) - 1
    return float(np.sqrt(variance / count)) if count else 0.0


def stale_rows(q: Array, run: Integers) -> Bools:
    """Rows ``(N,)`` that repeat the position before them although the robot moved.

    All joints are exactly as in the row before, and then the missing way comes in one step, in the direction that the
    joint moves in before and after: after r repeated rows it is r + 1 usual changes (a robot that really stopped for
    a sample goes on with one; so do positions whose rounding is coarser than their change a row). Positions that are
    held for the same few rows throughout, as where their source is slower than the log, have no usual change:
    they count where at least one row in five of those in fast motion is held. Rows after which any joint goes back are
    a stop between two motions, and no hold.

    Parameters
    ----------
    q
        Positions ``(N, n)`` [rad].
    run
        Numbers of the runs ``(N,)``, each of them contiguous.

    Returns
    -------
    Bools
        True where a position is not a measurement.
    """
    if len(q) < 2 * NEIGHBOURS + 2:
        return np.zeros(len(q), dtype=bool)
    within = run[1:] == run[:-1]
    change = np.where(within[:, None], np.diff(q, axis=0), 0.0)  # (N-1, n)
    same = np.r_[False, np.all(change == 0.0, axis=1) & within]
    starts = np.flatnonzero(same & ~np.r_[False, same[:-1]])
    ends = np.flatnonzero(same & ~np.r_[same[1:], False])  # last repeated row of each streak
    whole = (starts > NEIGHBOURS) & (ends + 1 + NEIGHBOURS < len(q))
    starts, ends = starts[whole], ends[whole]
    if len(starts) == 0:
        return np.zeros(len(q), dtype=bool)
    steps = np.arange(NEIGHBOURS)
    before, after = change[starts[:, None] - 2 - steps], change[ends[:, None] + 1 + steps]  # (streaks, 3, n)
    around = np.concatenate([before, after], axis=1)  # (streaks, 6, n)
    jump = change[ends]
    onward = np.all(around * jump[:, None] >= 0.0, axis=1) & before.any(axis=1) & after.any(axis=1)
    moving = np.count_nonzero(around, axis=1)
    # The median of those that are not zero: sorted, zeros come first.
    ordered = np.sort(np.abs(around), axis=1)
    middle = 2 * NEIGHBOURS - (moving + 1) // 2
    usual = np.take_along_axis(ordered, np.minimum(middle, 2 * NEIGHBOURS - 1)[:, None], axis=1)[:, 0]
    repeats = (ends - starts + 1)[:, None]
    single = onward & (moving > NEIGHBOURS) & (np.abs(jump) >= (repeats + MISSING) * usual)
    back = np.any(before.sum(axis=1) * after.sum(axis=1) < 0.0, axis=1)  # rounding aside, a joint goes one way
    held = onward & _held(change, same & ~_rows(starts[back], ends[back], len(q)), jump) & ~back[:, None]
    bad = np.flatnonzero((single | held).any(axis=1))
    return _rows(starts[bad], ends[bad], len(q))


def _rows(starts: Integers, ends: Integers, count: int) -> Bools:
    """Which of so many rows lie in one of the stretches, ends included."""
    mark = np.zeros(count + 1, dtype=np.int64)
    np.add.at(mark, starts, 1)
    np.add.at(mark, ends + 1, -1)
    return np.asarray(np.cumsum(mark[:-1]) > 0)


def _held(change: Array, same: Bools, jump: Array) -> Bools:
    """Which jumps ``(streaks, n)`` end a hold, in a log whose positions are held throughout."""
    size = np.abs(change)
    quantum = np.min(np.where(size > 0.0, size, np.inf), axis=0)
    # The mean over seven rows sees through holds; three quanta a row are not rounding.
    rate = uniform_filter1d(size, 2 * NEIGHBOURS + 1, axis=0)
    fast = np.any(rate >= QUANTA * quantum, axis=1)
    if not fast.any() or np.mean(same[1:][fast]) < SHARE_OF_REPEATS:
        return np.zeros(jump.shape, dtype=bool)
    return np.asarray(np.abs(jump) >= QUANTA * quantum)
