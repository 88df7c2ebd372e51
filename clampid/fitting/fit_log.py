"""The fit of a torque log by passes over its windows: the results of `fitting.fit` without the whole log in memory.

If effects are linear in their parameters, the passes are:

1. Sum the normal equations.
2. Find outliers and noise from the residual (two passes for a long log).
3. Sum the prewhitened normal equations, and again if the noise changes. They are summed for each part of the
   cross-validation, so that its fits need no further pass.

With shape parameters, each step of damped Gauss-Newton takes a pass. Source of the reduction: Golub & Van Loan, Matrix
Computations (2013), section 5.3.8 (normal equations). The equations are balanced before they are solved.
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
from clampid.fitting.noise import MAD_TO_STD
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

LEAST_ROWS_OF_A_MOTOR = 20  # with fewer rows, no outliers of a motor are rejected: their median is too uncertain


@dataclass(frozen=True)
class LogNoise:
    """Noise of a log's motors.

    If rows are averaged in groups, because they are denser than the design needs, it is the noise of groups.

    Attributes
    ----------
    sigma
        Standard deviations ``(n,)``, Nm.
    autocorrelations
        For each motor its autocorrelation by lag; empty for white noise.
    counts
        For each motor the number of rows that these are from.
    """

    sigma: Array
    autocorrelations: tuple[Array, ...] = ()
    counts: tuple[float, ...] = ()

    def settled(self, again: LogNoise) -> bool:
        """Whether noise learned ``again`` is the same within its error; see `clampid.fitting.noise.Noise.settled`."""
        ratios = again.sigma / self.sigma
        channels = zip(ratios, self.autocorrelations, again.autocorrelations, again.counts, strict=True)
        return all(settled(*channel) for channel in channels)

    @cached_property
    def predictors(self) -> tuple[Predictors, ...]:
        """The prewhitening filter of each motor."""
        return tuple(Predictors(a) for a in self.autocorrelations)


@dataclass(frozen=True)
class LogFit:
    """A fitted log.

    Attributes
    ----------
    moments
        The prewhitened sums at the solution.
    noise
        The noise by which the rows were weighted.
    outliers
        Numbers of the rejected rows of the log, ascending.
    part
        ``(F,)``: part of the cross-validation that each fold belongs to; None without parts.
    sums
        Part → the prewhitened sums over its rows, at the design's parameters.
    """

    moments: Moments
    noise: LogNoise
    outliers: Integers
    part: Integers | None
    sums: Mapping[int, Moments]


def used_of(channel: Channel, folds: Bools, outliers: Integers) -> tuple[Integers | slice, int]:
    """A channel's rows in the folds ``(F,)`` that are no outliers, and how many of them belong to the window before."""
    if folds.all() and not len(outliers):
        return slice(None), channel.own
    inside = folds[channel.fold]
    if len(outliers):
        inside = inside & ~np.isin(channel.row, outliers, assume_unique=True)
    used = np.flatnonzero(inside)
    return used, int(np.searchsorted(used, channel.own))


@dataclass(frozen=True)
class LogPrior:
    """The prior of a fit and its bounds: precision ``(P + K, P + K)``, mean ``(P + K,)``, limits; SI."""

    precision: Array
    mean: Array
    limits: Limits

    @property
    def size(self) -> Array:
        """Reasonable sizes ``(P + K,)``, SI."""
        return self.limits.size

    def free(self, theta: Array) -> Bools:
        """Which parameters ``(P + K,)`` are not at a bound."""
        return np.asarray(~self.limits.resting(theta))


@dataclass(frozen=True)
class _PartedPoint(LogPoint):
    """A log at one parameter vector, with the sums of its parts."""

    sums: dict[int, Moments]


def fit_log(design: LogDesign, folds: Bools, prior: LogPrior, start: Array, part: Integers | None = None) -> LogFit:
    """Fit the rows of some folds; weights and outliers as in `clampid.fitting.fit.fit`.

    Parameters
    ----------
    design
        The log's design; afterwards its parameters are those of the solution.
    folds
        ``(F,)``: which folds are fitted.
    prior
        Prior and bounds.
    start
        Initial values ``(P + K,)``, SI.
    part
        ``(F,)``: part of the cross-validation that each fold belongs to; by default all are of part 0.

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
        bad, noise = _outliers_and_noise(design, folds, outliers, found.at, root)
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
    """Fit the rows without outliers, with known noise: the sums at the solution, and those of each part.

    ``outliers`` are row numbers, ascending. Other parameters and errors as in :func:`fit_log`.
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
    """Whitened sums over the rows of some folds, at the design's parameters, for each part.

    Parameters
    ----------
    design, folds
        The log, and which folds count ``(F,)``.
    outliers
        Numbers of rows that do not count, ascending.
    noise
        Weights the rows; if it has autocorrelations, the rows are prewhitened.
    part
        ``(F,)``: part that each fold belongs to; by default all are of part 0.
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
    """Residuals of one motor's rows that count in a window; the first ``own`` rows belong to the window before.

    Attributes
    ----------
    block, motor
        The window, and the motor from 0.
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
        """The groups in which these rows are averaged."""
        if isinstance(self._used, slice):
            return self._channel.groups
        return Grouping.of(self.row, self.stretch, self._channel.together)

    def studentised(self, root: Array) -> Array:
        """Studentised residuals ``(k - own,)`` of this window's rows, by a fit with unit weights.

        ``root``: :func:`clampid.fitting.leverage.root_of_inverse` of its normal matrix.
        """
        jacobian = self._channel.both[self._used][self.own :, :-1]
        return np.asarray(self.values[self.own :] / share_left(jacobian, root[self._channel.columns]))

    def at(self, theta: Array, part: Integers) -> Array:
        """Residuals ``(k,)``, Nm, each with the parameters of its fold's part.

        ``theta``: ``(parts, P + K)``; ``part``: ``(F,)``, the part of each fold.
        """
        both, columns = self._channel.both[self._used], self._channel.columns
        every = both[:, :-1] @ (theta - self._design_at)[:, columns].T
        return np.asarray(both[:, -1] - every[np.arange(len(every)), part[self.fold]])


