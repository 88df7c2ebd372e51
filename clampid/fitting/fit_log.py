"""The fit of a torque log by passes over its windows: the results of `fitting.fit`, without holding the log.

For effects linear in their parameters one pass sums the normal equations, another finds what the residual says of
outliers and noise, two where the log is long; then the prewhitened equations are summed, again if that changes the
noise, by parts, from which cross-validation has its fits too. Shape parameters take a pass for every step of damped
Gauss-Newton.
Source of the reduction: Golub & Van Loan, Matrix Computations (2013), section 5.3.8 (normal equations); they are
balanced before they are solved, as everywhere here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import stats

from clampid.fitting.descent import Limits, descend
from clampid.fitting.fit import OUTLIER_PASSES, OUTLIER_RATE, OUTLIER_SHARE
from clampid.fitting.leverage import root_of_inverse, share_left
from clampid.fitting.moments import LogPoint, Moments, minimise
from clampid.fitting.noise import NORMAL
from clampid.fitting.solve import FitError
from clampid.stages.log_design import Block, Channel, LogDesign
from clampid.stages.prewhitening import ORDER, Grouping, Predictors, Whitener, autocorrelation, lag_products, settled
from clampid.stages.rows import Array, Bools, Integers
from experiments.signals import medians

__all__ = [
    "LogFit",
    "LogNoise",
    "LogPrior",
    "Residuals",
    "fit_log",
    "learned",
    "residuals",
    "summed",
    "used_of",
    "weighted",
]

LEAST_ROWS_OF_A_MOTOR = 20  # rows of a motor from which a median says what an outlier is


@dataclass(frozen=True)
class LogNoise:
    """Standard deviations of the motors ``(n,)``, Nm, and its autocorrelations; none for white noise.

    Of logs that are logged more densely than their design can follow both are those of groups of rows.
    """

    sigma: Array
    autocorrelations: tuple[Array, ...] = ()
    counts: tuple[float, ...] = ()

    def settled(self, again: LogNoise) -> bool:
        """As `clampid.fitting.noise.Noise.settled`."""
        ratios = again.sigma / self.sigma
        channels = zip(ratios, self.autocorrelations, again.autocorrelations, again.counts, strict=True)
        return all(settled(*channel) for channel in channels)

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
    part
        ``(F,)``: into which parts the folds were divided, if they were.
    sums
        Part → the prewhitened sums over its rows, where the design is.
    """

    moments: Moments
    noise: LogNoise
    outliers: Integers
    part: Integers | None
    sums: Mapping[int, Moments]


def used_of(channel: Channel, folds: Bools, outliers: Integers) -> tuple[Integers | slice, int]:
    """Which of a channel's rows are in the folds ``(F,)`` and not rejected; how many of them the window before has."""
    if folds.all() and not len(outliers):
        return slice(None), channel.own
    inside = folds[channel.fold]
    if len(outliers):
        inside = inside & ~np.isin(channel.row, outliers, assume_unique=True)
    used = np.flatnonzero(inside)
    return used, int(np.searchsorted(used, channel.own))


@dataclass(frozen=True)
class LogPrior:
    """The prior of a fit and what it keeps to: ``(P + K, P + K)``, ``(P + K,)``, SI."""

    precision: Array
    mean: Array
    limits: Limits

    @property
    def size(self) -> Array:
        """Reasonable sizes ``(P + K,)``, SI."""
        return self.limits.size

    def free(self, theta: Array) -> Bools:
        """Which parameters ``(P + K,)`` do not rest on a bound."""
        return np.asarray(~self.limits.resting(theta))


@dataclass(frozen=True)
class _PartedPoint(LogPoint):
    """A log at one parameter vector, with the sums of its parts."""

    sums: dict[int, Moments]


