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

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize, sparse

from clampid.fitting.noise import Whitened
from clampid.stages.rows import Array, Integers

__all__ = ["Scatter", "clustered_covariance", "shared_moments", "sums_over", "visit_scatter"]

MIN_VISITS = 20  # visits with more than one point or distance; of fewer no seven variances can be determined
NUMBERS = 4096  # at once, for the memory they take
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
    for members in _batches(visit):
        one = np.ptp(white.entry[members], axis=1) == 0
        # Of one point or distance it cannot be determined whether instrument or robot is off.
        rows = members[~one] if members.shape[1] <= 3 else members
        if not len(rows):
            continue
        several += len(rows)
        X, J = white.jacobian[rows], by_joint[rows]
        hat = (X.reshape(-1, len(covariance)) @ covariance).reshape(X.shape) @ np.swapaxes(X, 1, 2)
        share, turn = np.linalg.eigh(np.eye(rows.shape[1]) - hat)
        turned = np.einsum("vji,vj->vi", turn, white.residual[rows]) / np.sqrt(np.maximum(share, ABSORBED))
        residual = np.einsum("vij,vj->vi", turn, turned)
        gram = np.swapaxes(J, 1, 2) @ J
        products[0, 0] += rows.size
        products[0, 1:] += np.einsum("vii->i", gram)
        products[1:, 1:] += np.sum(gram**2, axis=0)
        observed[0] += np.sum(residual**2)
        observed[1:] += np.sum(np.einsum("vji,vj->vi", J, residual) ** 2, axis=0)
    if several < MIN_VISITS:
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
    middle = (shared_moments(white, by_joint, visit, scatter) + precision) * np.outer(size, size)
    balanced = inverse / np.outer(size, size)
    covariance = balanced @ middle @ balanced
    return np.asarray(0.5 * (covariance + covariance.T) * np.outer(size, size))


def shared_moments(white: Whitened, by_joint: Array, visit: Integers, scatter: Scatter) -> Array:
    """Covariance ``(P, P)`` of Jᵀ r, r the whitened noise ``(M,)`` of visits that share where the robot has stopped."""
    out, X = scatter.noise * white.normal, white.jacobian
    for rows in _batches(visit):
        shared = np.swapaxes(by_joint[rows] * scatter.joints, 1, 2) @ X[rows]
        together = shared.reshape(-1, X.shape[1])  # of each visit its own product, P² would be summed as often
        out += together.T @ together
    return np.asarray(out)


def _batches(visit: Integers) -> Iterator[Integers]:
    """The numbers ``(visits, size)`` of visits of one size, a few thousand numbers at once for the memory they take."""
    order = np.argsort(visit, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(visit[order])) + 1)
    by_size: dict[int, list[Integers]] = {}
    for rows in groups:
        by_size.setdefault(len(rows), []).append(rows)
    for size, alike in by_size.items():
        most = max(NUMBERS // max(size, 1), 1)
        for start in range(0, len(alike), most):
            yield np.array(alike[start : start + most])


def sums_over(group: Integers, count: int) -> Callable[[Array], Array]:
    """What sums rows ``(M, ...)`` over groups ``(M,)``: ``(count, ...)``."""
    member = sparse.csr_matrix((np.ones(len(group)), (group, np.arange(len(group)))), shape=(count, len(group)))
    return lambda values: np.asarray(member @ values.reshape(len(group), -1)).reshape(count, *values.shape[1:])
