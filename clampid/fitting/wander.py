"""Slow noise of a reading, such as the drift of a sensor's zero or of a tracker: a level that wanders at random.

Besides white noise, a channel has a level whose variance falls with a power of the frequency: the first for flicker
noise (1/f), as of electronics and temperatures; the second for a random walk, the sum of independent steps. Over a
session the level is a sum of half waves, cos(pi k t / T), whose independent amplitudes have variances in proportion to
1 / k^p. For the random walk about its mean this is the Karhunen-Loeve expansion. The covariance of the numbers is
I + B V B', B the waves and V their variances. Its inverse square root takes out of residual and Jacobian what they have
in common with the waves, the more the larger the wave. A column that changes as slowly as the level then explains
little. Variance and power are estimated by restricted likelihood, with everything that may explain the residual as
regressors.

Sources: Rasmussen & Williams, Gaussian Processes for Machine Learning (2006), appendix A.3 (inverse and determinant of
such a covariance); Van Trees, Detection, Estimation, and Modulation Theory I (1968), section 3.4 (expansion of a random
walk); Patterson & Thompson, Recovery of inter-block information when block sizes are unequal, Biometrika 58, 1971
(restricted likelihood); Self & Liang, J. Am. Stat. Assoc. 82, 1987 (likelihood ratio for a variance that may be zero:
half a chi-square with 1 degree of freedom).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import interpolate, linalg, sparse, stats

from clampid.stages.rows import Array, Integers, Rows

__all__ = [
    "FLICKER",
    "RANDOM_WALK",
    "WANDER_FALSE_ALARMS",
    "Filter",
    "Filters",
    "Level",
    "Wander",
    "Waves",
    "in_time",
    "larger",
    "wander_of",
    "waves_of",
]

WANDER_FALSE_ALARMS = 0.01  # probability that slow noise is found in a reading without any
UPPER_LIMIT_CHANCE = 0.05  # probability that v exceeds its upper limit; 9 % in logs of some hundred rows
FINE_STEPS = 1000  # points of the interpolated likelihood
FLICKER, RANDOM_WALK = 1, 2  # power of the frequency by which the variance falls
VARIANCES = tuple(float(10.0**k) for k in np.arange(-4.0, 4.1, 0.5))
# Of the gain of flicker noise, that a walk has at least: in nine of ten simulated readings, or all if it is strong.
SEEN_BY_A_WALK = 0.75
FILTERED_AT_ONCE = 256  # columns from which a level is taken together: copies of a long table would be large
MOST_WAVES = 200  # of a channel; faster ones have less of the level than of white noise
# Variance of the level's mean, over that about its mean. Of a walk: as after another walk of the same length. Flicker
# noise has the same variance in each octave: as if it had as many octaves below the session's length as above it.
OF_MEAN = {FLICKER: 1.0, RANDOM_WALK: 8.0}
TAKES_NOTHING = 1e-4  # variance of a direction of the level, over that of a number, below which it is left out
INDEPENDENT = 1e-8  # of a column's length: with a smaller part outside the other columns it is linearly dependent


@dataclass(frozen=True)
class Level:
    """The slow noise of some channels.

    Attributes
    ----------
    variance
        Of the level about its mean, over the longest session, in units of the variance of a number.
    power
        Of the frequency, by which it falls: :data:`FLICKER` or :data:`RANDOM_WALK`.
    goes_on
        Of a log: whether the level goes on over all stretches of rows that count, as seen through the filter of the
        noise. Otherwise its jumps at the beginning of each stretch are left to the candidates.
    """

    variance: float
    power: int
    goes_on: bool = False

    def of_waves(self, order: Array, share: Array) -> Array:
        """Variance ``(w,)`` of each wave, whose mean square over its session is 1.

        Parameters
        ----------
        order
            ``(w,)``: how many half waves there are over the session; 0: its mean.
        share
            ``(w,)``: length of the wave's session over that of the longest.
        """
        falls = np.maximum(order, 1.0) ** -self.power
        whole = np.sum(np.arange(1.0, max(order.max(initial=1.0), 1.0) + 1.0) ** -self.power)
        about = share ** (self.power - 1) * falls / whole
        return np.asarray(self.variance * np.where(order > 0.0, about, OF_MEAN[self.power]))


def larger(*levels: Level | None) -> Level | None:
    """The level of the largest variance; None if there is none."""
    return max((level for level in levels if level is not None), key=lambda level: level.variance, default=None)


@dataclass(frozen=True)
class Waves:
    """The half waves of which a channel's level consists.

    Attributes
    ----------
    columns
        ``(k, w)``, as each number shows them.
    order
        ``(w,)``: how many half waves there are over the session; 0: its mean.
    share
        ``(w,)``: length of the wave's session over that of the longest.
    """

    columns: Array
    order: Array
    share: Array

    @staticmethod
    def of(count: int, pieces: Sequence[tuple[Integers, Array]], shown: Array | None = None) -> Waves:
        """The waves of some pieces of ``count`` numbers, each with a level of its own.

        Parameters
        ----------
        pieces
            Of each piece which numbers it has ``(n,)``, and their places in time ``(n,)``, in steps.
        shown
            ``(k,)``: how much of the level each number shows; None: all of it.
        """
        lengths = [float(np.ptp(at)) + 1.0 for _, at in pieces]
        found, order, share = [np.zeros((count, 0))], [np.zeros(0)], [np.zeros(0)]
        for (own, at), length in zip(pieces, lengths, strict=True):
            k = np.arange(1.0 + min(len(np.unique(at)) - 1, round(MOST_WAVES * len(own) / count)))
            turns = (at - at.min() + 0.5)[:, None] * k / length  # half a step before the first to half a step after
            part = np.zeros((count, len(k)))
            part[own] = np.where(k > 0.0, np.sqrt(2.0), 1.0) * np.cos(np.pi * turns)
            found.append(part)
            order.append(k)
            share.append(np.full(len(k), length / max(lengths)))
        columns = np.hstack(found)
        return Waves(
            columns if shown is None else columns * shown[:, None], np.concatenate(order), np.concatenate(share)
        )

    def filter(self, level: Level) -> Filter:
        """What takes a level out of columns."""
        B = self.columns * np.sqrt(level.of_waves(self.order, self.share))
        values, vectors = np.linalg.eigh(B.T @ B)
        shown = values > TAKES_NOTHING
        length = np.sqrt(values[shown])
        return Filter(B @ vectors[:, shown] / length, 1.0 - 1.0 / np.sqrt(1.0 + values[shown]))


@dataclass(frozen=True)
class Filter:
    """The inverse square root of a covariance I + B V B', as the part that it takes of each direction of B.

    Attributes
    ----------
    directions
        ``(k, r)``, orthonormal.
    taken
        ``(r,)``, from 0 to 1.
    """

    directions: Array
    taken: Array

    def __call__(self, values: Array) -> Array:
        """Columns ``(k, c)`` without the level: noise of unit variance, independent."""
        return np.asarray(values - self.directions @ (self.taken[:, None] * (self.directions.T @ values)))


@dataclass(frozen=True, eq=False)
class Filters:
    """The filters of some channels of poses: F = 1 - Q T Q' for the entries of all of them.

    Q are the orthonormal directions, T the parts taken, so that F is symmetric. R directions in all.

    Attributes
    ----------
    parts
        The entries of each channel, and their filter.
    """

    parts: tuple[tuple[slice, Filter], ...]

    @property
    def taken(self) -> Array:
        """T ``(R,)``, channel after channel."""
        return np.concatenate([np.zeros(0), *(f.taken for _, f in self.parts)])

    def shares(self, columns: Array | sparse.csr_matrix) -> Array:
        """Q' columns ``(R, …)``, of columns ``(M, …)``; the entries may be followed by others."""
        own = (f.directions.T @ columns[own] for own, f in self.parts)
        return np.concatenate([np.zeros((0, *columns.shape[1:])), *own])

    def summed(self, sums: sparse.csr_matrix) -> Array:
        """Q summed ``(groups, R)``: by weighted sums ``(groups, M)`` of the entries."""
        own = (sums[:, own] @ f.directions for own, f in self.parts)
        return np.hstack([np.zeros((sums.shape[0], 0)), *own])

    def __call__(self, columns: Array) -> Array:
        """Take the level from columns ``(M, k)``, in place."""
        for own, without in self.parts:
            for start in range(0, columns.shape[1], FILTERED_AT_ONCE):
                some = slice(start, start + FILTERED_AT_ONCE)
                columns[own, some] = without(columns[own, some])
        return columns


