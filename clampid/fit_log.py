"""The fit of a torque log by passes over its windows: the results of `clampid.fit.fit`, without holding the log.

For effects linear in their parameters: one pass sums the normal equations, another finds what the residual says of
outliers and noise; the third and fifth sum the prewhitened ones. Source of the reduction: Golub & Van Loan, Matrix
Computations (2013), section 5.3.8 (normal equations); they are balanced before they are solved, as everywhere here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import stats

from clampid.fit import OUTLIER_PASSES, OUTLIER_RATE, OUTLIER_SHARE, FitError
from clampid.moments import Moments, minimise
from clampid.noise import NORMAL
from clampid.prewhitening import ORDER, Predictors, Whitener, autocorrelation, lag_products
from clampid.stages.log_design import Block, Channel, LogDesign
from clampid.stages.rows import Array, Bools, Integers
from experiments.signals import medians

__all__ = ["LogFit", "LogNoise", "Residuals", "fit_log", "residuals", "summed"]

ENOUGH = 20  # rows of a motor from which a median says what an outlier is


@dataclass(frozen=True)
class LogNoise:
    """Standard deviations of the motors ``(n,)``, Nm, and its autocorrelations; none for white noise."""

    sigma: Array
    autocorrelations: tuple[Array, ...] = ()

    @cached_property
    def predictors(self) -> tuple[Predictors, ...]:
        """What whitens each motor's noise."""
        return tuple(Predictors(a) for a in self.autocorrelations)


@dataclass(frozen=True)
class LogFit:
    """A fitted log.

    Attributes
    ----------
    moments
        The prewhitened sums at the solution.
    noise
        What weighted the rows.
    outliers
        Rows of the log rejected, in order.
    """

    moments: Moments
    noise: LogNoise
    outliers: Integers


def used_of(channel: Channel, folds: Bools, outliers: Integers) -> tuple[Integers | slice, int]:
    """Which of a channel's rows are in the folds ``(F,)`` and not rejected; how many of them the window before has."""
    if folds.all() and not len(outliers):
        return slice(None), channel.own
    inside = folds[channel.fold]
    if len(outliers):
        inside = inside & ~np.isin(channel.row, outliers, assume_unique=True)
    used = np.flatnonzero(inside)
    return used, int(np.searchsorted(used, channel.own))


def fit_log(design: LogDesign, folds: Bools, precision: Array, mean: Array, size: Array, start: Array) -> LogFit:
    """Fit the rows of some folds ``(F,)``; weighting and rejection as in `clampid.fit.fit`.

    Parameters
    ----------
    precision, mean
        The prior: ``(P + K, P + K)`` and ``(P + K,)``, SI.
    size, start
        Reasonable sizes and start ``(P + K,)``, SI.

    Raises
    ------
    FitError
        There are no rows to fit, or the model gives no finite prediction.
    """
    white = LogNoise(np.ones(design.n))
    outliers = np.zeros(0, dtype=np.int64)

    def solved(noise: LogNoise, theta: Array) -> Moments:
        total = summed(design, folds, outliers, noise)[0]
        if not total.count:
            raise FitError("free_air: no rows can be used: no motor moves, or every row is an outlier")
        if not np.isfinite(total.squares):
            raise FitError("free_air: the model gives no finite prediction; are the units right?")
        return minimise(total, theta, precision, mean, size)

    found = solved(white, start)
    rows = int(sum(folds[b.fold].sum() for b in design))
    for _ in range(OUTLIER_PASSES):
        bad = _outliers(design, folds, outliers, found.at)
        if not len(bad) or (len(bad) + len(outliers)) / rows > OUTLIER_SHARE:
            break
        outliers = np.union1d(outliers, bad)
        found = solved(white, found.at)
    noise = white
    for _ in range(2):
        noise = _learned(design, folds, outliers, found.at)
        found = solved(noise, found.at)
    return LogFit(found, noise, outliers)


