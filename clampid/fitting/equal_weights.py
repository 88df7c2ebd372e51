"""The weights of a torque log: by the correlation of its noise in time, or the same for every row of a motor.

Where the model is right, weights by the correlation give the least error. Where it lacks something slow, its residual
takes that for noise that lasts; such weights then attend to the quick changes of the torque only, and the slow ones,
which the model is to predict, go wrong. Cross-validation decides, all motors together: if a fit with equal weights
leaves smaller squares on the rows it has not seen, by more than the standard error of the difference, it is taken. Its
standard errors know the correlation all the same: with N the normal matrix of equal weights and M the covariance of
its gradient under that noise, the rows determine N M^-1 N of the parameters.
Sources: White, Maximum likelihood estimation of misspecified models, Econometrica 50, 1982, and Godambe, Ann. Math.
Stat. 31, 1960, for the information; Diebold & Mariano, Comparing predictive accuracy, J. Bus. Econ. Stat. 13, 1995,
for the paired difference.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg, signal, stats

from clampid.fitting.accuracy import cross_validated, parts_of_rows
from clampid.fitting.descent import covariance_of
from clampid.fitting.moments import Moments, minimise
from clampid.fitting.noise import Noise, groups_of, learn_noise
from clampid.fitting.solve import Estimate, limits_of, solve, stage_point
from clampid.stages.prewhitening import LONGEST_LAG, Grouping, Predictors
from clampid.stages.rows import Array, Bools

__all__ = ["Weights", "gradient_power", "informed", "uncorrelated", "with_best_weights"]

RINGING = 4 * LONGEST_LAG
"""Rows after the last of a stretch over which a filter's answer to it is still counted."""
SINGULAR = 1e-12
"""Of the largest eigenvalue of a balanced covariance: what is smaller is a direction of which no row knows anything."""

CHANCE = float(stats.norm.sf(1.0))
"""Of a difference that is none, to lie more than one standard error to one side."""


@dataclass(frozen=True)
class Weights:
    """What cross-validation says of a log's weights.

    Attributes
    ----------
    gain, error
        By how much equal weights lower the mean square of the rows not seen, as a share of it, and the standard error
        of that, from the differences between the parts.
    parts
        How many parts there are.
    """

    gain: float
    error: float
    parts: int

    @staticmethod
    def of(correlated: Array, equal: Array) -> Weights:
        """From the squares ``(parts, n)`` that fits of the other parts leave of each motor's rows, two or more parts.

        Motors count alike, whatever their torques.
        """
        total = equal.sum(axis=0)
        moved = total > 0
        parts = len(equal)
        share = np.mean((correlated - equal)[:, moved] / total[moved], axis=1)
        error = float(np.sqrt(parts / (parts - 1) * np.sum((share - share.mean()) ** 2)))
        return Weights(float(share.sum()), error, parts)

    @property
    def equal(self) -> bool:
        """Whether equal weights are taken: their gain is beyond its error, of few parts by as rare a chance."""
        return self.gain > float(stats.t.isf(CHANCE, self.parts - 1)) * self.error

    def to_json(self) -> dict[str, Any]:
        """As the ledger keeps it."""
        return {"equal": self.equal, "gain": self.gain, "std": self.error, "parts": self.parts}


def with_best_weights(estimate: Estimate, seed: int) -> tuple[Estimate, Weights | None]:
    """Fit a log again with the weights that predict best, and say how the two compare.

    Parameters
    ----------
    estimate
        Of ``free_air``, weighted by the correlation of its noise.
    seed
        Of the cross-validation.

    Returns
    -------
    Estimate, Weights
        The same estimate and None where the rows are of one part only.

    Raises
    ------
    FitError
        The fit with equal weights gives no finite prediction.
    """
    problem, rows = estimate.problem, estimate.problem.rows
    part = parts_of_rows(rows, seed)
    if len(np.unique(part)) < 2:
        return estimate, None
    precision, mean = estimate.prior_precision, estimate.prior_mean

    def equally(noise: Noise, start: Array) -> Estimate:
        alike = replace(noise, autocorrelations=uncorrelated(len(noise.autocorrelations)))
        return solve(problem, start, alike, precision, mean)

    def squares(fitted: Estimate) -> Array:
        left = np.where(rows.used, cross_validated(fitted, rows, seed)[1], 0.0) ** 2
        return np.array([left[part == k].sum(axis=0) for k in np.unique(part)])

    plain = equally(estimate.noise, estimate.theta)
    weights = Weights.of(squares(estimate), squares(plain))
    if not weights.equal:
        return estimate, weights
    noise = learn_noise(rows, plain.residual)
    plain = equally(noise, plain.theta)
    white = plain.whitened
    power = np.zeros_like(white.normal)
    for c, correlation in enumerate(noise.autocorrelations):
        if np.any(white.channel == c):
            groups = groups_of(rows, np.flatnonzero(rows.used[:, c]), noise.together)
            power += gradient_power(white.jacobian[white.channel == c], groups, Predictors(correlation))
    slope = white.jacobian.T @ white.residual
    sums = Moments(plain.theta, white.normal, slope, plain.point.cost, plain.point.count)
    limits = limits_of(problem)
    best = informed(sums, power, precision, mean, limits.size, ~limits.resting(plain.theta))
    point = stage_point(problem, plain.noise, best.at)
    covariance = covariance_of(best.normal, precision, point.cost, point.count)
    return replace(plain, theta=best.at, covariance=covariance, whitened=point.white, residual=point.residual), weights


def uncorrelated(channels: int) -> tuple[Array, ...]:
    """Autocorrelations ``(65,)`` of as many channels, of white noise."""
    return tuple(np.eye(1, LONGEST_LAG + 1)[0] for _ in range(channels))


def gradient_power(columns: Array, groups: Grouping, predictors: Predictors) -> Array:
    """J'RJ ``(p, p)`` of whitened columns ``(g, p)`` of one motor's rows, R the correlation of its noise.

    It is the power of the columns behind a filter that gives white noise that correlation; rows that do not count are
    zeros there.
    """
    if not len(columns):
        return np.zeros((columns.shape[1], columns.shape[1]))
    breaks = np.diff(groups.stretch) != 0
    step = np.where(breaks, RINGING, np.minimum(np.diff(groups.row), RINGING))
    place = np.r_[0, np.cumsum(step)]
    spaced = np.zeros((int(place[-1]) + RINGING, columns.shape[1]))
    spaced[place] = columns
    rung = signal.lfilter([1.0], predictors.plain, spaced, axis=0)
    return np.asarray(rung.T @ rung)


def informed(plain: Moments, power: Array, precision: Array, mean: Array, size: Array, free: Bools) -> Moments:
    """Information of a fit with equal weights, without prior: sums with N M^-1 N in place of N, where both are least.

    Parameters
    ----------
    plain
        The sums of equal weights at their solution.
    power
        M ``(P, P)``, the covariance of the gradient.
    precision, mean, size, free
        As :func:`clampid.fitting.moments.minimise` takes them.
    """
    balance = 1.0 / np.sqrt(np.maximum(np.diag(power), 1e-300))
    values, vectors = linalg.eigh(power * np.outer(balance, balance))
    known = values > SINGULAR * values.max(initial=0.0)
    root = (vectors[:, known] / np.sqrt(values[known])).T * balance  # root' root = M^-1
    own = root @ plain.normal
    weighted = Moments(plain.at, own.T @ own, own.T @ (root @ plain.slope), plain.squares, plain.count)
    best = minimise(weighted, plain.at, precision, mean, size, free)
    return replace(best, squares=plain.moved(best.at).squares)