def fit_log(design: LogDesign, folds: Bools, prior: LogPrior, start: Array, part: Integers | None = None) -> LogFit:
    """Fit the rows of some folds ``(F,)``; weighting and rejection as in `clampid.fitting.fit.fit`.

    Parameters
    ----------
    start
        ``(P + K,)``, SI.
    part
        ``(F,)``: into which parts the folds are divided for cross-validation; by default all are of part 0.

    Raises
    ------
    FitError
        There are no rows to fit, or the model gives no finite prediction.
    """
    outliers = np.zeros(0, dtype=np.int64)

    def solved(noise: LogNoise, theta: Array, part: Integers | None = None) -> tuple[Moments, dict[int, Moments]]:
        return weighted(design, folds, prior, outliers, noise, theta, part)

    found, _ = solved(LogNoise(np.ones(design.n)), start)
    rows = int(design.fold_rows[folds].sum())
    noise: LogNoise | None = None
    for _ in range(OUTLIER_PASSES):
        root = root_of_inverse(found.normal + prior.precision)
        bad, noise = _looked(design, folds, outliers, found.at, root)
        if not len(bad) or (len(bad) + len(outliers)) / rows > OUTLIER_SHARE:
            break
        outliers, noise = np.union1d(outliers, bad), None
        found, _ = solved(LogNoise(np.ones(design.n)), found.at)
    noise = noise or learned(design, folds, outliers, found.at)
    found, sums = solved(noise, found.at, part)
    again = learned(design, folds, outliers, found.at)
    if not noise.settled(again):
        noise = again
        found, sums = solved(noise, found.at, part)
    return LogFit(found, noise, outliers, part, sums)


def weighted(
    design: LogDesign,
    folds: Bools,
    prior: LogPrior,
    outliers: Integers,
    noise: LogNoise,
    start: Array,
    part: Integers | None = None,
) -> tuple[Moments, dict[int, Moments]]:
    """Fit the rows that are no outliers with weights that are known: the sums at the solution, and those of the parts.

    Parameters and errors as in :func:`fit_log`.
    """

    def at(here: Array) -> _PartedPoint:
        design.move(here)
        sums = summed(design, folds, outliers, noise, part)
        total = sum(sums.values(), Moments.none(design.at))
        if not total.count:
            raise FitError("free_air: no rows can be used: no motor moves, or every row is an outlier")
        if not np.isfinite(total.squares):
            raise FitError("free_air: the model gives no finite prediction; are the units right?")
        return _PartedPoint(total.moved(here), sums)

    if design.linear:
        point = at(start)
        return minimise(point.moments, start, prior.precision, prior.mean, prior.size), point.sums
    best, _ = descend(at, start, prior.precision, prior.mean, prior.limits)
    design.move(best.theta)
    return best.moments, best.sums


def summed(
    design: LogDesign,
    folds: Bools,
    outliers: Integers,
    noise: LogNoise,
    part: Integers | None = None,
) -> dict[int, Moments]:
    """Whitened sums where the design is, of all rows or per part of the folds.

    Parameters
    ----------
    part
        ``(F,)``: which part each fold is of; by default all are of part 0.
    """
    parts = np.unique(part[folds]) if part is not None else np.zeros(1, dtype=np.int64)
    out = {int(p): Moments.none(design.at) for p in parts}
    for block in design:
        for c, channel in enumerate(block.channels):
            used, own = used_of(channel, folds, outliers)
            if own == channel.row[used].size:
                continue
            of = None if part is None else part[channel.fold[used]]
            both = channel.both[used]
            if noise.autocorrelations:
                groups, whitener = _whitener(channel, used)
                both = whitener(groups.mean(both), noise.predictors[c])
                own, of = groups.own(own), None if of is None else of[groups.first]
            if of is None:
                out[0].add(channel.columns, both[own:], noise.sigma[c])
                continue
            for p in np.unique(of[own:]):
                out[int(p)].add(channel.columns, both[own:][of[own:] == p], noise.sigma[c])
    return out


@dataclass(frozen=True)
class Residuals:
    """Residuals of one motor's rows that count in a window; the first ``own`` are of the window before.

    Attributes
    ----------
    row, stretch, fold
        ``(k,)``, as in `Channel`.
    values
        ``(k,)``, Nm.
    """

    block: Block
    motor: int
    row: Integers
    stretch: Integers
    fold: Integers
    own: int
    values: Array
    _channel: Channel
    _used: Integers | slice
    _design_at: Array

    @property
    def groups(self) -> Grouping:
        """What of these rows is taken together."""
        if isinstance(self._used, slice):
            return self._channel.groups
        return Grouping.of(self.row, self.stretch, self._channel.together)

    def studentised(self, root: Array) -> Array:
        """The own rows' values ``(k - own,)`` over what a fit of weight one leaves of their errors.

        ``root``: :func:`clampid.fitting.leverage.root_of_inverse` of its normal matrix.
        """
        jacobian = self._channel.both[self._used][self.own :, :-1]
        return np.asarray(self.values[self.own :] / share_left(jacobian, root[self._channel.columns]))

    def at(self, theta: Array, part: Integers) -> Array:
        """The same ``(k,)`` at the parameters ``(parts, P + K)`` of the part that each fold ``(F,)`` is of."""
        both, columns = self._channel.both[self._used], self._channel.columns
        every = both[:, :-1] @ (theta - self._design_at)[:, columns].T
        return np.asarray(both[:, -1] - every[np.arange(len(every)), part[self.fold]])


