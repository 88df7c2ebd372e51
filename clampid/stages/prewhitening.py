"""Prewhitening of logs: the autocorrelation of their noise, and its filter, across rows that do not count.

The noise of a torque log is modelled as autoregressive of order 12. Rows closer than half the window of speeds and
accelerations are averaged first, residual and columns alike (`Grouping`). Otherwise twelve rows of a 5 kHz log would
span 2 ms, and the filter would weigh the fit by changes faster than the design can follow. Each row is predicted from
the latest twelve rows before it that count: rows of rest and of acceleration between two moves do not count, but the
noise is correlated across them. Without missing rows this is the ordinary autoregressive filter. Unwhitened, ordinary
tests give false alarms on any clean log; with a filter restarted after every gap, standard errors are a tenth to a
third too small.
Source: Brockwell & Davis, Time Series: Theory and Methods (1991), sections 5.1 (best linear predictors), 8.1 and 12.3
(missing values); the same filter and decimation of both sides of the model: Khalil & Dombre, Modeling, Identification
and Control of Robots (2002), chapter 12.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.linalg.blas import daxpy

from clampid.stages.rows import Array, Integers
from experiments.signals import solve_definite

__all__ = ["LONGEST_LAG", "ORDER", "Grouping", "Predictors", "Whitener", "autocorrelation", "lag_products", "settled"]

ORDER = 12
LONGEST_LAG = 64  # rows back that a prediction may look, so that windows of a log need to overlap by no more
CACHED = 1 << 14  # numbers that are filtered at once: they should stay in the processor's cache
ENOUGH_PAIRS = 100  # products whose mean determines a correlation to 0.1
MOST_KINDS = 1 << 15  # of predictors that are kept
WEIGHTS_SETTLED = 0.5  # of a standard error: noise that changes by less when it is learned again changes no weight
LEAST = 1e-6  # of the variance, that a prediction leaves at least: torques are printed with finitely many digits

Kinds = npt.NDArray[np.uint64]
_PLAIN = np.array([(1 << ORDER) - 1], dtype=np.uint64)  # the twelve rows directly before


@dataclass(frozen=True)
class Grouping:
    """Rows that count, taken together ``together`` at a time: the means of those that follow each other.

    Groups begin at multiples of ``together`` among the rows of the log, so that they are the same whichever part of
    the log is looked at; one of which a row does not count is left out.

    Attributes
    ----------
    together
        Rows of a group.
    first
        ``(g,)``: place of each group's first row among those given.
    row, stretch
        ``(g,)``: number of the group, and of which stretch of the log it is; what `Whitener` and `lag_products` take.
    """

    together: int
    first: Integers
    row: Integers
    stretch: Integers

    @staticmethod
    def of(row: Integers, stretch: Integers, together: int) -> Grouping:
        """The groups of rows ``(k,)`` of a log, in order, and of its stretches ``(k,)``."""
        if together == 1:
            return Grouping(1, np.arange(len(row)), row, stretch)
        first = np.flatnonzero(row[: max(len(row) - together + 1, 0)] % together == 0)
        last = first + together - 1
        first = first[(row[last] - row[first] == together - 1) & (stretch[last] == stretch[first])]
        return Grouping(together, first, row[first] // together, stretch[first])

    def mean(self, values: Array) -> Array:
        """Means ``(g, …)`` over the groups of what the rows have ``(k, …)``."""
        if self.together == 1:
            return values
        out = values[self.first]
        for k in range(1, self.together):
            out += values[self.first + k]
        return np.asarray(out / self.together)

    def own(self, rows: int) -> int:
        """How many of the groups end before the row in the place ``rows``."""
        return int(np.searchsorted(self.first + self.together - 1, rows))


def lag_products(x: Array, row: Integers, stretch: Integers, own: int = 0) -> tuple[Array, Array]:
    """Sums of products of residuals that are 0 … 12 rows apart, with no row missing between, and how many there are.

    Parameters
    ----------
    x
        ``(k, m)`` or ``(k,)``: residuals of the rows that count; the products of m numbers add.
    row, stretch
        ``(k,)``: which rows of the log, and of which stretches, as `Whitener` takes them.
    own
        How many of the first rows only stand before the others: products whose later row is one of them do not count.

    Returns
    -------
    Array, Array
        ``(13,)`` each; what `autocorrelation` takes.
    """
    count = len(x)
    index = np.arange(count)
    begins = np.r_[True, (np.diff(row) != 1) | (np.diff(stretch) != 0)][:count]
    age = index - np.maximum.accumulate(np.where(begins, index, 0))
    pairs = np.cumsum(np.bincount(np.minimum(age[own:], ORDER), minlength=ORDER + 1)[::-1])[::-1]
    # Zeros between what does not follow each other make the products across vanish.
    place = index + ORDER * np.cumsum(begins)
    spaced = np.zeros((int(place[-1]) + 1 if count else 0, *x.shape[1:]))
    spaced[place] = x
    first = int(place[own]) if own < count else len(spaced)
    later = spaced[first:]
    products = [float(np.vdot(later, spaced[first - lag : len(spaced) - lag])) for lag in range(ORDER + 1)]
    return np.array(products), pairs.astype(np.float64)


def autocorrelation(products: Array, pairs: Array) -> Array:
    """Autocorrelation of lag 0 … 64 of the autoregression that products of residuals stand for.

    Parameters
    ----------
    products
        Sums of products of residuals of lag 0 … 12 within stretches ``(13,)``; their common scale does not matter.
    pairs
        How many products each sum has ``(13,)``. A move is a few dozen rows, of which a lag of twelve leaves half: sums
        alone would take the noise for half as persistent as it is.

    Returns
    -------
    Array
        ``(65,)``; of no more order than there are pairs for, and than makes means of unequal numbers of products an
        autocorrelation of anything. Levinson's and Durbin's recursion: Brockwell & Davis (1991), section 8.2.
    """
    out = np.zeros(LONGEST_LAG + 1)
    out[0] = 1.0
    if products[0] == 0:
        return out
    measured = products / np.maximum(pairs, 1.0)
    measured = measured / measured[0]
    a, variance = np.zeros(0), 1.0
    for k in range(1, ORDER + 1):
        reflection = (measured[k] - a @ measured[1:k][::-1]) / variance
        if pairs[k] < ENOUGH_PAIRS or variance * (1.0 - reflection**2) <= LEAST:
            break
        a = np.r_[a - reflection * a[::-1], reflection]
        variance *= 1.0 - reflection**2
        out[k] = measured[k]
    for k in range(len(a) + 1, LONGEST_LAG + 1):
        out[k] = a @ out[k - len(a) : k][::-1]
    return out


def settled(ratio: float, before: Array, after: Array, count: float) -> bool:
    """Whether a new estimate of the noise equals the old one within half of its standard error.

    Parameters
    ----------
    ratio
        Its standard deviation over what that was. Of ``count`` numbers it is known to 1/sqrt(2 count).
    before, after
        Autocorrelations ``(65,)``, known to 1/sqrt(count) or worse: Brockwell & Davis (1991), section 7.2.
    """
    if count <= 0:
        return True
    change = float(np.max(np.abs(after - before)[: ORDER + 1]))
    error = 1.0 / float(np.sqrt(count))
    return change < WEIGHTS_SETTLED * error and abs(ratio - 1.0) < WEIGHTS_SETTLED * error / 2.0**0.5


class Predictors:
    """The weights by which rows are predicted from those before, for noise of one autocorrelation ``(65,)``.

    Those once found are kept: gaps of a log are alike.
    """

    def __init__(self, correlation: Array) -> None:
        # Rows so far apart that nothing connects them have lags beyond 64.
        self._correlation = np.zeros((ORDER + 2) * (LONGEST_LAG + 1))
        self._correlation[: LONGEST_LAG + 1] = correlation
        self._known = np.zeros(0, dtype=np.uint64)
        self._weights = np.zeros((0, ORDER + 1))

    @property
    def plain(self) -> Array:
        """Weights ``(13,)`` of a row and of the twelve directly before it, none missing; as :meth:`of` gives them."""
        return np.asarray(self.of(_PLAIN, np.arange(1, ORDER + 1)[:, None])[0])

    def of(self, kinds: Kinds, lags: Integers) -> Array:
        """Weights ``(u, 13)`` of the row and of those before it: the row less its prediction, over what that leaves.

        Parameters
        ----------
        kinds
            ``(u,)``: which of the 64 rows before are looked at, one bit each; in order.
        lags
            ``(12, u)``: how far back those rows are.
        """
        place = np.minimum(np.searchsorted(self._known, kinds), max(len(self._known) - 1, 0))
        new = self._known[place] != kinds if len(self._known) else np.ones(len(kinds), dtype=bool)
        if new.any():
            if len(self._known) > MOST_KINDS:
                self._known, self._weights, new = self._known[:0], self._weights[:0], np.ones(len(kinds), dtype=bool)
            known = np.concatenate([self._known, kinds[new]])
            order = np.argsort(known, kind="stable")
            self._known = known[order]
            self._weights = np.concatenate([self._weights, self._found(lags[:, new])])[order]
            place = np.searchsorted(self._known, kinds)
        return self._weights[place]

    def _found(self, lags: Integers) -> Array:
        towards = self._correlation[lags]
        weights = solve_definite(self._correlation[np.abs(lags[:, None] - lags)], towards)
        left = np.maximum(1.0 - np.sum(weights * towards, axis=0), LEAST)
        return np.asarray((np.concatenate([np.ones((1, lags.shape[1])), -weights]) / np.sqrt(left)).T)


class Whitener:
    """The filter that turns such noise in certain rows of a log into white noise of the same variance.

    Parameters
    ----------
    row
        Which rows of the log count ``(k,)``, in order.
    stretch
        Of which stretch of the log they are ``(k,)``: nothing is remembered where the clock breaks off.
    """

    def __init__(self, row: Integers, stretch: Integers) -> None:
        count = len(row)
        plain = np.zeros(count, dtype=bool)
        plain[ORDER:] = (row[ORDER:] - row[:-ORDER] == ORDER) & (stretch[ORDER:] == stretch[:-ORDER])
        self._broken = np.flatnonzero(~plain)
        before = self._broken - np.arange(1, ORDER + 1)[:, None]  # (12, b): the rows before
        absent = before < 0
        before[absent] = 0
        lag = row[self._broken] - row[before]
        absent |= (lag > LONGEST_LAG) | (stretch[self._broken] != stretch[before])
        # Which of the 64 rows before are looked at, one bit each, says all of a predictor.
        bits = np.where(absent, np.uint64(0), np.uint64(1) << np.where(absent, 0, lag - 1).astype(np.uint64))
        self._kinds, first, self._kind = np.unique(bits.sum(axis=0), return_index=True, return_inverse=True)
        # A row that is not there is so far away from any other that nothing connects them.
        far = (LONGEST_LAG + 1) * np.arange(2, ORDER + 2)[:, None]
        self._lags = np.where(absent, far, lag)[:, first]
        self._columns = np.concatenate([self._broken[None], before]).T.astype(np.int32).ravel()

    def __call__(self, columns: Array, predictors: Predictors) -> Array:
        """Whitened columns ``(k, m)`` of those rows."""
        x = np.ascontiguousarray(columns, dtype=np.float64)
        width, filtered = x.shape[1], np.empty(x.shape)
        plain = predictors.plain
        broken = predictors.of(self._kinds, self._lags)
        # Rows are as far from each other in memory as in time, so that whole columns are shifted at once.
        flat, out = x.reshape(-1), filtered.reshape(-1)
        for at in range(0, flat.size, CACHED):
            piece = slice(at, min(at + CACHED, flat.size))
            np.multiply(flat[piece], plain[0], out=out[piece])
            for lag in range(1, ORDER + 1):
                shift = lag * width
                start = max(at, shift)
                if start < piece.stop:
                    daxpy(flat, out, n=piece.stop - start, a=plain[lag], offx=start - shift, offy=start)
        where = np.arange(0, self._columns.size + 1, ORDER + 1, dtype=np.int32)
        matrix = sparse.csr_matrix((broken[self._kind].ravel(), self._columns, where), (len(self._broken), len(x)))
        filtered[self._broken] = matrix @ x
        return filtered
