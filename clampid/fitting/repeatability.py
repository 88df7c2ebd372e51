"""The robot's repeatability as a variance component of pose residuals, and standard errors that include it.

A robot stops with a small random error of each joint. All targets measured before it moves again share this error, so
the numbers of one visit v are correlated. With J_v their derivative by the joints, all whitened::

    cov(r_v) = s^2 I + J_v diag(rho^2) J_v'

The variances s^2 and rho_i^2 (not negative) are fitted to the products of the residuals by MINQUE with prior weight on
s^2 alone: Rao (1971), Estimation of variance and covariance components, J. Multivar. Anal. 1. A fit absorbs part of
each error, so its residuals are too small. They are corrected visit by visit with (1 - H_vv)^(-1/2), H the hat matrix:
Bell and McCaffrey (2002), Bias reduction in standard errors for linear regression with multi-stage samples, Survey
Methodology 28. The estimate stays that of independent numbers; its covariance is then
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

MIN_VISITS = 20  # visits with more than one point or distance; fewer do not determine seven variances
NUMBERS_AT_ONCE = 4096  # residuals in one batch, which limits the memory
LEAST_SHARE_LEFT = 1e-3  # of a number's variance after the fit: a smaller share is not scaled up further


@dataclass(frozen=True)
class Scatter:
    """Variance components of whitened pose residuals.

    Attributes
    ----------
    noise
        s²: variance of the measurement, in units of the assumed one.
    joints
        Standard deviation of the stopping error of each joint ``(n,)``, rad.
    """

    noise: float
    joints: Array


def visit_scatter(white: Whitened, by_joint: Array, visit: Integers, covariance: Array) -> Scatter | None:
    """Variance of measurement and joints from the residuals of a fit; None if too few visits have several points.

    Parameters
    ----------
    white
        Residual ``(M,)`` and Jacobian ``(M, P)`` at the solution.
    by_joint
        Derivative ``(M, n)`` of the same numbers by the joints, whitened, 1/rad.
    visit
        Visit of each number ``(M,)``, from 0.
    covariance
        Covariance ``(P, P)`` of the fit for independent numbers of variance one.
    """
    n = by_joint.shape[1]
    products, observed, several = np.zeros((n + 1, n + 1)), np.zeros(n + 1), 0
    for members in _batches(visit):
        one = np.ptp(white.entry[members], axis=1) == 0
        # A single point or distance does not separate errors of the instrument from errors of the robot.
        rows = members[~one] if members.shape[1] <= 3 else members
        if not len(rows):
            continue
        several += len(rows)
        X, J = white.jacobian[rows], by_joint[rows]
        hat = (X.reshape(-1, len(covariance)) @ covariance).reshape(X.shape) @ np.swapaxes(X, 1, 2)
        share, turn = np.linalg.eigh(np.eye(rows.shape[1]) - hat)
        turned = np.einsum("vji,vj->vi", turn, white.residual[rows]) / np.sqrt(np.maximum(share, LEAST_SHARE_LEFT))
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
    """Covariance ``(P, P)`` of a fit whose weights treated the numbers of a visit as independent (sandwich form).

    Parameters
    ----------
    white, by_joint, visit
        See :func:`visit_scatter`.
    precision
        Precision of the prior ``(P, P)``.
    scatter
        The variance components.
    inverse
        Inverse ``(P, P)`` of the fit's normal matrix, prior included.
    """
    # Scaled for numerical balance: parameters have very different sizes.
    size = np.sqrt(np.maximum(np.diag(inverse), 1e-300))
    middle = (shared_moments(white, by_joint, visit, scatter) + precision) * np.outer(size, size)
    balanced = inverse / np.outer(size, size)
    covariance = balanced @ middle @ balanced
    return np.asarray(0.5 * (covariance + covariance.T) * np.outer(size, size))


def shared_moments(white: Whitened, by_joint: Array, visit: Integers, scatter: Scatter) -> Array:
    """Covariance ``(P, P)`` of Jᵀ r, with r the whitened noise ``(M,)``, correlated within visits."""
    out, X = scatter.noise * white.normal, white.jacobian
    for rows in _batches(visit):
        shared = np.swapaxes(by_joint[rows] * scatter.joints, 1, 2) @ X[rows]
        together = shared.reshape(-1, X.shape[1])  # stacked: one product instead of a sum of P² numbers for each visit
        out += together.T @ together
    return np.asarray(out)


def _batches(visit: Integers) -> Iterator[Integers]:
    """Indices ``(visits, size)`` of the numbers of visits of equal size, at most NUMBERS_AT_ONCE of them at a time."""
    order = np.argsort(visit, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(visit[order])) + 1)
    by_size: dict[int, list[Integers]] = {}
    for rows in groups:
        by_size.setdefault(len(rows), []).append(rows)
    for size, alike in by_size.items():
        most = max(NUMBERS_AT_ONCE // max(size, 1), 1)
        for start in range(0, len(alike), most):
            yield np.array(alike[start : start + most])


def sums_over(group: Integers, count: int) -> Callable[[Array], Array]:
    """A function that sums values ``(M, ...)`` over groups to ``(count, ...)``.

    ``group`` ``(M,)``: number of the group of each value, from 0 to ``count`` - 1.
    """
    member = sparse.csr_matrix((np.ones(len(group)), (group, np.arange(len(group)))), shape=(count, len(group)))
    return lambda values: np.asarray(member @ values.reshape(len(group), -1)).reshape(count, *values.shape[1:])
