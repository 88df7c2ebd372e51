"""The robot's own repeatability: what all numbers of one visit to a pose share, and what that does to a fit's errors.

A robot stops a little off, each joint by its own amount, and every target that is measured before it moves again sees
the same. So the numbers of visit v are not independent: with J_v their derivative by the joints, all whitened::

    cov(r_v) = s^2 I + J_v diag(rho^2) J_v'

The variances s^2 and rho_i^2 (not negative) are those that bring the residuals' products nearest to this: MINQUE with
prior weight on s^2 alone, Rao (1971), Estimation of variance and covariance components, J. Multivar. Anal. 1. A
residual is less than its error by what the fit has absorbed of it, and is put right visit by visit with
(1 - H_vv)^(-1/2), H the hat matrix: Bell and McCaffrey (2002), Bias reduction in standard errors for linear regression
with multi-stage samples, Survey Methodology 28. The estimate stays that of independent numbers; its covariance is then
A^-1 (sum_v X_v' cov(r_v) X_v + prior precision) A^-1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize, sparse

from clampid.fitting.noise import Whitened
from clampid.stages.rows import Array, Integers

__all__ = ["Scatter", "clustered_covariance", "shared_moments", "sums_over", "visit_scatter"]

FEWEST = 20  # visits with more than one point or distance; of fewer no seven variances can be told
VISITS = 2000  # at once, for the memory they take
ABSORBED = 1e-3  # the least share of a number's variance that a fit may have left


@dataclass(frozen=True)
class Scatter:
    """Variance components of whitened pose residuals.

    Attributes
    ----------
    noise
        s², of the numbers themselves, 1.
    joints
        ``(n,)``: standard deviation of where each joint stops, rad.
    """

    noise: float
    joints: Array


def visit_scatter(white: Whitened, by_joint: Array, visit: Integers, covariance: Array) -> Scatter | None:
    """The noise's two parts from a fit's residuals; None where too few visits measured more than one point.

    Parameters
    ----------
    white
        Residual ``(M,)`` and Jacobian ``(M, P)`` at the solution.
    by_joint
        ``(M, n)``: derivative of the same numbers by the joints, whitened, 1/rad.
    visit
        ``(M,)``: from 0, the visit that each number belongs to.
    covariance
        ``(P, P)``: of the fit if all numbers were independent with variance one.
    """
    n = by_joint.shape[1]
    products, observed, several = np.zeros((n + 1, n + 1)), np.zeros(n + 1), 0
    for rows in _groups(visit):
        if (
            len(rows) <= 3 and np.ptp(white.entry[rows]) == 0
        ):  # one point or distance: whether instrument or robot is off cannot be told
            continue
        several += 1
        X, J = white.jacobian[rows], by_joint[rows]
        share, turn = linalg.eigh(np.eye(len(rows)) - X @ covariance @ X.T)
        residual = turn @ (turn.T @ white.residual[rows] / np.sqrt(np.maximum(share, ABSORBED)))
        gram = J.T @ J
        products[0, 0] += len(rows)
        products[0, 1:] += np.diag(gram)
        products[1:, 1:] += gram**2
        observed += np.r_[residual @ residual, (J.T @ residual) ** 2]
    if several < FEWEST:
        return None
    products[1:, 0] = products[0, 1:]
    size = np.sqrt(np.maximum(np.diag(products), 1e-300))
    # Non-negative least squares of all products at once, from its normal equations.
    root = linalg.cholesky(products / np.outer(size, size) + 1e-9 * np.eye(n + 1))
    variances = optimize.nnls(root, linalg.solve_triangular(root, observed / size, trans="T"))[0] / size
    return Scatter(float(variances[0]), np.sqrt(variances[1:]))


def clustered_covariance(
    white: Whitened, by_joint: Array, visit: Integers, precision: Array, scatter: Scatter, inverse: Array
) -> Array:
    """Covariance ``(P, P)`` of a fit that counted the numbers of a visit as independent.

    Parameters
    ----------
    white, by_joint, visit
        See :func:`visit_scatter`.
    precision
        ``(P, P)``: of the prior.
    inverse
        ``(P, P)``: of the fit's normal matrix, prior included.
    """
    # Balanced, since parameters are of very different sizes.
    size = np.sqrt(np.maximum(np.diag(inverse), 1e-300))
    X = white.jacobian * size
    middle = shared_moments(X, by_joint, visit, scatter) + precision * np.outer(size, size)
    balanced = inverse / np.outer(size, size)
    covariance = balanced @ middle @ balanced
    return np.asarray(0.5 * (covariance + covariance.T) * np.outer(size, size))


def shared_moments(X: Array, by_joint: Array, visit: Integers, scatter: Scatter) -> Array:
    """Covariance ``(P, P)`` of Xᵀ r, r the whitened noise ``(M,)`` of visits that share where the robot has stopped."""
    out = scatter.noise * (X.T @ X)
    groups = _groups(visit)
    for start in range(0, len(groups), VISITS):
        shared = [(by_joint[rows] * scatter.joints).T @ X[rows] for rows in groups[start : start + VISITS]]
        together = np.concatenate(shared)  # one product of many visits: of each its own, P² would be summed as often
        out += together.T @ together
    return np.asarray(out)


def _groups(visit: Integers) -> list[Integers]:
    order = np.argsort(visit, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(visit[order])) + 1)


def sums_over(group: Integers, count: int) -> Callable[[Array], Array]:
    """What sums rows ``(M, ...)`` over groups ``(M,)``: ``(count, ...)``."""
    member = sparse.csr_matrix((np.ones(len(group)), (group, np.arange(len(group)))), shape=(count, len(group)))
    return lambda values: np.asarray(member @ values.reshape(len(group), -1)).reshape(count, *values.shape[1:])
