"""What a model leaves of a signal that it does not have, as measurements are added to the rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from clampid.stages.rows import Array

__all__ = ["Normal", "Rivals", "Signal", "add_measurement", "each_beside_another"]

RIDGE = 1e-10
"""Prior weight of a direction, in units of its own column's: what nothing determines must not explain a new row."""
LARGEST_UPDATED_SPREAD = 1e8
"""In units of a row's variance: an update of what is less certain loses more than half of the digits to rounding."""


@dataclass(frozen=True, eq=False)
class Rivals:
    """Candidates that may explain the same rows.

    Attributes
    ----------
    nuisance, columns
        Whitened columns ``(M, P)`` of what is fitted in any case, and ``(M, k)`` of each candidate, in the rows so far.
    values
        ``(k,)``: what the rows make of each candidate.
    precision
        ``(P, P)``: the prior of what is fitted in any case.
    """

    nuisance: Array
    columns: Sequence[Array]
    values: Sequence[Array]
    precision: Array


class Normal:
    """The normal matrix of what a model fits, as measurements are added. Signals of the same columns share it."""

    def __init__(self, X: Array, precision: Array, pool_X: Array) -> None:
        self.pool_X = pool_X
        self.A = X.T @ X + precision

    @cached_property
    def factor(self) -> tuple[Array, Array]:
        """The balance of its columns, and the lower Cholesky factor of the balanced matrix."""
        balance = 1.0 / np.sqrt(np.maximum(np.diag(self.A), 1e-300))
        A = self.A * np.outer(balance, balance)
        A[np.diag_indices_from(A)] += RIDGE
        return balance, linalg.cholesky(A, lower=True, overwrite_a=True, check_finite=False)

    def solved(self, b: Array) -> Array:
        """The fitted values of right-hand sides ``(P,)``."""
        balance, lower = self.factor
        return np.asarray(balance * linalg.cho_solve((lower, True), balance * b, check_finite=False))

    @cached_property
    def spread(self) -> Array:
        """Covariance ``(K, r, r)`` of each measurement of the pool as a fit predicts it, its own noise with it."""
        balance, lower = self.factor
        count, rows, width = self.pool_X.shape
        flat = (self.pool_X.reshape(-1, width) * balance).T
        half = linalg.solve_triangular(lower, flat, lower=True, overwrite_b=True, check_finite=False)
        half = half.reshape(width, count, rows)
        return np.asarray(np.einsum("pkr,pks->krs", half, half) + np.eye(rows))

    def add(self, k: int) -> None:
        """Add one measurement of the pool."""
        X = self.pool_X[k]
        known = "spread" in self.__dict__ and self.spread.max() < LARGEST_UPDATED_SPREAD
        if known:  # by the matrix inversion lemma: computing it anew takes ten times as long
            balance, lower = self.factor
            solved = balance[:, None] * linalg.cho_solve((lower, True), (X * balance).T, check_finite=False)
            root = linalg.cholesky(self.spread[k], lower=True, check_finite=False)
            solved = linalg.solve_triangular(root, solved.T, lower=True, check_finite=False).T
            half = (self.pool_X.reshape(-1, len(solved)) @ solved).reshape(self.spread.shape)
            self.spread = self.spread - half @ half.transpose(0, 2, 1)
        self.A = self.A + X.T @ X
        for name in ("factor",) if known else ("factor", "spread"):
            self.__dict__.pop(name, None)

    def with_all(self) -> Normal:
        """The same with every measurement of the pool."""
        X = self.pool_X.reshape(-1, self.pool_X.shape[2])
        return Normal(X, self.A, self.pool_X)


class Signal:
    """What a model leaves of a signal that it does not have, as measurements are added."""

    def __init__(self, normal: Normal, X: Array, y: Array, pool_y: Array) -> None:
        self.normal, self.pool_y = normal, pool_y
        self.b, self.squares = X.T @ y, float(y @ y)

    def left(self) -> float:
        """Sum of squares that is left."""
        return max(self.squares - float(self.b @ self.normal.solved(self.b)), 0.0)

    def gains(self) -> Array:
        """By how much each measurement of the pool would raise it, the model fitted again."""
        left = self.pool_y - self.normal.pool_X @ self.normal.solved(self.b)
        return np.asarray(np.einsum("kr,kr->k", left, np.linalg.solve(self.normal.spread, left[..., None])[..., 0]))

    def add(self, k: int) -> None:
        """Add one measurement of the pool to the signal; `Normal.add` adds it to what is fitted."""
        X, y = self.normal.pool_X[k], self.pool_y[k]
        self.b, self.squares = self.b + X.T @ y, self.squares + float(y @ y)

    def with_all(self, whole: Normal) -> float:
        """What is left with every measurement of the pool; ``whole`` is what is fitted then."""
        X, y = self.normal.pool_X.reshape(-1, self.normal.pool_X.shape[2]), self.pool_y.ravel()
        b = self.b + X.T @ y
        return max(self.squares + float(y @ y) - float(b @ whole.solved(b)), 0.0)


def each_beside_another(
    rivals: Rivals, pool_nuisance: Array, pool_columns: Sequence[Array]
) -> dict[tuple[int, int], Signal]:
    """(a, b) → candidate a as a signal beside a fit that has b instead; those beside one b share what is fitted."""
    signals: dict[tuple[int, int], Signal] = {}
    for b, column in enumerate(rivals.columns):
        width = column.shape[1]
        prior = linalg.block_diag(rivals.precision, np.zeros((width, width)))
        X, pool_X = np.c_[rivals.nuisance, column], np.concatenate([pool_nuisance, pool_columns[b]], axis=2)
        normal = Normal(X, prior, pool_X)
        for a, (mine, value) in enumerate(zip(rivals.columns, rivals.values, strict=True)):
            if a != b:
                signals[a, b] = Signal(normal, X, mine @ value, pool_columns[a] @ value)
    return signals


def add_measurement(signals: Sequence[Signal], k: int) -> None:
    """Add a measurement of the pool to signals and, once each, to what is fitted beside them."""
    for signal in signals:
        signal.add(k)
    for normal in {id(s.normal): s.normal for s in signals}.values():
        normal.add(k)
