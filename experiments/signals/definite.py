"""Many small systems of equations at once."""

from __future__ import annotations

import numpy as np

from experiments.signals.typing_ import Array

__all__ = ["solve_definite"]


def solve_definite(matrices: Array, right: Array) -> Array:
    """Solutions ``(d, B)`` of B systems: symmetric positive definite matrices ``(d, d, B)``, right sides ``(d, B)``.

    By Cholesky's factors, column by column for all systems together: a call of LAPACK for each would take longer than
    its arithmetic. Source: Golub & Van Loan, Matrix Computations (2013), section 4.2.5.
    """
    d = len(matrices)
    factor, x = np.zeros(matrices.shape), np.array(right, dtype=np.float64)
    for j in range(d):
        column = matrices[j:, j] - np.einsum("ipb,pb->ib", factor[j:, :j], factor[j, :j])
        factor[j:, j] = column / np.sqrt(column[0])
        x[j] = (x[j] - np.einsum("pb,pb->b", factor[j, :j], x[:j])) / factor[j, j]
    for j in reversed(range(d)):
        x[j] = (x[j] - np.einsum("pb,pb->b", factor[j + 1 :, j], x[j + 1 :])) / factor[j, j]
    return x
