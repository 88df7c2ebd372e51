"""The weights of a torque log read window by window; see :mod:`clampid.fitting.equal_weights`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clampid.fitting.equal_weights import Weights, gradient_power, informed, uncorrelated
from clampid.fitting.fit_log import LogFit, LogNoise, LogPrior, learned, residuals, summed, used_of, weighted
from clampid.fitting.log_errors import cross_fitted
from clampid.stages.log_design import LogDesign
from clampid.stages.prewhitening import Grouping
from clampid.stages.rows import Array, Bools, Integers

__all__ = ["best_weighted"]


def best_weighted(
    design: LogDesign, fit: LogFit, prior: LogPrior, kept: Bools, part: Integers
) -> tuple[LogFit, Weights | None]:
    """A log's fit with the weights that predict better, and the comparison of the two; None if there is one part only.

    Parameters
    ----------
    design, prior
        The log, and the prior of the fit.
    fit
        The fit with weights by the autocorrelation of its noise.
    kept, part
        ``(F,)``: which folds are fitted, and the part of the cross-validation that each belongs to.

    Raises
    ------
    clampid.fitting.solve.FitError
        The fit with equal weights has no finite prediction.
    """
    if len(np.unique(part[kept])) < 2:
        return fit, None
    equal = _equal(fit.noise)
    again = replace(fit, part=part, sums=summed(design, kept, fit.outliers, equal, part))
    weights = _compared(design, cross_fitted(design, fit, prior, kept, part), again, prior, kept, part)
    if not weights.equal:
        return fit, weights
    found, _ = weighted(design, kept, prior, fit.outliers, equal, fit.moments.at)
    noise = learned(design, kept, fit.outliers, found.at)
    equal = _equal(noise)
    found, sums = weighted(design, kept, prior, fit.outliers, equal, found.at, part)
    power = _gradient_covariance(design, kept, fit.outliers, noise)
    best = informed(found, power, prior.precision, prior.mean, prior.size, prior.free(found.at))
    design.move(best.at)
    return LogFit(best, equal, fit.outliers, part, sums), weights


def _equal(noise: LogNoise) -> LogNoise:
    """The same standard deviations without correlation in time."""
    return replace(noise, autocorrelations=uncorrelated(len(noise.autocorrelations)))


def _compared(
    design: LogDesign, correlated: Array, equal: LogFit, prior: LogPrior, kept: Bools, part: Integers
) -> Weights:
    """Comparison by held-out squares; ``correlated``: parameters ``(parts, P + K)`` of `cross_fitted` for that fit."""
    plain = cross_fitted(design, equal, prior, kept, part)
    squares = np.zeros((2, len(plain), design.n))
    for found in residuals(design, kept, equal.outliers, equal.moments.at):
        for r in found:
            own = part[r.fold[r.own :]]
            for theta, into in zip((correlated, plain), squares, strict=True):
                into[:, r.motor] += np.bincount(own, r.at(theta, part)[r.own :] ** 2, len(plain))
    return Weights.of(*squares)


def _gradient_covariance(design: LogDesign, kept: Bools, outliers: Integers, noise: LogNoise) -> Array:
    """Covariance ``(P + K, P + K)`` of the gradient of a fit with equal weights, under correlated noise.

    Products of rows in different windows are neglected.
    """
    out = np.zeros((design.parameters, design.parameters))
    for block in design:
        for c, channel in enumerate(block.channels):
            used, own = used_of(channel, kept, outliers)
            if isinstance(used, slice):
                groups = channel.groups
            else:
                groups = Grouping.of(channel.row[used], channel.stretch[used], channel.together)
            first = groups.own(own)
            inside = replace(groups, row=groups.row[first:], stretch=groups.stretch[first:])
            columns = groups.mean(channel.both[used])[first:, :-1] / noise.sigma[c]
            out[np.ix_(channel.columns, channel.columns)] += gradient_power(columns, inside, noise.predictors[c])
    return out