def summed(
    design: LogDesign,
    folds: Bools,
    outliers: Integers,
    noise: LogNoise,
    part: Integers | None = None,
) -> dict[int, Moments]:
    """Whitened sums at zero parameters, of all rows or per part of the folds.

    Parameters
    ----------
    part
        ``(F,)``: which part each fold is of; by default all are of part 0.
    """
    parts = np.unique(part[folds]) if part is not None else np.zeros(1, dtype=np.int64)
    out = {int(p): Moments.none(design.parameters) for p in parts}
    for block in design:
        for c, channel in enumerate(block.channels):
            used, own = used_of(channel, folds, outliers)
            if own == channel.row[used].size:
                continue
            of = None if part is None else part[channel.fold[used]]
            both = channel.both[used]
            if noise.autocorrelations:
                both = _whitener(channel, used)(both, noise.predictors[c])
            if of is None:
                out[0].add(channel.columns, both[own:], noise.sigma[c])
                continue
            for p in np.unique(of[own:]):
                out[int(p)].add(channel.columns, both[own:][of[own:] == p], noise.sigma[c])
    return out


@dataclass(frozen=True)
class Residuals:
    """Residuals of one motor's rows that count in a window ``(k,)``, Nm; the first ``own`` are of the window before."""

    block: Block
    motor: int
    row: Integers
    stretch: Integers
    own: int
    values: Array


def residuals(
    design: LogDesign, folds: Bools, outliers: Integers, theta: Array, part: Integers | None = None
) -> Iterator[list[Residuals]]:
    """Measured less predicted torques of the rows that count, window by window; of each, motor by motor.

    Parameters
    ----------
    theta
        ``(P + K,)``; or ``(parts, P + K)``, where folds ``(F,)`` are of several parts with parameters of their own.
    """
    for block in design:
        found = []
        for c, channel in enumerate(block.channels):
            used, own = used_of(channel, folds, outliers)
            if part is None:
                predicted = channel.both[:, :-1] @ theta[channel.columns]
            else:
                every = channel.both[:, :-1] @ theta[:, channel.columns].T
                predicted = every[np.arange(len(every)), part[channel.fold]]
            values = (channel.both[:, -1] - predicted)[used]
            found.append(Residuals(block, c, channel.row[used], channel.stretch[used], own, values))
        yield found


def _outliers(design: LogDesign, folds: Bools, outliers: Integers, theta: Array) -> Integers:
    """Rows far beyond what a clean table would show, as in `clampid.fit`."""
    count, largest = np.zeros((2, design.n))

    def sizes() -> Iterator[list[Array]]:
        count[:], largest[:] = 0.0, 0.0
        for found in residuals(design, folds, outliers, theta):
            piece = [np.abs(r.values[r.own :]) for r in found]
            count[:] += [len(p) for p in piece]
            np.maximum(largest, [p.max(initial=0.0) for p in piece], out=largest)
            yield piece

    scale = NORMAL * medians(sizes)
    limit = np.maximum(np.sqrt(stats.chi2.isf(OUTLIER_RATE / np.maximum(count, 1), 1)), 4.0)
    limit = np.where(count >= ENOUGH, limit * np.fmax(scale, 1e-12), np.inf)
    if not np.any(largest > limit):
        return np.zeros(0, dtype=np.int64)
    bad = [
        r.row[r.own :][np.abs(r.values[r.own :]) > limit[r.motor]]
        for found in residuals(design, folds, outliers, theta)
        for r in found
    ]
    return np.unique(np.concatenate(bad))


def _learned(design: LogDesign, folds: Bools, outliers: Integers, theta: Array) -> LogNoise:
    """Scale and autoregression of each motor's residual, as in `clampid.noise.learn_noise`."""
    products, pairs = np.zeros((2, design.n, ORDER + 1))
    for r in (r for found in residuals(design, folds, outliers, theta) for r in found):
        sums, counts = lag_products(r.values, r.row, r.stretch, r.own)
        products[r.motor] += sums
        pairs[r.motor] += counts
    sigma = np.maximum(np.sqrt(products[:, 0] / np.maximum(pairs[:, 0], 1)), 1e-12)
    autocorrelations = tuple(autocorrelation(p, k) for p, k in zip(products, pairs, strict=True))
    return LogNoise(np.where(pairs[:, 0] > 0, sigma, 1.0), autocorrelations)


def _whitener(channel: Channel, used: Integers | slice) -> Whitener:
    """The filter of some of a channel's rows."""
    if isinstance(used, slice):
        return channel.whitener
    return Whitener(channel.row[used], channel.stretch[used])
