"""Median and scatter of readings, and whether the target was at rest.

Readings ``(N, k)`` are cut in halves. A target at rest gives two medians that differ by noise. The standard error of
the median of m normal readings is √(π/2)·σ/√m, so that the difference of the halves has √(2π/N)·σ. A difference beyond
``GATE`` of these is motion. σ is the scatter of all readings, 1.4826 times the median absolute deviation.

With three axes and white noise a resting target is called moving once in about 50 000 times (7e-6 for each axis; 2 in
120 000 when simulated). A steady motion by D in the time of the readings is found where D is well above the noise:
80 % at 3 σ and 99 % at 4 σ of 120 readings, all at 2 σ of 500. Differences below ``CALM_M`` count as rest, since noise
that is correlated from reading to reading moves the halves apart.

Source of the standard error: Kendall and Stuart, The Advanced Theory of Statistics, vol. 1, section 14.6.
"""

from __future__ import annotations

import numpy as np

from experiments.instruments.protocol import Array

__all__ = ["CALM_M", "MIN_READINGS", "moved_by", "summary"]

MAD = 1.4826  # of a normal distribution
GATE = 4.5  # standard errors
MIN_READINGS = 120  # a pure motion by D has a scatter of 0.37 D and halves that differ by D/2: 70 readings show it
CALM_M = 5e-6  # m


def summary(readings: Array) -> tuple[Array, Array]:
    """Median and scatter of one reading, ``(k,)`` each, of readings ``(N, k)``; the scatter of a single one is NaN."""
    median = np.median(readings, axis=0)
    if len(readings) < 2:
        return median, np.full(readings.shape[1], np.nan)
    return median, np.asarray(MAD * np.median(np.abs(readings - median), axis=0))


def moved_by(readings: Array) -> float:
    """How far the target moved between the two halves of readings ``(N, k)``, m; 0.0 if by no more than noise does.

    With fewer than `MIN_READINGS` readings a slow motion cannot be distinguished from noise.
    """
    half = len(readings) // 2
    if half < 1:
        return 0.0
    step = np.abs(np.median(readings[-half:], axis=0) - np.median(readings[:half], axis=0))
    _, scatter = summary(readings)
    clear = step > np.maximum(GATE * np.sqrt(2 * np.pi / len(readings)) * scatter, CALM_M)
    return float(np.linalg.norm(step)) if clear.any() else 0.0
