"""Which further measurements part look-alikes: the T-criterion, the other explanation fitted again each time.

If one of two candidates is what is there, of the size that the rows show, how much of it would a model with the other
one instead leave unexplained? That sum of squares, in units of the noise, is what a measurement is to make large.
Source: Atkinson & Fedorov, The design of experiments for discriminating between two rival models, Biometrika 62, 1975.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy import linalg

from clampid.stages.rows import Array

__all__ = ["Parting", "part"]


@dataclass(frozen=True)
class Parting:
    """Measurements chosen from a pool.

    Attributes
    ----------
    chosen
        Numbers in the pool, in the order of their choice.
    before, after
        What the closest pair leaves unexplained of each other, in units of variance: now, and with these.
    """

    chosen: tuple[int, ...]
    before: float
    after: float


class _Pair:
    """What a model with one candidate leaves of the other one's signal, as measurements are added."""

    def __init__(self, X: Array, y: Array, precision: Array, pool_X: Array, pool_y: Array) -> None:
        self.pool_X, self.pool_y = pool_X, pool_y
        self.A, self.b, self.squares = X.T @ X + precision, X.T @ y, float(y @ y)

    def solved(self) -> tuple[float, Array, Array]:
        """What is left, the fitted values and the inverse of the normal matrix."""
        balance = 1.0 / np.sqrt(np.maximum(np.diag(self.A), 1e-300))
        inverse = linalg.pinvh(self.A * np.outer(balance, balance)) * np.outer(balance, balance)
        fitted = inverse @ self.b
        return max(self.squares - float(self.b @ fitted), 0.0), fitted, inverse

    def gains(self) -> Array:
        """By how much each measurement of the pool would raise it, the model fitted again."""
        _, fitted, inverse = self.solved()
        left = self.pool_y - self.pool_X @ fitted
        spread = self.pool_X @ inverse @ np.swapaxes(self.pool_X, 1, 2) + np.eye(left.shape[1])
        return np.asarray(np.einsum("kr,kr->k", left, np.linalg.solve(spread, left[..., None])[..., 0]))

    def add(self, k: int) -> None:
        X, y = self.pool_X[k], self.pool_y[k]
        self.A, self.b, self.squares = self.A + X.T @ X, self.b + X.T @ y, self.squares + float(y @ y)


def part(
    nuisance: Array,
    columns: Sequence[Array],
    values: Sequence[Array],
    precision: Array,
    pool_nuisance: Array,
    pool_columns: Sequence[Array],
    *,
    enough: float,
    batch: int,
    most: int,
) -> Parting:
    """Choose measurements that part candidates, greedily, always for the pair that is closest, in batches.

    Parameters
    ----------
    nuisance, columns
        Whitened columns ``(M, P)`` of what is fitted in any case, and ``(M, k)`` of each candidate, in the rows so far.
    values
        ``(k,)``: what the rows make of each candidate.
    precision
        ``(P, P)``: the prior of what is fitted in any case.
    pool_nuisance, pool_columns
        The same columns in measurements to choose from: ``(K, r, P)`` and ``(K, r, k)`` each.
    enough
        What the closest pair shall leave of each other; then no further batch is added.
    batch, most
        Measurements in a batch, and in all.
    """
    pairs = []
    for a, b in permutations(range(len(columns)), 2):
        width = columns[b].shape[1]
        prior = linalg.block_diag(precision, np.zeros((width, width)))
        X, pool_X = np.c_[nuisance, columns[b]], np.concatenate([pool_nuisance, pool_columns[b]], axis=2)
        pairs.append(_Pair(X, columns[a] @ values[a], prior, pool_X, pool_columns[a] @ values[a]))
    left = [pair.solved()[0] for pair in pairs]
    before, chosen = min(left), list[int]()
    while min(left) < enough and len(chosen) < min(most, len(pool_nuisance)):
        for _ in range(batch):
            gains = pairs[int(np.argmin(left))].gains()
            gains[chosen] = -np.inf
            chosen.append(int(np.argmax(gains)))
            for pair in pairs:
                pair.add(chosen[-1])
            left = [pair.solved()[0] for pair in pairs]
    return Parting(tuple(chosen), before, min(left))
