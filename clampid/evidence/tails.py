"""Logarithms of p-values, also where these are smaller than the smallest number."""

from __future__ import annotations

import numpy as np
from scipy.special import betainc, betaln, gammainc, gammaincc, gammaln, hyp2f1

from clampid.stages.rows import Array

__all__ = ["log_tail", "log_tail_of_f"]

SMALLEST_TAIL = 1e-290  # a smaller tail than this may have underflowed


def log_tail(x: Array | float, freedom: float) -> Array:
    """Natural logarithm of the upper chi-square tail probability of ``x``, also where that underflows."""
    value = np.asarray(x, dtype=float)
    a, half = freedom / 2.0, np.maximum(value, 1e-300) / 2.0  # zero has no logarithm
    tail = gammaincc(a, half)
    tiny = tail < SMALLEST_TAIL
    tail_or_one = np.where(tiny, 1.0, tail)
    near = np.where(half < a, np.log1p(-gammainc(a, np.minimum(half, a))), np.log(tail_or_one))
    # Leading term of its expansion, summed as a geometric series; where the tail is tiny, half is well above a.
    far = a * np.log(half) - half - float(gammaln(a)) - np.log(np.where(tiny, half - a + 1.0, 1.0))
    return np.asarray(np.where(tiny, far, near))


def log_tail_of_f(ratio: Array, first: float, second: float) -> Array:
    """Natural logarithm of the upper tail of the F distribution with ``first`` and ``second`` degrees of freedom.

    ``ratio``: of the two mean squares.
    """
    a, b = second / 2.0, first / 2.0
    x = second / (second + first * np.asarray(ratio, dtype=float))
    tail = betainc(a, b, x)
    tiny = tail < SMALLEST_TAIL
    small = np.where(tiny, x, 0.5)
    series = a * np.log(small) + b * np.log1p(-small) - np.log(a) - betaln(a, b)
    far = series + np.log(hyp2f1(a + b, 1.0, a + 1.0, small))
    return np.asarray(np.where(tiny, far, np.log(np.where(tiny, 1.0, tail))))
