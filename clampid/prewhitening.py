"""Prewhitening of logs: how noise remembers itself, and the filter that takes that out, across rows that do not count.

The noise of a torque log is taken for autoregressive of order 12. A row is predicted from the latest twelve rows before
it that count; between a move and the next, rows of rest and of acceleration do not, and the noise outlasts them. Where
no row is missing that is the ordinary autoregressive filter. Unwhitened, ordinary tests fire on any clean log; with the
filter begun anew after every gap, standard errors come out a tenth to a third too small.
Source: Brockwell & Davis, Time Series: Theory and Methods (1991), sections 5.1 (best linear predictors), 8.1 and 12.3
(missing values).
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from clampid.stages.rows import Array, Bools, Integers

__all__ = ["ORDER", "REACH", "autocorrelation", "lag_products", "whitener"]

ORDER = 12
REACH = 64  # rows back that a prediction may look, so that windows of a log need to overlap by no more
ENOUGH_PAIRS = 100  # products of which a mean tells a correlation to a tenth
LEAST = 1e-6  # of the variance, that a prediction leaves at least: torques are printed with finitely many digits


def lag_products(x: Array, row: Integers, stretch: Integers, own: int = 0) -> tuple[Array, Array]:
    """Sums of products of residuals that are 0 … 12 rows apart, with no row missing between, and how many there are.

    Parameters
    ----------
    x
        ``(k, m)`` or ``(k,)``: residuals of the rows that count; the products of m numbers add.
    row, stretch
        ``(k,)``: which rows of the log, and of which stretches, as `whitener` takes them.
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
    out = np.zeros(REACH + 1)
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
    for k in range(len(a) + 1, REACH + 1):
        out[k] = a @ out[k - len(a) : k][::-1]
    return out


def whitener(row: Integers, stretch: Integers, correlation: Array) -> sparse.csr_matrix:
    """The filter as a matrix ``(k, k)`` that turns such noise into white noise of the same variance.

    Parameters
    ----------
    row
        Which rows of the log count ``(k,)``, in order.
    stretch
        Of which stretch of the log they are ``(k,)``: nothing is remembered where the clock breaks off.
    correlation
        Autocorrelation ``(65,)``.
    """
    count = len(row)
    index = np.arange(count)[:, None] - np.arange(1, ORDER + 1)  # (k, 12): the rows before
    absent = index < 0
    index[absent] = 0
    lag = row[:, None] - row[index]
    lag[absent | (lag > REACH) | (stretch[:, None] != stretch[index])] = 0
    plain = lag[:, -1] == ORDER
    kinds, of = np.unique(lag[~plain], axis=0, return_inverse=True)
    kinds = np.concatenate([np.arange(1, ORDER + 1)[None], kinds])
    kind = np.zeros(count, dtype=np.int64)
    kind[~plain] = 1 + of.ravel()
    weights, variance = _predictors(kinds, correlation)
    table = np.c_[np.ones(len(kinds)), -weights] / np.sqrt(variance)[:, None]
    columns = np.concatenate([np.arange(count)[:, None], index], axis=1).astype(np.int32)
    where = np.arange(0, (count + 1) * (ORDER + 1), ORDER + 1, dtype=np.int32)
    return sparse.csr_matrix((table[kind].ravel(), columns.ravel(), where), shape=(count, count))


def _predictors(lags: Integers, correlation: Array) -> tuple[Array, Array]:
    """Best linear predictors ``(u, 12)`` from rows so far back (0: none), and the variance ``(u,)`` they leave."""
    there = lags > 0
    among = correlation[np.abs(lags[:, :, None] - lags[:, None, :])]
    both: Bools = there[:, :, None] & there[:, None, :]
    among = np.where(both, among, np.eye(ORDER))
    towards = np.where(there, correlation[lags], 0.0)
    weights = np.linalg.solve(among, towards[:, :, None])[:, :, 0]
    return weights, np.maximum(1.0 - np.sum(weights * towards, axis=1), LEAST)
