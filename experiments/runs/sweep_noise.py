"""Noise of the motors at rest during sweeps, from the difference of the two loops.

A sweep makes the same loop twice. Any torque that follows the driven joint, a tilt of the block included, therefore
lies at even multiples of one period per sweep. Torque at odd multiples is noise, whose power changes little from one
multiple to the next. Its power at the multiple 2h is the mean of those at 2h - 1 and 2h + 1. A straight drift adds a
step between the loops to the odd ones. It is removed, and of the first multiple only the half without it is used. Each
motor has its own variance; all have one spectrum, because their torques pass the same filter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from experiments.plans.motion import Array
from experiments.runs.slips import SweepRows

__all__ = ["Noise", "alike", "line", "noise_of", "waves"]

LEAST_ROWS = 32  # of a sweep: fewer say nothing of the noise's spectrum
VARIANCE_ROUNDS = 20  # of variances and spectrum in turn; they settle in five


@dataclass(frozen=True, eq=False)
class Noise:
    """Of one reading.

    Attributes
    ----------
    variance
        ``(n,)`` Nm²; NaN for a motor that never stood.
    spectrum
        ``(H,)``: by how much the power at h periods per loop is above that of white noise of this variance.
    freedom
        ``(H,)``: degrees of freedom of each of them.
    """

    variance: Array
    spectrum: Array
    freedom: Array

    def seen_by(self, power: Array) -> tuple[Array, Array]:
        """Of templates of length 1, whose power at h periods per loop is ``(H, R)``: spectrum and its freedom ``(R,)``.

        Neighbours in the spectrum share values: their errors are added as if they were one.
        """
        parts = power * self.spectrum[:, None]
        total = parts.sum(axis=0)
        return total, (total / np.maximum(parts.T @ self.freedom**-0.5, 1e-300)) ** 2


def alike(one: SweepRows, other: SweepRows) -> bool:
    """Whether two sweeps drive the same joint over the same steps."""
    return (
        len(one.offset) == len(other.offset)
        and np.array_equal(one.turned, other.turned)
        and np.allclose(one.offset, other.offset, rtol=1e-9, atol=1e-12)
    )


@lru_cache(maxsize=8)
def line(count: int) -> Array:
    """A constant and a drift over so many rows, orthonormal, ``(count, 2)``."""
    place = np.arange(count) - (count - 1) / 2
    return np.column_stack([np.full(count, count**-0.5), place / np.linalg.norm(place)])


@lru_cache(maxsize=512)
def waves(count: int, periods: int) -> Array:
    """Cosine and sine about the middle of so many rows, of length 1, ``(count, 2)``."""
    angle = 2 * np.pi * periods * (np.arange(count) - (count - 1) / 2) / count
    return np.asarray(np.sqrt(2 / count) * np.column_stack([np.cos(angle), np.sin(angle)]))


def noise_of(sweeps: Sequence[SweepRows], harmonics: int) -> Noise | None:
    """Noise of the standing motors in these sweeps, which have equally many rows; None: they are no two equal loops."""
    count, n = sweeps[0].torque.shape
    half = count // 2
    if count < LEAST_ROWS or count % 2 or any(len(s.time) != count for s in sweeps):
        return None
    if any(not np.allclose(s.offset[:half], s.offset[half:], rtol=0.0, atol=1e-9) for s in sweeps):
        return None
    step = np.repeat([-1.0, 1.0], half) / np.sqrt(count)
    odd = range(1, half, 2)
    power = np.full((len(sweeps), len(odd), 2, n), np.nan)
    for k, sweep in enumerate(sweeps):
        still = np.flatnonzero(~sweep.turned)
        y = sweep.torque[:, still] - np.outer(step, step @ sweep.torque[:, still])
        for b, periods in enumerate(odd):
            wave = waves(count, periods)
            left = 1.0 - (step @ wave) ** 2  # without the step
            power[k, b][:, still] = (wave.T @ y) ** 2 / left[:, None]
    power[:, 0, 1] = np.nan
    stood = np.any(np.isfinite(power), axis=(0, 1, 2))
    if not stood.any():
        return None
    power = power[..., stood]
    shape = np.ones(len(odd))
    for _ in range(VARIANCE_ROUNDS):
        own = np.nanmean(power / shape[:, None, None], axis=(0, 1, 2))
        if not np.all(own > 0.0):
            return None  # a torque that never changes was not measured
        shape = np.nanmean(power / own, axis=(0, 2, 3))
    known = np.count_nonzero(np.isfinite(power), axis=(0, 2, 3))  # values behind each of the spectrum's
    pairs = [slice(h - 1, h + 1) for h in range(1, harmonics + 1)]
    spectrum = np.array([shape[pair].mean() for pair in pairs])
    error = [np.sum(shape[pair] ** 2 * 2.0 / known[pair]) / np.sum(shape[pair]) ** 2 for pair in pairs]
    variance = np.full(n, np.nan)
    variance[stood] = own
    return Noise(variance, spectrum, 2.0 / np.array(error))
