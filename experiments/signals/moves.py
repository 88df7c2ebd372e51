"""Point-to-point moves recognised in sparse samples: the trapezoid of speed that passes through them.

Where a ramp lies between two or three samples, no difference of neighbours is its acceleration. A controller that moves
all joints in step, q(t) = a + s(t) d with a trapezoid of speed, leaves few unknowns: the posture a, the way d, and
three times. A move has more samples than that, so that they say themselves whether it was one: their rms distance from
it, as a second difference, is the error of its accelerations.

With the start t₀, the ramp's length r and the time c from the start of one ramp to that of the other,
s = (p(x) - p(x - r) - p(x - c) + p(x - r - c)) / (r c), x = t - t₀, p(x) = max(x, 0)²/2. Source of the motion: Lynch &
Park, Modern Robotics (2017), section 9.2.2; of the fit, linear in a and d: Golub & Pereyra, SIAM J. Numer. Anal. 10
(1973) 413, with Kaufman's derivative (BIT 15, 1975, 49).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.signals.motion import rest_threshold
from experiments.signals.typing_ import Array, Bools, Integers

__all__ = ["MoveMotion", "motion_of_moves"]

SAMPLES_AT_REST = 2  # before and after a move, which belong to it too: they say where it begins and ends
AT_REST = 1e-3  # of a joint's largest speed: so few samples may rest that their noise is not known well
LONGEST_MOVE = 4096  # samples; with more, the log is no sparse one
UNKNOWN_TIMES = 3
RAMPS_TRIED = (0.08, 0.2, 0.35, 0.5)  # of the move's duration: where the fit starts
ROUNDS_OF_FIT = 60
TIMES_SETTLED = 1e-9  # of the move's duration
DAMPING, DAMPING_DOWN, DAMPING_UP, DAMPING_END = 1e-2, 0.2, 4.0, 1e6
SINGULAR = 1e-12  # of the normal matrix's trace
SHORTEST_PART_S = 1e-3  # of a move
LARGEST_FACTOR = 3.0  # by which a step of the fit changes a length
RECOGNISED = 0.1  # of the move's largest acceleration, that the error of its accelerations is at most
SURELY = 5.0  # standard errors of the times: farther from a change of acceleration, a sample is on its side of it
SECOND_DIFFERENCE = 6.0**0.5  # its standard deviation over that of the samples


@dataclass(frozen=True)
class MoveMotion:
    """Speeds and accelerations of rows that belong to a recognised move.

    Attributes
    ----------
    speed, acceleration
        ``(N, n)``, rad/s, rad/s².
    error
        ``(N, n)``, rad/s²: of the acceleration; infinite where no move was recognised.
    """

    speed: Array
    acceleration: Array
    error: Array

    @property
    def known(self) -> Bools:
        """Where a move was recognised ``(N, n)``."""
        return np.isfinite(self.error)


def motion_of_moves(q: Array, time: Array, run: Integers) -> MoveMotion:
    """Fit a trapezoid of speed to every move between two rests, all joints in step.

    Parameters
    ----------
    q
        Positions ``(N, n)``, rad.
    time, run
        ``(N,)``: stamps, s, even or not, and numbers of the runs, each of them contiguous.

    Returns
    -------
    MoveMotion
        A row that rests between two moves is of the earlier one.
    """
    out = MoveMotion(np.zeros(q.shape), np.zeros(q.shape), np.full(q.shape, np.inf))
    first, last = _between_rests(q, time, run)
    size = np.frexp(last - first)[1]  # moves of like lengths together, so that a long one does not pad the others
    found = [_of_moves(q, time, first[size == k], last[size == k]) for k in np.unique(size)]
    for rows, *values in sorted((move for part in found for move in part), key=lambda move: -int(move[0][0])):
        out.speed[rows], out.acceleration[rows], out.error[rows] = values
    return out


def _of_moves(q: Array, time: Array, first: Integers, last: Integers) -> list[tuple[Integers, Array, Array, Array]]:
    """Rows of the recognised ones of some moves, with their speeds, accelerations and errors of these ``(k, n)``."""
    place = first[:, None] + np.arange(int((last - first).max()) + 1)
    own = place <= last[:, None]
    place = np.minimum(place, len(q) - 1)
    since = np.where(own, time[place] - time[first][:, None], 0.0)
    fit = _fitted(np.where(own[:, :, None], q[place] - q[first][:, None], 0.0), since, own)
    speed, acceleration = (fit.way[:, None] * _course(since, fit.times, order)[:, :, None] for order in (1, 2))
    step = since.max(axis=1) / (last - first)
    error = SECOND_DIFFERENCE * fit.noise / step**2
    # A sample that may lie on either side of a change of acceleration has its whole step as error.
    late = SURELY * fit.late[:, None]
    here, before, after = (_course(since + by * late, fit.times, 2) for by in (0.0, -1.0, 1.0))
    jump = np.maximum(np.abs(before - here), np.abs(after - here))
    errors = error[:, None, None] + np.abs(fit.way[:, None]) * jump[:, :, None]
    # A ramp within a step could be as steep as any: it counts as one step long.
    steepest = np.abs(fit.way).max(axis=1) / np.prod(np.maximum(fit.times[:, 1:], step[:, None]), axis=1)
    return [
        (place[k, own[k]], *(v[k, own[k]] for v in (speed, acceleration, errors)))
        for k in np.flatnonzero(error < RECOGNISED * steepest)
    ]


def _between_rests(q: Array, time: Array, run: Integers) -> tuple[Integers, Integers]:
    """First and last rows ``(m,)`` of the moves, with some samples of the rests on either side."""
    same = (run[1:] == run[:-1]) & (time[1:] > time[:-1])
    rate = np.where(same[:, None], np.diff(q, axis=0) / np.where(same, np.diff(time), 1.0)[:, None], 0.0)
    slowest = np.maximum(rest_threshold(rate[same]), AT_REST * np.abs(rate).max(axis=0, initial=0.0))
    moving = np.any(np.abs(rate) > slowest, axis=1) & same
    if not moving.any():
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    edge = np.diff(np.r_[0, moving.astype(np.int8), 0])
    begin, end = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1)  # rows: the last at rest, the first again
    broken = np.r_[0, np.cumsum(~same)]  # number of the stretch of every row
    starts = np.searchsorted(broken, broken[begin], side="left")
    stops = np.searchsorted(broken, broken[end], side="right") - 1
    first = np.maximum.reduce([begin - SAMPLES_AT_REST, starts, np.r_[-1, end[:-1]]])
    last = np.minimum.reduce([end + SAMPLES_AT_REST, stops, np.r_[begin[1:], len(q)]])
    short = last - first < LONGEST_MOVE
    return first[short], last[short]


@dataclass(frozen=True)
class _Fit:
    """Trapezoids of moves: start, ramp and distance of ramps ``(m, 3)``, s; way ``(m, n)``; rms ``(m,)``, rad.

    ``late`` ``(m,)``, s: the standard error of the times together.
    """

    times: Array
    way: Array
    noise: Array
    late: Array


def _fitted(samples: Array, since: Array, own: Bools) -> _Fit:
    """The best fits of moves ``(m, k, n)`` from several starts."""
    count, n = own.sum(axis=1), samples.shape[2]
    whole = np.take_along_axis(samples, (count - 1)[:, None, None], axis=1)[:, 0]
    along = np.einsum("mkn,mn->mk", samples, whole) / np.maximum(np.sum(whole**2, axis=1), 1e-300)[:, None]
    course = np.maximum.accumulate(np.where(own, along, -np.inf), axis=1)
    middle = np.array([np.interp(0.5, s[:c], t[:c]) for s, t, c in zip(course, since, count, strict=True)])
    length, centred = since.max(axis=1), _centred(samples, own)
    found = []
    for share in RAMPS_TRIED:
        start = np.stack([middle - 0.5 * length, share * length, (1.0 - share) * length], axis=1)
        found.append(_descended(centred, since, own, start))
    least = np.argmin([left for _, left in found], axis=0)
    times = np.array([times for times, _ in found])[least, np.arange(len(least))]
    left, way, normal, _ = _linearised(centred, since, own, times)
    spare = count * n - 2 * n - UNKNOWN_TIMES
    noise = np.where(spare > 0, np.sqrt(left / np.maximum(spare, 1)), np.inf)
    known = np.isfinite(noise)
    late = np.zeros(len(times))
    variance = np.trace(np.linalg.pinv(normal[known], hermitian=True), axis1=1, axis2=2)
    late[known] = noise[known] * np.sqrt(np.maximum(variance, 0.0))  # of what is no move it may be rounding
    return _Fit(times, way, noise, late)


def _descended(samples: Array, since: Array, own: Bools, times: Array) -> tuple[Array, Array]:
    """Times ``(m, 3)`` of least squares, and these ``(m,)``, rad², from a start: Levenberg and Marquardt's method."""
    length = since.max(axis=1)
    times = np.c_[times[:, 0], np.maximum(times[:, 1:], SHORTEST_PART_S)]
    left, _, normal, right = _linearised(samples, since, own, times)
    damping, settled = np.full(len(times), DAMPING), np.zeros(len(times), dtype=bool)
    for _ in range(ROUNDS_OF_FIT):
        at = np.flatnonzero(~settled)
        if not len(at):
            break
        scaled = normal[at] * (1.0 + damping[at, None, None] * np.eye(UNKNOWN_TIMES))
        least = SINGULAR * np.trace(normal[at], axis1=1, axis2=2) + np.finfo(float).tiny
        scaled += least[:, None, None] * np.eye(UNKNOWN_TIMES)
        tried = times[at] + np.linalg.solve(scaled, right[at, :, None])[:, :, 0]
        tried[:, 1:] = np.clip(tried[:, 1:], times[at, 1:] / LARGEST_FACTOR, times[at, 1:] * LARGEST_FACTOR)
        now, _, normal_now, right_now = _linearised(samples[at], since[at], own[at], tried)
        better = now < left[at]
        small = np.abs(tried - times[at]).max(axis=1) < TIMES_SETTLED * length[at]
        damping[at] *= np.where(better, DAMPING_DOWN, DAMPING_UP)
        settled[at] = small | (damping[at] > DAMPING_END)
        of = at[better]
        times[of], left[of], normal[of], right[of] = tried[better], now[better], normal_now[better], right_now[better]
    return times, left


