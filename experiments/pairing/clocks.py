"""Finds the offset and drift of two clocks from the times at which both logs start and stop moving.

Every instrument's start votes with every robot's start for an offset, and every end with every end, for each of some
drifts. The best candidates are refined by least squares on mutually nearest events::

    robot time = offset + (1 + drift) (instrument time - middle) + side * lag,    side = 1 (start), -1 (end)

``lag`` is a symmetric difference between the logs, such as a long sampling step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.stats import norm, poisson

from experiments.pairing.stops import FALSE_ALARMS, ROBUST, Stops

__all__ = ["MAX_DRIFT", "ClockFit", "fit_clocks"]

FloatArray = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

MAX_DRIFT = 150e-6
MAX_VOTERS = 500  # events of the instrument that vote; all are used by the fit
FIRST_TOLERANCE_S = 0.5  # a few bins
SAME_OFFSET_S = 1.0  # candidates nearer than this are one
RIVAL = 0.9  # of the best candidate's events: another one with so many cannot be ruled out
GIVEN_WITHIN_S = 2.0  # how well an offset is known that a person gives


@dataclass(frozen=True)
class ClockFit:
    """How the robot's clock follows from the instrument's.

    Attributes
    ----------
    offset_s, offset_std_s
        Robot time minus instrument time at ``middle_s``. The standard error includes what is systematic: a sampling
        step of the robot's log (uniform) and ``lag``.
    drift, drift_std
        Seconds that the robot's clock gains per second of the instrument's.
    middle_s
        On the instrument's clock.
    scatter_s
        Standard deviation of one event about the line.
    tolerance_s
        How far an event may be off at the false-alarm rate.
    events
        How many were used.
    """

    offset_s: float
    offset_std_s: float
    drift: float
    drift_std: float
    middle_s: float
    scatter_s: float
    tolerance_s: float
    events: int

    def to_robot(self, time: npt.ArrayLike) -> FloatArray:
        """Robot times of instrument times, s."""
        t = np.asarray(time, dtype=np.float64)
        return np.asarray(t + self.offset_s + self.drift * (t - self.middle_s))


def fit_clocks(instrument: Stops, robot: Stops, near_s: float | None = None) -> ClockFit:
    """Fit offset and drift.

    Parameters
    ----------
    near_s
        Robot time minus instrument time, known within 2 s; None: anything.

    Raises
    ------
    ValueError
        No offset explains more events than chance would, or two offsets explain them equally well.
    """
    ours, theirs = _events(instrument), _events(robot)
    if min(len(ours[0]), len(theirs[0])) < 6:
        found = f"{len(instrument)} stops of the instrument and {len(robot)} of the robot"
        raise ValueError(f"expected at least 3 stops with start and end in both logs, found {found}")
    middle = float(np.mean(ours[0]))
    base = float(np.mean(theirs[0]))
    ours, theirs = (ours[0] - middle, ours[1]), (theirs[0] - base, theirs[1])
    near = None if near_s is None else near_s - base + middle
    bin_s = max(0.2, 2 * robot.step_s)
    floor = (robot.step_s + instrument.step_s) / np.sqrt(12)
    candidates: list[_Line] = []
    for offset, drift in _votes(ours, theirs, bin_s, near):
        line = _refined(ours, theirs, offset, drift, max(FIRST_TOLERANCE_S, 2 * bin_s), floor)
        if line is None or abs(line.drift) > 2 * MAX_DRIFT + 5 * line.std[1]:
            continue
        if near is None or abs(line.offset - near) < GIVEN_WITHIN_S:
            candidates.append(line)
    if not candidates:
        raise ValueError("expected stops that both logs saw, found no offset of the clocks that matches any")
    candidates.sort(key=lambda line: (-len(line.residuals), line.scatter))
    best = candidates[0]
    _refuse_chance(best, len(ours[0]), theirs[0], bin_s)
    rivals = [c for c in candidates if abs(c.offset - best.offset) > SAME_OFFSET_S]
    rival = next((c for c in rivals if len(c.residuals) >= RIVAL * len(best.residuals)), None)
    if rival is not None and rival.scatter < 1.5 * best.scatter:
        both = " and ".join(f"{c.offset + base - middle:.2f} s" for c in (best, rival))
        counts = f"{len(best.residuals)} and {len(rival.residuals)} starts and ends match"
        raise ValueError(f"expected one offset of the clocks, found {both} ({counts}); state it as offset in seconds")
    n = len(best.residuals)
    # Differences between the logs may be unlike at starts and ends; more events do not average that out.
    systematic = robot.step_s / np.sqrt(12), best.lag
    return ClockFit(
        offset_s=best.offset + base - middle, offset_std_s=float(np.linalg.norm([best.std[0], *systematic])),
        drift=best.drift, drift_std=best.std[1],
        middle_s=middle, scatter_s=best.scatter, tolerance_s=float(norm.isf(FALSE_ALARMS / (2 * n))) * best.scatter,
        events=n,
    )  # fmt: skip


@dataclass(frozen=True)
class _Line:
    offset: float
    drift: float
    lag: float
    std: tuple[float, float]
    scatter: float
    residuals: FloatArray


_Events = tuple[FloatArray, Integers]


def _events(stops: Stops) -> _Events:
    """Times of starts and ends that were seen, and their sides, 1 and -1."""
    start, end = stops.start[stops.starts_seen], stops.end[stops.ends_seen]
    return np.r_[start, end], np.r_[np.ones(len(start), dtype=np.int64), -np.ones(len(end), dtype=np.int64)]


def _votes(ours: _Events, theirs: _Events, bin_s: float, near: float | None) -> list[tuple[float, float]]:
    """Offsets and drifts with the most votes, best first."""
    pick = np.argsort(ours[0])[np.linspace(0, len(ours[0]) - 1, min(MAX_VOTERS, len(ours[0]))).astype(int)]
    t, side = ours[0][pick], ours[1][pick]
    half = float(np.ptp(t)) / 2 + 1.0
    steps = int(np.ceil(MAX_DRIFT * half / bin_s))
    found: list[tuple[int, float, float]] = []
    for drift in np.linspace(-MAX_DRIFT, MAX_DRIFT, 2 * steps + 1):
        apart = [np.subtract.outer(theirs[0][theirs[1] == s], (1 + drift) * t[side == s]).ravel() for s in (1, -1)]
        every = np.concatenate(apart)
        if near is not None:
            every = every[np.abs(every - near) < GIVEN_WITHIN_S]
        if not every.size:
            continue
        low = float(every.min())
        votes = np.bincount(((every - low) / bin_s).astype(np.int64), minlength=2)
        pairs = votes[1:] + votes[:-1]
        for k in np.argsort(-pairs, kind="stable")[:12]:
            found.append((int(pairs[k]), low + (k + 1) * bin_s, float(drift)))
    found.sort(key=lambda one: -one[0])
    kept: list[tuple[float, float]] = []
    for _, offset, drift in found:
        if all(abs(offset - other) > 2 * bin_s or drift != of for other, of in kept):
            kept.append((offset, drift))
        if len(kept) == 40:
            break
    return kept


def _matched(ours: _Events, theirs: _Events, at: FloatArray) -> tuple[Integers, Integers]:
    """Mutually nearest events of the same side: rows of ours and theirs; ``at`` is where ours should be."""
    left, right = [], []
    for side in (1, -1):
        a, b = np.flatnonzero(ours[1] == side), np.flatnonzero(theirs[1] == side)
        if not a.size or not b.size:
            continue
        b = b[np.argsort(theirs[0][b])]
        a = a[np.argsort(at[a])]
        to, back = _nearest(theirs[0][b], at[a]), _nearest(at[a], theirs[0][b])
        mutual = back[to] == np.arange(len(a))
        left.append(a[mutual])
        right.append(b[to[mutual]])
    return np.concatenate(left or [np.zeros(0, int)]), np.concatenate(right or [np.zeros(0, int)])


def _nearest(line: FloatArray, points: FloatArray) -> Integers:
    """Index in the sorted ``line`` nearest to each point."""
    at = np.clip(np.searchsorted(line, points), 1, max(1, len(line) - 1))
    if len(line) == 1:
        return np.zeros(len(points), dtype=np.int64)
    return np.where(points - line[at - 1] <= line[at] - points, at - 1, at).astype(np.int64)


def _refined(
    ours: _Events, theirs: _Events, offset: float, drift: float, tolerance: float, floor: float
) -> _Line | None:
    """The line by least squares on events within a tolerance that shrinks to what they scatter."""
    lag, line = 0.0, None
    for _ in range(12):
        at = offset + (1 + drift) * ours[0] + lag * ours[1]
        left, right = _matched(ours, theirs, at)
        close = np.abs(theirs[0][right] - at[left]) < tolerance
        left, right = left[close], right[close]
        if len(left) < 6:
            return None
        t, side = ours[0][left], ours[1][left]
        both = len(np.unique(side)) == 2
        design = np.column_stack([np.ones(len(t)), t, *([side] if both else [])])
        target = theirs[0][right] - t
        found, _, rank, _ = np.linalg.lstsq(design, target, rcond=None)
        if rank < design.shape[1]:
            return None
        residuals = target - design @ found
        offset, drift, lag = float(found[0]), float(found[1]), float(found[2]) if both else 0.0
        robust = max(ROBUST * float(np.median(np.abs(residuals))), floor)
        free = len(t) - design.shape[1]
        scatter = max(float(np.sqrt(np.sum(residuals**2) / free)), floor)
        covariance = scatter**2 * np.linalg.inv(design.T @ design)
        std = float(np.sqrt(covariance[0, 0])), float(np.sqrt(covariance[1, 1]))
        line = _Line(offset, drift, lag, std, scatter, residuals)
        tolerance = float(norm.isf(FALSE_ALARMS / (2 * len(t)))) * robust
    return line


def _refuse_chance(best: _Line, events: int, theirs: FloatArray, bin_s: float) -> None:
    """Refuse a match that chance would find somewhere at the false-alarm rate."""
    span = float(np.ptp(theirs)) + 1.0
    width = 2 * max(float(np.abs(best.residuals).max()), best.scatter)
    expected = events * (1 - np.exp(-width * len(theirs) / 2 / span))
    trials = 4 * span / bin_s
    if trials * float(poisson.sf(len(best.residuals) - 1, expected)) > FALSE_ALARMS:
        found = f"{len(best.residuals)} of {events} starts and ends that match, as chance would ({expected:.1f})"
        raise ValueError(f"expected stops that both logs saw, found {found}")
