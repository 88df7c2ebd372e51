"""The whitened residual of a fit, and the space that its active parameters and priors absorb."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from clampid.effect import WEAK_SPREAD as WEAK_PRIOR
from clampid.evidence.columns import Sums
from clampid.fitting.solve import Estimate
from clampid.stages.fit_problem import FIXED_STD
from clampid.stages.rows import Array, Bools, Integers

__all__ = ["ABSORBED", "Space", "space_of"]

ABSORBED = 1e-6
OPEN_VARIANCE_RATIO = 4.0  # an error twice as large as the prior: it was fixed, and is open
SMALLEST = 1e-3  # share of a unit's noise that a fit leaves: of less, rounding alone would be flipped
ORTHOGONAL = 1e-3  # how near to the identity the second factor must be, for its columns to be exact


@dataclass(frozen=True)
class Space:
    """The whitened residual of a fit, and the span that its active parameters can absorb.

    Attributes
    ----------
    residual
        ``(M + p,)``: rows, then the prior's pseudo-rows; orthogonal to ``basis``.
    basis
        ``(M + p, r)``: orthonormal.
    unit
        ``(M + p,)``: entries with the same number are flipped together.
    scale
        Standard deviation of the residual, about 1.
    rows
        M.
    pseudo_std
        ``(p,)``: standard deviations of the pseudo-rows, 1, or 0 where the prior is too weak to be a measurement.
    """

    residual: Array
    basis: Array
    unit: Integers
    scale: float
    freedom: int
    rows: int
    pseudo_std: Array

    def granting(self, columns: Array) -> Space:
        """The same with whitened columns ``(M, k)`` that are granted to the model: what they explain is no evidence."""
        if not columns.shape[1]:
            return self
        further = np.zeros((len(self.residual), columns.shape[1]))
        further[: self.rows] = columns
        length = np.linalg.norm(further, axis=0)
        further = further[:, length > 0] / length[length > 0]
        Q, R, _ = linalg.qr(further - self.basis @ (self.basis.T @ further), mode="economic", pivoting=True)
        kept = np.asarray(Q, dtype=float)[:, np.abs(np.diag(R)) > np.sqrt(ABSORBED)]
        basis = np.hstack([self.basis, kept - self.basis @ (self.basis.T @ kept)])
        residual = self.residual - kept @ (kept.T @ self.residual)
        freedom = max(self.freedom - kept.shape[1], 1)
        scale = max(float(np.sqrt(residual @ residual / freedom)), 1e-12)
        return replace(self, residual=residual, basis=basis, scale=scale, freedom=freedom)

    @property
    def remembered(self) -> Space:
        """What a verdict needs of it later: not the basis, which is as large as the rows and all that is active."""
        # Copies: a slice of nothing would keep what it was cut from.
        nothing = self.residual[:0].copy(), self.basis[:0].copy(), self.unit[:0].copy()
        return replace(self, residual=nothing[0], basis=nothing[1], unit=nothing[2])

    @cached_property
    def by_unit(self) -> Sums:
        """Each unit's share of a column's product with the residual of the null, U units.

        A fit takes out of each unit's noise what its leverage lets it, so that plain residuals flipped are too small:
        of a hundred poses and seventy parameters by an eighth, which makes hundreds of columns explain "too much".
        Each unit's residual is therefore multiplied by (1 - Q_u Q_u')^(-1/2), which undoes that in the mean. Source:
        Bell and McCaffrey, Bias reduction in standard errors for linear regression with multi-stage samples, Survey
        Methodology 28, 2002 (CR2).
        """
        _, unit = np.unique(self.unit, return_inverse=True)
        return Sums.of(unit, unshrunk(self.residual, self.basis, unit))

    @cached_property
    def basis_by_unit(self) -> Array:
        """``(U, r)``: the same of the basis."""
        return np.asarray(self.by_unit.over(0, len(self.basis)) @ self.basis)

    @cached_property
    def drawn(self) -> Bools:
        """``(U,)``: which units are a prior's pseudo-rows, each one of its own, after those of rows."""
        return np.arange(self.by_unit.groups) >= self.by_unit.groups - (len(self.residual) - self.rows)