def _linearised(samples: Array, since: Array, own: Bools, times: Array) -> tuple[Array, Array, Array, Array]:
    """Squares left ``(m,)``, ways ``(m, n)``, normal matrix ``(m, 3, 3)`` and right side ``(m, 3)`` of the times.

    ``samples`` ``(m, k, n)``: as :func:`_centred` gives them.
    """
    course, slopes = _by_times(since, times)
    course, slopes = _centred(course[:, :, None], own)[:, :, 0], _centred(slopes, own)
    size = np.maximum(np.sum(course**2, axis=1), 1e-300)
    way = (course[:, None] @ samples)[:, 0] / size[:, None]
    rest = samples - course[:, :, None] * way[:, None]
    slopes -= course[:, :, None] * ((course[:, None] @ slopes) / size[:, None, None])
    turned = np.swapaxes(slopes, 1, 2)
    normal = (turned @ slopes) * np.sum(way**2, axis=1)[:, None, None]
    right = (turned @ (rest @ way[:, :, None]))[:, :, 0]
    return np.sum(rest**2, axis=(1, 2)), way, normal, right


def _centred(values: Array, own: Bools) -> Array:
    """Values ``(m, k, c)`` of each move's own samples less their mean; zero in the others."""
    weight = own[:, :, None]
    mean = np.sum(values * weight, axis=1) / own.sum(axis=1)[:, None]
    return np.asarray((values - mean[:, None]) * weight)


