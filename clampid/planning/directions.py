"""Approach directions: from both sides equally often, and unrelated to posture, time, and each other's.

Backlash shows as what changes with a joint's approach direction. Where directions go along with posture it is taken for
geometry or a spring, and the reverse. So both sides are made equally frequent, and
signs are then exchanged in pairs as long as that brings them nearer to being orthogonal to the covariates and to the
other joints' signs. Source: Atkinson and Donev, Experimental
designs optimally balanced for trend, Technometrics 38, 1996 (exchange; factors orthogonal to nuisance covariates).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clampid.stages.rows import Array

__all__ = ["balanced", "confounded", "covariates_of"]

BALANCING_PASSES = 4  # over all joints
SWAPS = 200  # of one joint in a pass
SWAPS_TRIED = 10  # swaps that are looked at before a joint is left as it is
GAIN = 1e-6
Feasible = Callable[[int, Array], bool]


def covariates_of(q: Array, load: Array | None = None) -> Array:
    """What posture and time could pass off as backlash ``(N, k)``: order, sin and cos of the joints, their loads.

    Parameters
    ----------
    q
        ``(N, n)`` rad, in the order in which they are visited.
    load
        Joint torques ``(N, n)``, Nm.
    """
    order = np.linspace(-1.0, 1.0, len(q))[:, None]
    return np.hstack([order, np.sin(q), np.cos(q), *(() if load is None else (load,))])


def _basis(covariates: Array) -> Array:
    """Orthonormal columns ``(N, r)`` for what the covariates vary by, their means taken off."""
    centred = covariates - covariates.mean(axis=0)
    U, s, _ = np.linalg.svd(centred / np.maximum(np.linalg.norm(centred, axis=0), 1e-12), full_matrices=False)
    return np.asarray(U[:, s > 1e-6])


def balanced(start: Array, covariates: Array, feasible: Feasible = lambda pose, signs: True) -> Array:
    """Signs ``(N, n)`` of ±1 near ``start`` that are balanced.

    Parameters
    ----------
    start
        ``(N, n)`` ±1, feasible.
    covariates
        ``(N, k)``, see `covariates_of`.
    feasible
        Whether a pose (by its number) may be approached with signs ``(n,)``.
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
    """By how much sᵀ K s falls when each sign of ``s`` ``(N,)`` alone is turned ``(N,)``."""
    return np.asarray(4 * s * (kernel @ s) - 4 * np.diag(kernel))


def _equalise(signs: Array, j: int, kernel: Array, feasible: Feasible) -> None:
    """Turn signs of a joint's surplus side, those that cost least, until both sides are as frequent."""
    while abs(signs[:, j].sum()) > 1:
        surplus = np.sign(signs[:, j].sum())
        gain = np.where(signs[:, j] == surplus, _flip_gain(signs[:, j], kernel), -np.inf)
        for i in np.argsort(-gain)[: int((signs[:, j] == surplus).sum())]:
            if _turned(signs, j, (int(i),), feasible):
                break
        else:
            return


def _swap(signs: Array, j: int, kernel: Array, feasible: Feasible) -> None:
    """Turn one sign up and one down as long as that lowers what the joint's signs share with what they must not."""
    for _ in range(SWAPS):
        s = signs[:, j]
        up, down = np.flatnonzero(s > 0), np.flatnonzero(s < 0)
        alone = _flip_gain(s, kernel)
        gain = alone[up][:, None] + alone[down][None, :] + 8 * kernel[np.ix_(up, down)]
        for place in np.argsort(-gain, axis=None)[:SWAPS_TRIED]:
            a, b = np.unravel_index(place, gain.shape)
            if gain[a, b] <= GAIN:
                return
            if _turned(signs, j, (int(up[a]), int(down[b])), feasible):
                break
        else:
            return


def _turned(signs: Array, j: int, poses: tuple[int, ...], feasible: Feasible) -> bool:
    """Turn a joint's signs at some poses, if all of them may be approached so; whether it was done."""
    rows = [signs[i].copy() for i in poses]
    for row in rows:
        row[j] = -row[j]
    if not all(feasible(i, row) for i, row in zip(poses, rows, strict=True)):
        return False
    for i, row in zip(poses, rows, strict=True):
        signs[i] = row
    return True


def confounded(signs: Array, covariates: Array) -> Array:
    """Share of each joint's directions ``(n,)`` that the covariates explain (R²), corrected for their number.

    0: unrelated to posture and time, 1: determined by them. ``signs`` ``(N, n)``, ``covariates`` ``(N, k)``.
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