def unshrunk(residual: Array, basis: Array, unit: Integers) -> Array:
    """The residual ``(M,)`` of each unit as large as its noise was before a fit with that basis took its share."""
    out = residual.copy()
    order = np.argsort(unit, kind="stable")
    for entries in np.split(order, np.flatnonzero(np.diff(unit[order])) + 1):
        Q_u = basis[entries]
        left, size, _ = np.linalg.svd(Q_u, full_matrices=False)
        share = np.minimum(size**2, 1.0 - SMALLEST)
        out[entries] += left @ ((1.0 / np.sqrt(1.0 - share) - 1.0) * (left.T @ residual[entries]))
    return out


def space_of(estimate: Estimate, unit: Integers | None = None) -> Space:
    """The residual and absorbed span of an estimate; ``unit`` ``(N,)``: what the null flips, else the rows' own."""
    white = estimate.whitened
    size = estimate.problem.sizes()
    precision = _opened(estimate)
    values, vectors = np.linalg.eigh(precision * np.outer(size, size))
    root = (vectors * np.sqrt(np.maximum(values, 0.0))).T / size  # root' root = precision
    # A weak prior is no measurement: a tool mounted half a turn from where the description has it is no residual.
    weak = 1.0 / np.sqrt(np.diag(precision)) >= (1.0 - 1e-9) * WEAK_PRIOR * size
    residual = np.r_[white.residual, root @ np.where(weak, 0.0, estimate.prior_mean - estimate.theta)]
    jacobian = np.vstack([white.jacobian, root])
    norms = np.sqrt(np.einsum("mp,mp->p", jacobian, jacobian))  # without a table of squares
    jacobian /= np.where(norms > 0, norms, 1.0)
    basis = _span(jacobian)
    del jacobian
    residual = residual - basis @ (basis.T @ residual)
    count = len(white.residual)
    unit = (estimate.problem.rows.unit if unit is None else unit)[white.entry]
    units = np.r_[unit, unit.max(initial=0) + 1 + np.arange(len(root))]
    freedom = max(count - basis.shape[1], 1)
    scale = float(np.sqrt(residual @ residual / freedom))
    pseudo_std = np.linalg.norm(vectors[~weak], axis=0)
    return Space(residual, basis, units, max(scale, 1e-12), freedom, count, pseudo_std)


def _span(A: Array) -> Array:
    """An orthonormal basis ``(M, k)`` of the columns, of length one or zero, of ``A`` ``(M, P)``.

    By Cholesky factors, twice, where the columns are independent enough for it: a fifth of the work where they are
    many. Source: Yamamoto, Nakatsukasa, Yanagisawa, Fukaya, Roundoff error analysis of the CholeskyQR2 algorithm,
    Electron. Trans. Numer. Anal. 44, 2015. Else by pivots.
    """
    Q = A
    try:
        for _ in range(2):
            R = linalg.cholesky(Q.T @ Q, check_finite=False)
            Q = linalg.solve_triangular(R, Q.T, trans="T", check_finite=False).T
        if np.abs(R - np.eye(len(R))).max(initial=0.0) < ORTHOGONAL:
            return np.asarray(Q)
    except linalg.LinAlgError:
        pass
    Q, R, _ = linalg.qr(A, mode="economic", pivoting=True)
    size = np.abs(np.diag(R))
    return np.asarray(Q, dtype=float)[:, : int(np.sum(size > 1e-10 * size.max(initial=0.0)))]


def _opened(estimate: Estimate) -> Array:
    """The prior's precision ``(P, P)``, of what a fit has fixed that of its error instead.

    A friction is fixed where flanks determine it (:mod:`clampid.fitting.rest_friction`), and may be anything within its
    error: what it would explain then is no evidence of anything else.
    """
    precision = estimate.prior_precision.copy()
    variance, tight = np.diag(estimate.covariance), (FIXED_STD * estimate.problem.sizes()) ** -2.0
    open_ = (variance * tight > OPEN_VARIANCE_RATIO) & ~estimate.problem.fixed()
    fixed = np.flatnonzero(open_ & (np.diag(precision) > 0.5 * tight))
    precision[fixed, :] = precision[:, fixed] = 0.0
    precision[fixed, fixed] = 1.0 / variance[fixed]
    return precision