def residuals(design: LogDesign, folds: Bools, outliers: Integers, theta: Array) -> Iterator[list[Residuals]]:
    """Measured less predicted torques of the rows that count, window by window; of each, motor by motor.

    ``theta``: ``(P + K,)``.
    """
    for block in design:
        found = []
        for c, channel in enumerate(block.channels):
            used, own = used_of(channel, folds, outliers)
            step = (theta - design.at)[channel.columns]
            values = (channel.both[:, -1] - channel.both[:, :-1] @ step)[used]
            row, stretch, fold = channel.row[used], channel.stretch[used], channel.fold[used]
            found.append(Residuals(block, c, row, stretch, fold, own, values, channel, used, design.at))
        yield found


class _Memory:
    """Products of residuals, from which scale and autoregression of each motor's noise follow."""

    def __init__(self, n: int) -> None:
        self.products, self.pairs = np.zeros((2, n, ORDER + 1))

    def add(self, found: Sequence[Residuals]) -> None:
        """Add a window's."""
        for r in found:
            groups = r.groups
            sums, counts = lag_products(groups.mean(r.values), groups.row, groups.stretch, groups.own(r.own))
            self.products[r.motor] += sums
            self.pairs[r.motor] += counts

    def noise(self) -> LogNoise:
        """As `clampid.fitting.noise.learn_noise` finds it."""
        sigma = np.maximum(np.sqrt(self.products[:, 0] / np.maximum(self.pairs[:, 0], 1)), 1e-12)
        autocorrelations = tuple(autocorrelation(p, k) for p, k in zip(self.products, self.pairs, strict=True))
        return LogNoise(np.where(self.pairs[:, 0] > 0, sigma, 1.0), autocorrelations, tuple(self.pairs[:, 0]))


def _looked(
    design: LogDesign, folds: Bools, outliers: Integers, theta: Array, root: Array
) -> tuple[Integers, LogNoise]:
    """Rows far beyond what a clean table would show, as in `fitting.fit`, and the noise, for where there are none.

    ``root``: of the inverse of the normal matrix at these parameters.
    """
    count, largest = np.zeros((2, design.n))
    memory: _Memory | None = None

    def sizes() -> Iterator[list[Array]]:
        nonlocal memory
        first, kept = memory is None, _Memory(design.n)
        for found in residuals(design, folds, outliers, theta):
            piece = [np.abs(r.studentised(root)) for r in found]
            if first:
                count[:] += [len(p) for p in piece]
                np.maximum(largest, [p.max(initial=0.0) for p in piece], out=largest)
                kept.add(found)
            yield piece
        memory = memory or kept

    scale = NORMAL * medians(sizes)
    limit = np.maximum(np.sqrt(stats.chi2.isf(OUTLIER_RATE / np.maximum(count, 1), 1)), 4.0)
    limit = np.where(count >= LEAST_ROWS_OF_A_MOTOR, limit * np.fmax(scale, 1e-12), np.inf)
    bad = [np.zeros(0, dtype=np.int64)]
    if np.any(largest > limit):
        bad += [
            r.row[r.own :][np.abs(r.studentised(root)) > limit[r.motor]]
            for found in residuals(design, folds, outliers, theta)
            for r in found
        ]
    return np.unique(np.concatenate(bad)), (memory or _Memory(design.n)).noise()


def learned(design: LogDesign, folds: Bools, outliers: Integers, theta: Array) -> LogNoise:
    """The noise that the residuals of some folds ``(F,)`` show at the parameters ``(P + K,)``."""
    memory = _Memory(design.n)
    for found in residuals(design, folds, outliers, theta):
        memory.add(found)
    return memory.noise()


def _whitener(channel: Channel, used: Integers | slice) -> tuple[Grouping, Whitener]:
    """What of some of a channel's rows is taken together, and its filter."""
    if isinstance(used, slice):
        return channel.groups, channel.whitener
    groups = Grouping.of(channel.row[used], channel.stretch[used], channel.together)
    return groups, Whitener(groups.row, groups.stretch)
