"""Leverage: how much a row decides its own prediction, and residuals in units of what it leaves of their error.

The residual of a row is as small as its leverage h is near one, whatever was measured: r = (1 - h) d, where d is what
the fit without that row mispredicts. A wrong row of large leverage therefore hides in its own residual. Divided by
sqrt(1 - h) all residuals have one variance, and it shows (studentised residuals; Cook & Weisberg, Residuals and
Influence in Regression, 1982, section 2.1).
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from clampid.stages.rows import Array

__all__ = ["root_of_inverse", "share_left"]

LEAST_SHARE = 1e-12  # rounding: a row that alone decides a parameter leaves nothing, and is zero over zero
RESOLVED = 1e-12  # of the largest eigenvalue of a balanced normal matrix


def root_of_inverse(normal: Array) -> Array:
    """Return R ``(P, k)`` with R Rᵀ the inverse of a normal matrix ``(P, P)``, but for what no row shows."""
    size = np.sqrt(np.maximum(np.diag(normal), 0.0))
    balance = np.where(size > 0.0, 1.0 / np.maximum(size, 1e-300), 0.0)
    values, vectors = linalg.eigh(normal * np.outer(balance, balance))
    shown = values > RESOLVED * max(float(values[-1]), 1e-300)
    return np.asarray(balance[:, None] * vectors[:, shown] / np.sqrt(values[shown]))


def share_left(jacobian: Array, root: Array) -> Array:
    """Return sqrt(1 - h) ``(k,)`` of rows with the whitened Jacobian ``(k, P)``: their residual's share of its error.

    Parameters
    ----------
    root
        ``(P, c)``: :func:`root_of_inverse` of the normal matrix with its prior.
    """
    leverage = np.sum((jacobian @ root) ** 2, axis=1)
    return np.asarray(np.sqrt(np.maximum(1.0 - leverage, LEAST_SHARE)))