def waves_of(rows: Rows, entry: Integers, shown: Array | None = None) -> Waves:
    """The waves of one channel's numbers in the rows ``entry`` ``(k,)``.

    Each session has a level of its own, and so has what comes after a pause that is longer than all that was measured.
    Poses are counted by visits, logs by time. ``shown`` ``(k,)``: how much of the level each number shows; None: all.
    """
    count, pieces = len(entry), list[tuple[Integers, Array]]()
    for s in np.unique(rows.session[entry]):
        own = np.flatnonzero(rows.session[entry] == s)
        if rows.kind.points:
            which, number = in_time(rows, entry[own])
            pieces.append((own, number[which].astype(float)))
            continue
        time, which = np.unique(rows.constants.time[entry[own]], return_inverse=True)
        step = np.diff(time) / (np.median(np.diff(time)) if len(time) > 1 else 1.0)
        begins = np.r_[0, np.cumsum(step > count)]
        at = np.r_[0.0, np.cumsum(step)]
        pieces += [(own[begins[which] == k], at[which][begins[which] == k]) for k in range(begins[-1] + 1)]
    return Waves.of(count, pieces, shown)


def in_time(rows: Rows, index: Integers) -> tuple[Integers, Integers]:
    """Visit of each of the rows ``index`` ``(k,)`` of a session, and place in time of each visit ``(visits,)``."""
    _, visit = np.unique(rows.unit[index], return_inverse=True)
    count = np.bincount(visit)
    time = np.bincount(visit, rows.constants.time[index]) / count
    return visit, np.argsort(np.argsort(time, kind="stable"))


