"""Random-walk noise of a reading, such as the drift of a sensor's zero or of a tracker: the local level model.

Besides white noise, a channel has a level that is a random walk: y_i = l_i + e_i, l_i = l_{i-1} + w_i, where w has the
variance q per step in units of the variance of e. The innovations are independent: the difference of each number to its
prediction from the numbers before it, over the standard deviation of this difference. They are linear in y, so residual
and Jacobian pass the same filter. A column that changes as slowly as the level then explains little. The variance q is
estimated by restricted likelihood, with everything that may explain the residual as regressors.

Sources: Durbin & Koopman, Time Series Analysis by State Space Methods (2012), chapter 2 (local level model); Patterson
& Thompson, Recovery of inter-block information when block sizes are unequal, Biometrika 58, 1971 (restricted
likelihood); Self & Liang, J. Am. Stat. Assoc. 82, 1987 (likelihood ratio for a variance that may be zero: half a
chi-square with 1 degree of freedom).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import interpolate, linalg, stats

from clampid.stages.presliding import recurrence
from clampid.stages.rows import Array, Integers, Rows

__all__ = ["WANDER_FALSE_ALARMS", "Course", "Filter", "Wander", "course_of", "in_time", "wander_of"]

WANDER_FALSE_ALARMS = 0.01  # probability that a random walk is found in a reading without one
UPPER_LIMIT_CHANCE = 0.05  # probability that q exceeds its upper limit; 9 % in logs of some hundred rows
FINE_STEPS = 1000  # points of the interpolated likelihood
STEP_VARIANCES = (0.0, *(float(10.0**k) for k in np.arange(-7.0, 0.6, 0.5)))
INDEPENDENT = 1e-8  # of a column's length: with a smaller part outside the other columns it is linearly dependent


@dataclass(frozen=True)
class Course:
    """The order in time of a channel's numbers, and the steps of the random walk between them.

    Attributes
    ----------
    order
        Indices of the numbers in their order in time ``(k,)``.
    steps
        Steps since the number before ``(k,)``. The first number of a session has as many steps as the whole course.
    shown
        How much of the level each number shows ``(k,)``; None: all of it.
    """

    order: Integers
    steps: Array
    shown: Array | None = None

    def innovations(self, values: Array, wander: float) -> tuple[Array, Array]:
        """Innovations ``(k, c)`` of columns ``values`` ``(k, c)``, and logarithms of their variances ``(k,)``.

        ``wander``: variance of the level per step, in units of the variance of a number.
        """
        found = self.filter(wander)
        return found(values), np.log(found.variance)

    def filter(self, wander: float) -> Filter:
        """What makes innovations of columns, for one variance per step."""
        shown = (np.ones(len(self.order)) if self.shown is None else self.shown)[self.order]
        gains, spreads, variance, wander = list[float](), list[float](), 0.0, float(wander)
        # Plain numbers: those of numpy take three times as long one by one.
        for step, share in zip(self.steps.tolist(), shown.tolist(), strict=True):
            variance += wander * step
            larger = share * share * variance + 1.0
            gains.append(variance * share / larger)
            spreads.append(larger)
            variance /= larger  # (1 - gain share) variance
        return Filter(self.order, shown, np.array(gains), np.array(spreads))


@dataclass(frozen=True)
class Filter:
    """The Kalman filter of a local level, which predicts each number from those before it.

    Attributes
    ----------
    order
        Indices of the numbers in their order in time ``(k,)``; all others are in this order.
    shown
        How much of the level each number shows ``(k,)``.
    gain
        Change of the level by each number ``(k,)``, per unit of what was not predicted.
    variance
        Variance ``(k,)`` of what was not predicted, in units of that of a number.
    """

    order: Integers
    shown: Array
    gain: Array
    variance: Array

    def __call__(self, values: Array) -> Array:
        """Innovations ``(k, c)`` of columns ``values`` ``(k, c)``, of unit variance."""
        x = values[self.order]
        level = recurrence((1.0 - self.gain * self.shown)[:, None], self.gain[:, None] * x)
        x[1:] -= self.shown[1:, None] * level[:-1]
        x /= np.sqrt(self.variance)[:, None]
        out = np.empty_like(x)
        out[self.order] = x
        return out


def course_of(rows: Rows, entry: Integers, shown: Array | None = None) -> Course:
    """The course of one channel's numbers in the rows ``entry`` ``(k,)``, and how they show its level.

    In poses, a step is one visit. In logs, a step is the median time between two numbers.
    """
    time, count = rows.constants.time[entry], len(entry)
    if count == 0:
        return Course(np.zeros(0, dtype=np.int64), np.zeros(0))
    if rows.kind.points:
        visit = np.zeros(count, dtype=np.int64)
        for s in np.unique(rows.session[entry]):
            own = rows.session[entry] == s
            which, number = in_time(rows, entry[own])
            visit[own] = number[which]
        order = np.lexsort((entry, visit, rows.session[entry]))
        steps = np.diff(visit[order], prepend=0).astype(float)
        whole = float(visit.max() + 1)
    else:
        order = np.lexsort((entry, time, rows.session[entry]))
        between = np.diff(time[order], prepend=time[order[0]])
        usual = float(np.median(between[between > 0.0])) if np.any(between > 0.0) else 1.0
        steps, whole = np.maximum(between / usual, 0.0), float(count)
    begins = np.diff(rows.session[entry][order], prepend=-1) != 0
    steps = np.where(begins, whole, np.minimum(steps, whole))
    return Course(order, steps, shown)


def in_time(rows: Rows, index: Integers) -> tuple[Integers, Integers]:
    """Visit of each of the rows ``index`` ``(k,)`` of a session, and place in time of each visit ``(visits,)``."""
    _, visit = np.unique(rows.unit[index], return_inverse=True)
    count = np.bincount(visit)
    time = np.bincount(visit, rows.constants.time[index]) / count
    return visit, np.argsort(np.argsort(time, kind="stable"))


class Wander(NamedTuple):
    """The random walk of a level.

    Attributes
    ----------
    variance
        Upper limit of a one-sided confidence interval of the variance per step, in units of the variance of a number.
        A log has few independent stretches of a slow level, so the likeliest variance may be much too small. Slow
        changes would then look significant by chance.
    gain
        Twice the gain of the log likelihood over no random walk.
    """

    variance: float
    gain: float


def wander_of(courses: Sequence[Course], residuals: Sequence[Array], columns: Sequence[Array]) -> Wander:
    """The random walk that the levels of some channels share; zero if it is not significant.

    Parameters
    ----------
    courses
        Course of each channel.
    residuals, columns
        For each channel the whitened numbers ``(k,)``, and the p regressors that may explain them ``(k, p)``.

    Returns
    -------
    Wander
        Not zero only if the likelihood ratio is significant at :data:`WANDER_FALSE_ALARMS`.
    """
    basis = _basis(np.vstack(columns))
    whole = np.c_[basis, np.concatenate(residuals)]
    freedom = len(whole) - basis.shape[1]
    if freedom < 2:
        return Wander(0.0, 0.0)
    parts = np.split(whole, np.cumsum([len(r) for r in residuals])[:-1])

    def minus_two_log(wander: float) -> float:
        """-2 log of the restricted likelihood, up to a constant."""
        moments, spread = np.zeros((whole.shape[1], whole.shape[1])), 0.0
        for course, part in zip(courses, parts, strict=True):
            found, logs = course.innovations(part, wander)
            moments += found.T @ found
            spread += float(logs.sum())
        # The factor is of [Q r]: its last diagonal entry is the length of r outside Q, the others give det Q'Q.
        length = np.maximum(np.abs(np.diag(_factor(moments))), 1e-150)
        determinant = 2.0 * float(np.sum(np.log(length[:-1])))
        return float(freedom * 2.0 * np.log(length[-1]) + spread + determinant)

    values = [minus_two_log(wander) for wander in STEP_VARIANCES]
    best = int(np.argmin(values))
    gain = values[0] - values[best]
    if not gain > stats.chi2.isf(2.0 * WANDER_FALSE_ALARMS, 1):
        return Wander(0.0, 0.0)
    return Wander(_upper_limit(values[1:]), gain)


def _upper_limit(minus_two_log: Sequence[float]) -> float:
    """The largest variance that the likelihood ratio does not reject at :data:`UPPER_LIMIT_CHANCE`, one-sided.

    ``minus_two_log``: -2 log of the likelihood at each of :data:`STEP_VARIANCES` but the first; splines in between.
    """
    at = np.log10(STEP_VARIANCES[1:])
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
