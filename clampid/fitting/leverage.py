"""Leverage of rows, and studentised residuals.

With leverage h, a row's residual is r = (1 - h) d, where d is the error of the prediction by a fit without that row. An
outlier of large leverage therefore has a small residual. Divided by sqrt(1 - h), all residuals have the same variance
(studentised residuals), and the outlier shows. Source: Cook & Weisberg, Residuals and Influence in Regression, 1982,
section 2.1.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from clampid.stages.rows import Array

__all__ = ["root_of_inverse", "share_left"]

LEAST_SHARE = 1e-12  # of 1 - h: zero for a row that alone determines a parameter, whose residual is zero too
RESOLVED = 1e-12  # eigenvalue of a balanced normal matrix over the largest one: below this it counts as zero


def root_of_inverse(normal: Array) -> Array:
    """R ``(P, k)`` with R Rᵀ the pseudo-inverse of a normal matrix ``(P, P)``."""
    size = np.sqrt(np.maximum(np.diag(normal), 0.0))
    balance = np.where(size > 0.0, 1.0 / np.maximum(size, 1e-300), 0.0)
    values, vectors = linalg.eigh(normal * np.outer(balance, balance))
    shown = values > RESOLVED * max(float(values[-1]), 1e-300)
    return np.asarray(balance[:, None] * vectors[:, shown] / np.sqrt(values[shown]))


def share_left(jacobian: Array, root: Array) -> Array:
    """sqrt(1 - h) ``(k,)`` of rows: divided by it, their residuals are studentised.

    Parameters
    ----------
    jacobian
        Whitened, ``(k, P)``.
    root
        ``(P, c)``: :func:`root_of_inverse` of the normal matrix with its prior.
    """
    shown = np.any(jacobian, axis=0)  # rows of one motor show a third of a log's parameters
    if np.count_nonzero(shown) < root.shape[1]:
        jacobian, root = jacobian[:, shown], linalg.qr(root[shown].T, mode="r")[0][: np.count_nonzero(shown)].T
    leverage = np.sum((jacobian @ root) ** 2, axis=1)
    return np.asarray(np.sqrt(np.maximum(1.0 - leverage, LEAST_SHARE)))