def _course(since: Array, times: Array, order: int) -> Array:
    """Share of the way ``(m, k)``, or its derivative of an order: 1 (1/s) or 2 (1/s²)."""
    return np.asarray(sum(sign * _power(since - knot, 2 - order) for sign, knot in _knots(times)) / _area(times))


def _by_times(since: Array, times: Array) -> tuple[Array, Array]:
    """Share of the way ``(m, k)``, and its derivatives by start, ramp and distance of the ramps ``(m, k, 3)``, 1/s."""
    area = _area(times)
    first, ramped, second, last = (np.maximum(since - knot, 0.0) for _, knot in _knots(times))
    course = 0.5 * (first**2 - ramped**2 - second**2 + last**2) / area
    rate = (first - ramped - second + last) / area
    ramp = (ramped - last) / area - course / times[:, 1, None]
    apart = (second - last) / area - course / times[:, 2, None]
    return course, np.stack([-rate, ramp, apart], axis=2)


def _knots(times: Array) -> list[tuple[float, Array]]:
    """Sign and time ``(m, 1)`` of the four changes of acceleration."""
    start, ramp, apart = (times[:, k, None] for k in range(UNKNOWN_TIMES))
    return [(1.0, start), (-1.0, start + ramp), (-1.0, start + apart), (1.0, start + ramp + apart)]


def _area(times: Array) -> Array:
    return np.asarray(times[:, 1, None] * times[:, 2, None])


def _power(x: Array, degree: int) -> Array:
    """max(x, 0)^degree / degree!, of degree 0 a step."""
    return np.where(x > 0.0, x**degree / (2.0 if degree == 2 else 1.0), 0.0)
