"""A reading that wanders: noise whose mean drifts away and does not come back, as of a sensor's zero or a tracker.

Beside its white noise a channel has a level that walks at random: y_i = l_i + e_i, l_i = l_{i-1} + w_i, with w of the
variance q per step in units of e's. Its innovations are independent: what a number is off the level that those before
it foretell, over the standard deviation of that. They are linear, so that residual and columns pass the same filter,
and a column that only wanders along explains little. How large q is, is estimated by restricted likelihood, beside
everything that may explain the residual.

Sources: Durbin & Koopman, Time Series Analysis by State Space Methods (2012), chapter 2 (local level model); Patterson
& Thompson, Recovery of inter-block information when block sizes are unequal, Biometrika 58, 1971 (its likelihood);
Self & Liang, J. Am. Stat. Assoc. 82, 1987 (its ratio where a variance may be zero: half a chi-square of 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import interpolate, linalg, stats

from clampid.stages.presliding import recurrence
from clampid.stages.rows import Array, Integers, Rows

__all__ = ["WANDER_FALSE_ALARMS", "Course", "Wander", "course_of", "in_time", "wander_of"]

WANDER_FALSE_ALARMS = 0.01  # chance that a reading that does not wander is said to
UPPER_LIMIT_CHANCE = 0.05  # that a level wanders more than it is taken to; 9 % of logs of some hundred rows
FINE_STEPS = 1000  # of the likelihood's curve
STEP_VARIANCES = (0.0, *(float(10.0**k) for k in np.arange(-7.0, 0.6, 0.5)))
INDEPENDENT = 1e-8  # of a column's length, beyond the others


@dataclass(frozen=True)
class Course:
    """The order in which a channel's numbers were measured, and how much its level may wander before each.

    Attributes
    ----------
    order
        ``(k,)``: places of the numbers in time.
    steps
        ``(k,)``: steps since the one before; of the first, and after a new session, those of the whole course.
    """

    order: Integers
    steps: Array

    def innovations(self, values: Array, wander: float) -> tuple[Array, Array]:
        """Columns ``(k, c)`` less what those before them foretell, over its error; and logarithms of the errors²."""
        count, variance = len(self.order), 0.0
        gain, spread = np.zeros(count), np.zeros(count)
        for i, step in enumerate(self.steps):
            variance += wander * step
            spread[i] = variance + 1.0
            gain[i] = variance / spread[i]
            variance = gain[i]  # (1 - gain) variance = variance / spread
        x = values[self.order]
        level = recurrence(1.0 - gain[:, None], gain[:, None] * x)
        out = np.empty_like(x)
        out[self.order] = (x - np.vstack([np.zeros((1, x.shape[1])), level[:-1]])) / np.sqrt(spread)[:, None]
        return out, np.log(spread)


def course_of(rows: Rows, entry: Integers) -> Course:
    """The course of numbers of the rows ``entry`` ``(k,)`` of one channel.

    Steps are visits of poses, between two of a session always one; of logs the usual time between two numbers.
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
    return Course(order, steps)


def in_time(rows: Rows, index: Integers) -> tuple[Integers, Integers]:
    """Of each of some rows of a session ``(k,)`` its visit, and of each visit its number in the order of time."""
    _, visit = np.unique(rows.unit[index], return_inverse=True)
    count = np.bincount(visit)
    time = np.bincount(visit, rows.constants.time[index]) / count
    return visit, np.argsort(np.argsort(time, kind="stable"))


class Wander(NamedTuple):
    """By how much a level wanders at most, variance per step over that of a number; twice the log likelihood it gains.

    At most: the upper limit of a one-sided confidence interval. A log has few independent stretches of a slow level, so
    that its likeliest variance may be much too small, and what is slow would then stand out of it by chance.
    """

    variance: float
    gain: float


def wander_of(courses: Sequence[Course], residuals: Sequence[Array], columns: Sequence[Array]) -> Wander:
    """By how much the level of some channels wanders; nothing where none is seen to.

    Parameters
    ----------
    courses
        Of the channels, which share it.
    residuals, columns
        Their whitened numbers ``(k,)``, and all that may explain them ``(k, p)``, the same columns in each channel.

    Returns
    -------
    Wander
        The likeliest one, if the likelihood ratio against none is larger than chance gives once in a hundred times.
    """
    basis = _basis(np.vstack(columns))
    whole = np.c_[basis, np.concatenate(residuals)]
    freedom = len(whole) - basis.shape[1]
    if freedom < 2:
        return Wander(0.0, 0.0)
    parts = np.split(whole, np.cumsum([len(r) for r in residuals])[:-1])

    def unlikely(wander: float) -> float:
        """-2 log of the restricted likelihood, but for a constant."""
        moments, spread = np.zeros((whole.shape[1], whole.shape[1])), 0.0
        for course, part in zip(courses, parts, strict=True):
            found, logs = course.innovations(part, wander)
            moments += found.T @ found
            spread += float(logs.sum())
        # Of [Q r] the factor's last diagonal entry is the length of what Q leaves of r, the others give det Q'Q.
        length = np.maximum(np.abs(np.diag(_factor(moments))), 1e-150)
        determinant = 2.0 * float(np.sum(np.log(length[:-1])))
        return float(freedom * 2.0 * np.log(length[-1]) + spread + determinant)

    values = [unlikely(wander) for wander in STEP_VARIANCES]
    best = int(np.argmin(values))
    gain = values[0] - values[best]
    if not gain > stats.chi2.isf(2.0 * WANDER_FALSE_ALARMS, 1):
        return Wander(0.0, 0.0)
    return Wander(_upper_limit(values[1:]), gain)


def _upper_limit(unlikely: Sequence[float]) -> float:
    """The largest variance that the likelihood ratio does not refuse at :data:`UPPER_LIMIT_CHANCE`, one-sided.

    ``unlikely``: -2 log of the likelihood at each of :data:`STEP_VARIANCES` but the first, between which it is smooth.
    """
    at = np.log10(STEP_VARIANCES[1:])
    fine = np.linspace(at[0], at[-1], FINE_STEPS)
    value = interpolate.CubicSpline(at, unlikely)(fine)
    allowed = value <= value.min() + stats.chi2.isf(2.0 * UPPER_LIMIT_CHANCE, 1)
    return float(10.0 ** fine[allowed].max())


def _basis(columns: Array) -> Array:
    """An orthonormal basis ``(M, k)`` of the columns: of those that are the others' sum a likelihood counts none."""
    size = np.linalg.norm(columns, axis=0)
    if not np.any(size > 0.0):
        return np.zeros((len(columns), 0))
    Q, R, _ = linalg.qr(columns[:, size > 0.0] / size[size > 0.0], mode="economic", pivoting=True)
    return np.asarray(Q, dtype=float)[:, np.abs(np.diag(R)) > INDEPENDENT]


def _factor(moments: Array) -> Array:
    """The Cholesky factor, upper, of moments that are positive definite but for rounding."""
    try:
        return np.asarray(linalg.cholesky(moments, check_finite=False))
    except linalg.LinAlgError:  # a column that a wandering level follows all the way
        values, vectors = np.linalg.eigh(moments)
        return np.asarray(np.linalg.qr(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T, mode="r"))
