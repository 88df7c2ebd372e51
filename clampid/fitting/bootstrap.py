"""Bootstrap by pose: how parameters scatter when whole poses are drawn anew, whatever the residuals are made of.

Formulas take residuals for independent noise. What a model leaves unexplained is not: all rows of a pose share it.
Drawing whole poses with replacement keeps it together. Each draw weights the poses' own normal equations::

    theta_b = theta + (sum w_f A_f + Lambda)^-1 (sum w_f g_f - Lambda (theta - mu)),  A_f = J_f' J_f,  g_f = J_f' r_f

one Gauss-Newton step from the fit of all poses, which a refit of each draw would only polish. Sources: Efron and
Tibshirani, An Introduction to the Bootstrap, 1993, chapter 9 (resampling of cases); one step: Schucany and Wang,
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
        How many draws.
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
    """Bootstrap a fit by its folds (whole poses with all visits and targets; in logs, runs or sweeps).

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
    """How often each fold is drawn ``(count, F)``: within each session as many as it has.

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
    """Parameters ``(B, P + K)`` of fits whose folds have these weights ``(B, F)``, by one Gauss-Newton step each."""
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
    """Normal matrices ``(F, P, P)`` and slopes ``(F, P)`` of every fold, in parameters of usual size."""
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
