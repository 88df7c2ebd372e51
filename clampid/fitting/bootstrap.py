"""Bootstrap by pose: standard errors from resampling whole poses with replacement.

The usual formulas assume independent residuals. Misfit is not independent: all rows of a pose share it. Resampling
whole poses preserves this dependence. Each draw b weights the normal equations of pose f by w_f, how often it was
drawn::

    theta_b = theta + (sum w_f A_f + Lambda)^-1 (sum w_f g_f - Lambda (theta - mu)),  A_f = J_f' J_f,  g_f = J_f' r_f

This is one Gauss-Newton step from the fit of all poses; a full refit of each draw would change little. Sources: Efron
and Tibshirani, An Introduction to the Bootstrap, 1993, chapter 9 (resampling of cases); one step: Schucany and Wang,
One-step bootstrapping for smooth iterative procedures, J. R. Stat. Soc. B 53, 1991.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from clampid.fitting.solve import Estimate
from clampid.stages.rows import Array, Integers

__all__ = ["Bootstrap", "bootstrap", "draws", "one_step"]

CONFIDENCE = 0.95
DRAWS_AT_ONCE = 200  # draws whose matrices are in memory at once


@dataclass(frozen=True)
class Bootstrap:
    """Standard errors and intervals of a stage's parameters by a bootstrap over poses.

    Attributes
    ----------
    count
        Number of draws.
    std
        ``(P,)``: standard errors, SI.
    low, high
        ``(P,)``: ends of the 95 % percentile interval, SI.
    """

    count: int
    std: Array
    low: Array
    high: Array


def bootstrap(estimate: Estimate, count: int = 1000, seed: int = 0) -> Bootstrap:
    """Bootstrap a fit by its folds (whole poses with all visits and targets; for logs, runs or sweeps).

    Parameters
    ----------
    estimate
        The fit.
    count, seed
        Number of draws, and the seed of the random numbers.

    Raises
    ------
    ValueError
        There are fewer than two draws, or fewer than two folds to draw from.
    """
    if count < 2:
        raise ValueError(f"bootstrap: expected two or more draws, found {count}")
    weights = draws(estimate, count, np.random.default_rng(seed))
    theta = one_step(estimate, weights)[:, : len(estimate.slots)]
    low, high = np.quantile(theta, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], axis=0)
    return Bootstrap(count, theta.std(axis=0, ddof=1), low, high)


def draws(estimate: Estimate, count: int, rng: np.random.Generator) -> Array:
    """How often each fold is drawn ``(count, F)``; from each session as many folds as it has.

    Raises
    ------
    ValueError
        A session has fewer than two folds.
    """
    folds, first = np.unique(estimate.problem.rows.fold, return_index=True)
    session = estimate.problem.rows.session[first]
    out = np.zeros((count, len(folds)))
    for s in np.unique(session):
        own = np.flatnonzero(session == s)
        if len(own) < 2:
            raise ValueError(f"bootstrap: expected two or more poses in session {s + 1}, found {len(own)}")
        out[:, own] = rng.multinomial(len(own), np.full(len(own), 1 / len(own)), size=count)
    return out


def one_step(estimate: Estimate, weights: Array) -> Array:
    """Parameters ``(B, P + K)``, SI, of fits with weights ``(B, F)`` of the folds, by one Gauss-Newton step each."""
    A, g = _normal_equations(estimate)
    size = estimate.problem.sizes()
    precision = estimate.prior_precision * np.outer(size, size)
    pull = estimate.prior_precision @ (estimate.theta - estimate.prior_mean) * size
    out = np.empty((len(weights), len(size)))
    for start in range(0, len(weights), DRAWS_AT_ONCE):
        w = weights[start : start + DRAWS_AT_ONCE]
        normal = np.tensordot(w, A, axes=1) + precision
        slope = w @ g - pull
        for b in range(len(w)):
            out[start + b] = linalg.solve(normal[b], slope[b], assume_a="pos", check_finite=False)
    return np.asarray(estimate.theta + size * out)


def _normal_equations(estimate: Estimate) -> tuple[Array, Array]:
    """Normal matrices ``(F, P, P)`` and gradients ``(F, P)`` of every fold, for parameters over their sizes."""
    _, fold = np.unique(estimate.problem.rows.fold, return_inverse=True)
    of: Integers = fold[estimate.whitened.entry]
    order = np.argsort(of, kind="stable")
    J = (estimate.whitened.jacobian * estimate.problem.sizes())[order]
    r = estimate.whitened.residual[order]
    count, P = int(fold.max()) + 1, J.shape[1]
    ends = np.searchsorted(of[order], np.arange(count + 1))
    A, g = np.zeros((count, P, P)), np.zeros((count, P))
    for f in range(count):
        part = slice(ends[f], ends[f + 1])
        A[f], g[f] = J[part].T @ J[part], J[part].T @ r[part]
    return A, g