@dataclass(frozen=True)
class Wander:
    """The slow noise that some channels show.

    Attributes
    ----------
    level
        Its variance is the upper limit of a one-sided confidence interval. A log has few independent stretches of a
        slow level, so the likeliest variance may be much too small. Slow changes would then look significant by chance.
    gain
        Twice the gain of the log likelihood by a random walk over white noise.
    """

    level: Level
    gain: float


def wander_of(
    waves: Sequence[Waves], residuals: Sequence[Array], columns: Sequence[Array], *, flickers: bool
) -> Wander | None:
    """The level that some channels have, each its own, of one variance and power; None if it is not significant.

    Parameters
    ----------
    waves
        Of each channel.
    residuals, columns
        For each channel the whitened numbers ``(k,)``, and the p regressors that may explain them ``(k, p)``.
    flickers
        Whether the level may be flicker noise instead of a random walk.

    Returns
    -------
    Wander or None
        Found if the likelihood ratio of a random walk is significant at :data:`WANDER_FALSE_ALARMS`. Flicker noise may
        imitate what a model lacks at the frequencies of the motion. But of its own gain a random walk has nearly all,
        so that it is only an alternative where this holds.
    """
    likelihood = _Likelihood.of(waves, residuals, columns)
    if likelihood.freedom < 2:
        return None
    white = likelihood.minus_two_log(None)
    by_power = {RANDOM_WALK: [likelihood.minus_two_log(Level(v, RANDOM_WALK)) for v in VARIANCES]}
    gain = white - min(by_power[RANDOM_WALK])
    if not gain > stats.chi2.isf(2.0 * WANDER_FALSE_ALARMS, 1):
        return None
    if flickers:
        flicker = [likelihood.minus_two_log(Level(v, FLICKER)) for v in VARIANCES]
        if gain >= SEEN_BY_A_WALK * (white - min(flicker)):
            by_power[FLICKER] = flicker
    power = min(by_power, key=lambda p: min(by_power[p]))
    return Wander(Level(_upper_limit(by_power[power]), power), gain)


