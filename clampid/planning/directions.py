"""Balanced approach directions: both signs equally often, and uncorrelated with posture, time and the other joints.

Backlash is identified by what changes with a joint's approach direction. If directions are correlated with posture,
backlash is confounded with geometry and springs. Therefore both signs are made equally frequent. Signs are then
exchanged in pairs while this brings them closer to being orthogonal to the covariates and to the other joints' signs.
Source: Atkinson and Donev, Experimental designs optimally balanced for trend, Technometrics 38, 1996 (exchange; factors
orthogonal to nuisance covariates).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clampid.stages.rows import Array

__all__ = ["balanced", "confounded", "covariates_of"]

BALANCING_PASSES = 4  # over all joints
MAX_SWAPS = 200  # of one joint in a pass
SWAPS_TRIED = 10  # the best swaps tested for feasibility before a joint is left as it is
LEAST_GAIN = 1e-6  # of the confounding sᵀ K s: smaller reductions do not count
Feasible = Callable[[int, Array], bool]


def covariates_of(q: Array, load: Array | None = None) -> Array:
    """Covariates that could be confounded with backlash ``(N, k)``: order, sin and cos of the joints, their loads.

    Parameters
    ----------
    q
        Joint angles ``(N, n)``, rad, in the order of the visits.
    load
        Joint torques ``(N, n)``, Nm; None: without.
    """
    order = np.linspace(-1.0, 1.0, len(q))[:, None]
    return np.hstack([order, np.sin(q), np.cos(q), *(() if load is None else (load,))])


def _basis(covariates: Array) -> Array:
    """Orthonormal basis ``(N, r)`` of the centred covariates ``(N, k)``."""
    centred = covariates - covariates.mean(axis=0)
    U, s, _ = np.linalg.svd(centred / np.maximum(np.linalg.norm(centred, axis=0), 1e-12), full_matrices=False)
    return np.asarray(U[:, s > 1e-6])


def balanced(start: Array, covariates: Array, feasible: Feasible = lambda pose, signs: True) -> Array:
    """Balanced approach signs ``(N, n)``, ±1, found by local exchange from ``start``.

    Parameters
    ----------
    start
        Feasible signs ``(N, n)``, ±1.
    covariates
        ``(N, k)``, see :func:`covariates_of`.
    feasible
        Whether the pose of a number may be approached with signs ``(n,)``.
    """
    signs = np.array(start, dtype=float)
    basis = _basis(covariates)
    for _ in range(BALANCING_PASSES):
        before = signs.copy()
        for j in range(signs.shape[1]):
            others = np.delete(signs, j, axis=1)
            kernel = basis @ basis.T + others @ others.T / len(signs)
            _equalise(signs, j, kernel, feasible)
            _swap(signs, j, kernel, feasible)
        if np.array_equal(signs, before):
            break
    return signs


def _flip_gain(s: Array, kernel: Array) -> Array:
    """Reduction of sᵀ K s ``(N,)`` if a single sign of ``s`` ``(N,)`` is changed; ``kernel``: K ``(N, N)``."""
    return np.asarray(4 * s * (kernel @ s) - 4 * np.diag(kernel))


def _equalise(signs: Array, j: int, kernel: Array, feasible: Feasible) -> None:
    """Change signs of joint ``j``, those with the least increase of confounding, until both are equally frequent."""
    while abs(signs[:, j].sum()) > 1:
        surplus = np.sign(signs[:, j].sum())
        gain = np.where(signs[:, j] == surplus, _flip_gain(signs[:, j], kernel), -np.inf)
        for i in np.argsort(-gain)[: int((signs[:, j] == surplus).sum())]:
            if _changed(signs, j, (int(i),), feasible):
                break
        else:
            return


def _swap(signs: Array, j: int, kernel: Array, feasible: Feasible) -> None:
    """Change pairs of opposite signs of joint ``j`` while the confounding sᵀ K s falls."""
    for _ in range(MAX_SWAPS):
        s = signs[:, j]
        up, down = np.flatnonzero(s > 0), np.flatnonzero(s < 0)
        alone = _flip_gain(s, kernel)
        gain = alone[up][:, None] + alone[down][None, :] + 8 * kernel[np.ix_(up, down)]
        for place in np.argsort(-gain, axis=None)[:SWAPS_TRIED]:
            a, b = np.unravel_index(place, gain.shape)
            if gain[a, b] <= LEAST_GAIN:
                return
            if _changed(signs, j, (int(up[a]), int(down[b])), feasible):
                break
        else:
            return


def _changed(signs: Array, j: int, poses: tuple[int, ...], feasible: Feasible) -> bool:
    """Change a joint's signs at some poses if all of these stay feasible; whether it was done."""
    rows = [signs[i].copy() for i in poses]
    for row in rows:
        row[j] = -row[j]
    if not all(feasible(i, row) for i, row in zip(poses, rows, strict=True)):
        return False
    for i, row in zip(poses, rows, strict=True):
        signs[i] = row
    return True


def confounded(signs: Array, covariates: Array) -> Array:
    """Adjusted R² ``(n,)``: share of the variance of each joint's signs that the covariates explain.

    0: uncorrelated with posture and time; 1: determined by them. ``signs`` ``(N, n)``, ``covariates`` ``(N, k)``.
    """
    centred = signs - signs.mean(axis=0)
    basis = _basis(covariates)
    total = np.sum(centred**2, axis=0)
    share = np.sum((basis.T @ centred) ** 2, axis=0) / np.maximum(total, 1e-12)
    left = len(signs) - 1 - basis.shape[1]
    if left <= 0:
        return np.ones(signs.shape[1])
    corrected = 1 - (1 - share) * (len(signs) - 1) / left
    return np.where(total > 0, np.clip(corrected, 0.0, 1.0), 1.0)
