"""The whitened residual of a fit, and the space that its active parameters and priors absorb."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg, sparse

from clampid.effect import WEAK_SPREAD as WEAK_PRIOR
from clampid.evidence.columns import Sums
from clampid.fitting.solve import Estimate
from clampid.stages.fit_problem import FIXED_STD
from clampid.stages.rows import Array, Bools, Integers

__all__ = ["ABSORBED", "Space", "space_of", "unshrunk"]

ABSORBED = 1e-6  # squared share of a direction that is left after projection: with less, it is absorbed
OPEN_VARIANCE_RATIO = 4.0  # a parameter whose standard error is twice its fixing prior was fixed by the fit itself
SMALLEST_NOISE_LEFT = 1e-3  # share of a unit's noise that a fit leaves: less is rounding error and is not corrected
OUTSIDE = 1e-5  # share of a unit column outside those before it: with less, columns are not independent enough
ORTHOGONAL = 1e-3  # how near the second Cholesky factor must be to the identity for an orthonormal basis


@dataclass(frozen=True)
class Space:
    """The whitened residual of a fit, and the span that its active parameters can absorb.

    Attributes
    ----------
    residual
        ``(M + p,)``: entries of the rows, then the prior's pseudo-rows; orthogonal to ``basis``.
    basis
        ``(M + p, r)``: orthonormal.
    unit
        ``(M + p,)``: entries with the same number are flipped together.
    scale
        Standard deviation of the residual, about 1.
    freedom
        Degrees of freedom of the residual.
    rows
        M, the number of entries of the rows.
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
        """The same with further whitened columns ``(M, k)`` in the span that the model can absorb."""
        if not columns.shape[1]:
            return self
        further = np.zeros((len(self.residual), columns.shape[1]))
        further[: self.rows] = columns
        length = np.linalg.norm(further, axis=0)
        further = further[:, length > 0] / length[length > 0]
        further -= self.basis @ (self.basis.T @ further)
        left, turn = np.linalg.eigh(further.T @ further)
        kept = further @ (turn[:, left > ABSORBED] / np.sqrt(left[left > ABSORBED]))
        basis = np.hstack([self.basis, kept - self.basis @ (self.basis.T @ kept)])
        residual = self.residual - kept @ (kept.T @ self.residual)
        freedom = max(self.freedom - kept.shape[1], 1)
        scale = max(float(np.sqrt(residual @ residual / freedom)), 1e-12)
        return replace(self, residual=residual, basis=basis, scale=scale, freedom=freedom)

    @property
    def remembered(self) -> Space:
        """The same without its large arrays: scale and degrees of freedom, which a verdict needs later."""
        # Copies: an empty slice would keep the whole array in memory.
        nothing = self.residual[:0].copy(), self.basis[:0].copy(), self.unit[:0].copy()
        return replace(self, residual=nothing[0], basis=nothing[1], unit=nothing[2])

    @cached_property
    def by_unit(self) -> Sums:
        """Sums that give each of U units' share in a column's product with the residual, under the null.

        A fit absorbs part of each unit's noise, according to its leverage. Flipped residuals are therefore too small:
        by an eighth for a hundred poses and seventy parameters, so that candidates with hundreds of columns seem
        significant. Each unit's residual is multiplied by (1 - Q_u Q_u')^(-1/2), which corrects this on average.
        Source: Bell and McCaffrey, Bias reduction in standard errors for linear regression with multi-stage samples,
        Survey Methodology 28, 2002 (CR2).
        """
        _, unit = np.unique(self.unit, return_inverse=True)
        return Sums.of(unit, unshrunk(self.residual, self.basis, unit))

    @cached_property
    def basis_by_unit(self) -> Array:
        """``(U, r)``: each unit's share in the products of the basis with the residual, under the null."""
        return np.asarray(self.by_unit.over(0, len(self.basis)) @ self.basis)

    @cached_property
    def over_units(self) -> sparse.csr_array:
        """``(U, M + p)``: sums over the entries of each of U units, pseudo-rows included."""
        _, unit = np.unique(self.unit, return_inverse=True)
        return sparse.csr_array(
            (np.ones(len(unit)), (unit, np.arange(len(unit)))), shape=(self.by_unit.groups, len(unit))
        )

    @cached_property
    def drawn(self) -> Bools:
        """``(U,)``: which units are pseudo-rows of the prior; each is a unit of its own, after the units of rows."""
        return np.arange(self.by_unit.groups) >= self.by_unit.groups - (len(self.residual) - self.rows)

    def signs(self, count: int, seed: int) -> Array:
        """Random factors ``(count, U)`` of the units: signs, and normal numbers for pseudo-rows of the prior."""
        rng = np.random.default_rng(seed)
        out = rng.choice([-1.0, 1.0], size=(count, self.by_unit.groups))
        out[:, self.drawn] = rng.normal(size=(count, int(self.drawn.sum())))
        return np.asarray(out)