def residuals(design: LogDesign, folds: Bools, outliers: Integers, theta: Array) -> Iterator[list[Residuals]]:
    """Measured less predicted torques, Nm, window by window, with an entry for each motor.

    ``folds`` ``(F,)``: which folds count; ``outliers``: numbers of rows that do not count, ascending; ``theta``:
    parameters ``(P + K,)``, SI.
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


class _LagProducts:
    """Sums of products of residuals by lag, from which each motor's noise and its autocorrelation follow."""

    def __init__(self, n: int) -> None:
        self.products, self.pairs = np.zeros((2, n, ORDER + 1))

    def add(self, found: Sequence[Residuals]) -> None:
        """Add the residuals of a window."""
        for r in found:
            groups = r.groups
            sums, counts = lag_products(groups.mean(r.values), groups.row, groups.stretch, groups.own(r.own))
            self.products[r.motor] += sums
            self.pairs[r.motor] += counts

    def noise(self) -> LogNoise:
        """The noise, as `clampid.fitting.noise.learn_noise` computes it."""
        sigma = np.maximum(np.sqrt(self.products[:, 0] / np.maximum(self.pairs[:, 0], 1)), 1e-12)
        autocorrelations = tuple(autocorrelation(p, k) for p, k in zip(self.products, self.pairs, strict=True))
        return LogNoise(np.where(self.pairs[:, 0] > 0, sigma, 1.0), autocorrelations, tuple(self.pairs[:, 0]))


def _outliers_and_noise(
    design: LogDesign, folds: Bools, outliers: Integers, theta: Array, root: Array
) -> tuple[Integers, LogNoise]:
    """Outliers, by the rule of `clampid.fitting.fit.outlying`, and the noise of the rows, outliers included.

    ``root``: square root of the inverse normal matrix at these parameters.
    """
    count, largest = np.zeros((2, design.n))
    memory: _LagProducts | None = None

    def sizes() -> Iterator[list[Array]]:
        nonlocal memory
        first, kept = memory is None, _LagProducts(design.n)
        for found in residuals(design, folds, outliers, theta):
            piece = [np.abs(r.studentised(root)) for r in found]
            if first:
                count[:] += [len(p) for p in piece]
                np.maximum(largest, [p.max(initial=0.0) for p in piece], out=largest)
                kept.add(found)
            yield piece
        memory = memory or kept

    scale = MAD_TO_STD * medians(sizes)
    limit = np.maximum(np.sqrt(stats.chi2.isf(OUTLIER_RATE / np.maximum(count, 1), 1)), 4.0)
    limit = np.where(count >= LEAST_ROWS_OF_A_MOTOR, limit * np.fmax(scale, 1e-12), np.inf)
    bad = [np.zeros(0, dtype=np.int64)]
    if np.any(largest > limit):
        bad += [
            r.row[r.own :][np.abs(r.studentised(root)) > limit[r.motor]]
            for found in residuals(design, folds, outliers, theta)
            for r in found
        ]
    return np.unique(np.concatenate(bad)), (memory or _LagProducts(design.n)).noise()


def learned(design: LogDesign, folds: Bools, outliers: Integers, theta: Array) -> LogNoise:
    """The noise learned from the residuals of some folds ``(F,)`` at the parameters ``theta`` ``(P + K,)``."""
    memory = _LagProducts(design.n)
    for found in residuals(design, folds, outliers, theta):
        memory.add(found)
    return memory.noise()


def _whitener(channel: Channel, used: Integers | slice) -> tuple[Grouping, Whitener]:
    """The groups in which a channel's rows are averaged, and their prewhitening filter."""
    if isinstance(used, slice):
        return channel.groups, channel.whitener
    groups = Grouping.of(channel.row[used], channel.stretch[used], channel.together)
    return groups, Whitener(groups.row, groups.stretch)
