"""The weights of a torque log: by the autocorrelation of its noise, or equal for all rows of a motor.

If the model is right, weights by the autocorrelation give the smallest error. If the model lacks a slow effect, its
misfit looks like strongly correlated noise. Such weights then fit only the fast changes of the torque, and the model
predicts the slow ones badly. Cross-validation decides, for all motors together: if a fit with equal weights has smaller
held-out squares, by more than the standard error of the difference, it is used. Its standard errors still account for
the correlation. With N the normal matrix of equal weights, and M the covariance of its gradient under correlated noise,
the information of the rows on the parameters is N M^-1 N.
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
"""Rows after the end of a stretch over which a filter's response is still counted."""
SINGULAR = 1e-12
"""Eigenvalue of a balanced covariance over the largest one: in a direction below this, the rows have no information."""

ONE_SIGMA_TAIL = float(stats.norm.sf(1.0))
"""Chance that a difference of zero is estimated more than one standard error above zero."""


@dataclass(frozen=True)
class Weights:
    """Comparison of equal weights with weights by the autocorrelation, by cross-validation.

    Attributes
    ----------
    gain
        Relative decrease of the held-out mean square by equal weights; negative if they are worse.
    error
        Standard error of ``gain``, from the differences between the parts.
    parts
        Number of parts.
    """

    gain: float
    error: float
    parts: int

    @staticmethod
    def of(correlated: Array, equal: Array) -> Weights:
        """The comparison, from held-out sums of squares ``(parts, n)`` of each motor, for two parts or more.

        All motors have the same weight, whatever their torques.
        """
        total = equal.sum(axis=0)
        moved = total > 0
        parts = len(equal)
        share = np.mean((correlated - equal)[:, moved] / total[moved], axis=1)
        error = float(np.sqrt(parts / (parts - 1) * np.sum((share - share.mean()) ** 2)))
        return Weights(float(share.sum()), error, parts)

    @property
    def equal(self) -> bool:
        """Whether equal weights are used: the gain exceeds its standard error (by Student's t, for few parts)."""
        return self.gain > float(stats.t.isf(ONE_SIGMA_TAIL, self.parts - 1)) * self.error

    def to_json(self) -> dict[str, Any]:
        """As the ledger keeps it."""
        return {"equal": self.equal, "gain": self.gain, "std": self.error, "parts": self.parts}


def with_best_weights(estimate: Estimate, seed: int) -> tuple[Estimate, Weights | None]:
    """The fit of a log with the weights that predict better, and the comparison of the two.

    Parameters
    ----------
    estimate
        A fit of ``free_air``, weighted by the autocorrelation of its noise.
    seed
        For the division into parts.

    Returns
    -------
    Estimate, Weights
        The same estimate and None if the rows make up one part only.

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
    """Autocorrelations ``(65,)`` of white noise, one for each channel."""
    return tuple(np.eye(1, LONGEST_LAG + 1)[0] for _ in range(channels))


def gradient_power(columns: Array, groups: Grouping, predictors: Predictors) -> Array:
    """J'RJ ``(p, p)`` of whitened columns ``(g, p)`` of one motor's rows; R is the correlation matrix of its noise.

    It is the power of the columns after a filter that gives white noise this correlation. Rows that do not count are
    zeros at its input.
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
    """The sums of a fit with equal weights, N replaced by its information N M^-1 N, at the minimum with the prior.

    Parameters
    ----------
    plain
        The sums with equal weights at their solution.
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