def unshrunk(residual: Array, basis: Array, unit: Integers) -> Array:
    """The residual ``(M,)`` of each unit, corrected for the share of its noise that a fit with that basis absorbed."""
    out = residual.copy()
    for entries in _entries_of(unit):
        Q_u = basis[entries]
        # Not by singular values: where they span twenty decades, LAPACK's quick routine now and then finds none.
        tall = len(Q_u) > Q_u.shape[1]
        share, turn = np.linalg.eigh(Q_u.T @ Q_u if tall else Q_u @ Q_u.T)
        left = np.sqrt(1.0 - np.clip(share, 0.0, 1.0 - SMALLEST_NOISE_LEFT))
        if tall:  # (1 / left - 1) / share, without cancellation where the share is small
            out[entries] += Q_u @ (turn @ (turn.T @ (Q_u.T @ residual[entries]) / (left * (1.0 + left))))
        else:
            out[entries] += turn @ ((1.0 / left - 1.0) * (turn.T @ residual[entries]))
    return out


def _entries_of(unit: Integers) -> list[Integers]:
    """The entries of each unit, in the order of their numbers."""
    order = np.argsort(unit, kind="stable").astype(np.int64)
    return np.split(order, np.flatnonzero(np.diff(unit[order])) + 1)


def space_of(estimate: Estimate, unit: Integers | None = None) -> Space:
    """The residual of an estimate and the span that it absorbs.

    Parameters
    ----------
    estimate
        The fit.
    unit
        ``(N,)``: rows with the same number are flipped together; by default those of ``rows.unit``.
    """
    white = estimate.whitened
    size = estimate.problem.sizes()
    precision = _opened(estimate)
    values, vectors = np.linalg.eigh(precision * np.outer(size, size))
    root = (vectors * np.sqrt(np.maximum(values, 0.0))).T / size  # root' root = precision
    # A weak prior is no measurement: a tool mounted half a turn from its description is no evidence.
    weak = 1.0 / np.sqrt(np.diag(precision)) >= (1.0 - 1e-9) * WEAK_PRIOR * size
    residual = np.r_[white.residual, root @ np.where(weak, 0.0, estimate.prior_mean - estimate.theta)]
    jacobian = np.vstack([white.jacobian, root])
    norms = np.sqrt(np.einsum("mp,mp->p", jacobian, jacobian))  # needs no table of squares
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
    """An orthonormal basis ``(M, k)`` of the columns of ``A`` ``(M, P)``, which have length one or zero.

    By CholeskyQR2 where the columns are independent enough: a fifth of the work for many columns, and in place, so that
    ``A`` changes. Else by pivoted QR. Source: Yamamoto, Nakatsukasa, Yanagisawa, Fukaya, Roundoff error analysis of the
    CholeskyQR2 algorithm, Electron. Trans. Numer. Anal. 44, 2015.
    """
    Q = A
    try:
        for number in range(2):
            R = linalg.cholesky(Q.T @ Q, check_finite=False)
            if not number and np.diag(R).min(initial=1.0) < OUTSIDE:
                break
            Q = linalg.solve_triangular(R, Q.T, trans="T", overwrite_b=True, check_finite=False).T
        if np.abs(R - np.eye(len(R))).max(initial=0.0) < ORTHOGONAL:
            return np.asarray(Q)
    except linalg.LinAlgError:
        pass
    Q, R, _ = linalg.qr(Q, mode="economic", pivoting=True)
    size = np.abs(np.diag(R))
    return np.asarray(Q, dtype=float)[:, : int(np.sum(size > 1e-10 * size.max(initial=0.0)))]


def _opened(estimate: Estimate) -> Array:
    """The prior's precision ``(P, P)``; where the fit fixed a value, its standard error replaces the fixing prior.

    A dry friction is fixed where flanks determine it (:mod:`clampid.fitting.rest_friction`). It may still be wrong by
    its standard error, and what it then explains is no evidence for another effect.
    """
    precision = estimate.prior_precision.copy()
    variance, tight = np.diag(estimate.covariance), (FIXED_STD * estimate.problem.sizes()) ** -2.0
    open_ = (variance * tight > OPEN_VARIANCE_RATIO) & ~estimate.problem.fixed()
    fixed = np.flatnonzero(open_ & (np.diag(precision) > 0.5 * tight))
    precision[fixed, :] = precision[:, fixed] = 0.0
    precision[fixed, fixed] = 1.0 / variance[fixed]
    return precision