@dataclass(frozen=True)
class _Channel:
    """What the likelihood needs of a channel's numbers W ``(k, m)`` and waves B ``(k, w)``."""

    waves: Waves
    gram: Array  # B'B (w, w)
    shared: Array  # B'W (w, m)

    def part(self, level: Level) -> tuple[Array, float]:
        """What a level takes of W'W ``(m, m)``, and the logarithm of the covariance's determinant."""
        size = np.sqrt(level.of_waves(self.waves.order, self.waves.share))
        lower = linalg.cholesky(np.eye(len(size)) + size[:, None] * self.gram * size, lower=True, check_finite=False)
        taken = linalg.solve_triangular(lower, size[:, None] * self.shared, lower=True, check_finite=False)
        return taken.T @ taken, 2.0 * float(np.sum(np.log(np.diag(lower))))


@dataclass(frozen=True)
class _Likelihood:
    """The restricted likelihood of channels' numbers, beside regressors."""

    channels: tuple[_Channel, ...]
    moments: Array  # W'W (m, m) of all channels: of a basis of the regressors, and of the numbers
    freedom: int

    @staticmethod
    def of(waves: Sequence[Waves], residuals: Sequence[Array], columns: Sequence[Array]) -> _Likelihood:
        """Parameters as of :func:`wander_of`."""
        basis = _basis(np.vstack(columns))
        whole = np.c_[basis, np.concatenate(residuals)]
        parts = np.split(whole, np.cumsum([len(r) for r in residuals])[:-1])
        channels = (_Channel(w, w.columns.T @ w.columns, w.columns.T @ x) for w, x in zip(waves, parts, strict=True))
        return _Likelihood(tuple(channels), whole.T @ whole, len(whole) - basis.shape[1])

    def minus_two_log(self, level: Level | None) -> float:
        """-2 log of the restricted likelihood, up to a constant."""
        moments, spread = self.moments.copy(), 0.0
        if level is not None:
            for channel in self.channels:
                taken, logs = channel.part(level)
                moments -= taken
                spread += logs
        # The factor is of [Q r]: its last diagonal entry is the length of r outside Q, the others give det Q'Q.
        length = np.maximum(np.abs(np.diag(_factor(moments))), 1e-150)
        determinant = 2.0 * float(np.sum(np.log(length[:-1])))
        return float(self.freedom * 2.0 * np.log(length[-1]) + spread + determinant)


def _upper_limit(minus_two_log: Sequence[float]) -> float:
    """The largest variance that the likelihood ratio does not reject at :data:`UPPER_LIMIT_CHANCE`, one-sided.

    ``minus_two_log``: -2 log of the likelihood at each of :data:`VARIANCES`; splines in between.
    """
    at = np.log10(VARIANCES)
    fine = np.linspace(at[0], at[-1], FINE_STEPS)
    value = interpolate.CubicSpline(at, minus_two_log)(fine)
    allowed = value <= value.min() + stats.chi2.isf(2.0 * UPPER_LIMIT_CHANCE, 1)
    return float(10.0 ** fine[allowed].max())


def _basis(columns: Array) -> Array:
    """An orthonormal basis ``(M, k)`` of the columns ``(M, p)``; linearly dependent columns are left out."""
    size = np.linalg.norm(columns, axis=0)
    if not np.any(size > 0.0):
        return np.zeros((len(columns), 0))
    Q, R, _ = linalg.qr(columns[:, size > 0.0] / size[size > 0.0], mode="economic", pivoting=True)
    return np.asarray(Q, dtype=float)[:, np.abs(np.diag(R)) > INDEPENDENT]


def _factor(moments: Array) -> Array:
    """Upper triangular factor R ``(p, p)``, RᵀR = ``moments``; these are positive definite up to rounding errors."""
    try:
        return np.asarray(linalg.cholesky(moments, check_finite=False))
    except linalg.LinAlgError:  # a column that the random-walk level reproduces completely
        values, vectors = np.linalg.eigh(moments)
        return np.asarray(np.linalg.qr(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T, mode="r"))
