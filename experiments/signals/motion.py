"""States of motion: when a joint counts as at rest, and which way it last moved."""

from __future__ import annotations

import numpy as np

from experiments.signals.typing_ import Array, Integers

__all__ = ["held_sign", "rest_threshold"]


def rest_threshold(speed: Array) -> Array:
    """The speed ``(n,)`` below which a joint counts as at rest.

    Eight times what the slowest quarter of the log shows (at rest that is the noise of the speed), and at most 2 % of
    the top speed, for a joint that hardly ever rests.
    """
    size = np.abs(speed)
    quarter = np.quantile(size, 0.125, axis=0)
    return np.asarray(np.minimum(8.0 * quarter, 0.02 * size.max(axis=0)) + 1e-12)


def held_sign(speed: Array, threshold: Array, run: Integers) -> Array:
    """Sign of the present or, at rest, of the last motion in the run ``(N, n)``; 0 before the first."""
    sign = np.where(np.abs(speed) > threshold, np.sign(speed), 0.0)
    start = np.r_[True, run[1:] != run[:-1]]
    out = np.zeros_like(sign)
    index = np.arange(len(sign))
    first = np.maximum.accumulate(np.where(start, index, 0))
    for j in range(sign.shape[1]):
        last = np.maximum.accumulate(np.where(sign[:, j] != 0, index, -1))
        known = last >= first
        out[known, j] = sign[last[known], j]
    return out
