"""Whether residuals of consecutive visits are correlated: then visits are not independent, and time is suspect.

Residuals' means over each visit, in the order of time, are tested for correlation over a few visits. Where there is
some, the null flips blocks of consecutive visits as long as it lasts, and what depends on time, or on what goes with
it, cannot be told from drift. Source: Ljung, Box, On a measure of lack of fit in time series models, Biometrika 65,
1978.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from clampid.fitting.solve import Estimate
from clampid.stages.rows import Array, Integers, Rows

__all__ = ["Drift", "blocks_of_visits", "drift_of"]

LAGS = 10
RATE = 0.01  # chance of a warning where visits are independent
FEWEST = 20  # blocks: of fewer, flips of signs say little


@dataclass(frozen=True)
class Drift:
    """Residuals of consecutive visits are correlated.

    Attributes
    ----------
    p
        Chance of that in independent visits.
    correlation
        Of a visit with the next.
    block
        Visits after which it is mostly forgotten.
    """

    p: float
    correlation: float
    block: int

    @property
    def sentence(self) -> str:
        """For people."""
        return (
            f"Residuals of consecutive visits are correlated ({self.correlation:.2f}): robot or instrument have "
            "drifted. Without a second run in another order, effects of time or temperature are not separable from it."
        )


def drift_of(estimate: Estimate) -> Drift | None:
    """The drift in what a pose fit leaves, or None where none can be seen."""
    rows = estimate.experiment.rows
    parts = [_means(rows, estimate.residual, s) for s in np.unique(rows.session)]
    parts = [p for p in parts if len(p) > 4 * LAGS]
    if not parts:
        return None
    statistic, freedom, products, squares = 0.0, 0, 0.0, 0.0
    for means in parts:
        n = len(means)
        total = np.sum(means**2, axis=0)
        told = total > 0.0
        lagged = np.array([np.sum(means[k:] * means[:-k], axis=0) for k in range(1, LAGS + 1)])[:, told]
        rho = lagged / total[told]
        statistic += float(n * (n + 2) * np.sum(rho**2 / (n - np.arange(1, LAGS + 1))[:, None]))
        freedom += rho.size
        products += float(np.sum(lagged[0] / total[told]) * n)
        squares += float(n * told.sum())
    p = float(stats.chi2.sf(statistic, freedom))
    correlation = products / max(squares, 1.0)
    if p > RATE or correlation <= 0.0:
        return None
    visits = sum(map(len, parts))
    lasts = int(np.ceil((1.0 + correlation) / (1.0 - min(correlation, 0.99))))
    return Drift(p, correlation, max(1, min(lasts, visits // FEWEST)))


def blocks_of_visits(rows: Rows, length: int) -> Integers:
    """The block ``(N,)`` of each row: so many consecutive visits of a session. One visit: the rows' own units."""
    if length <= 1:
        return rows.unit
    out = np.zeros(len(rows), dtype=np.int64)
    for s in np.unique(rows.session):
        own = rows.session == s
        visit, order = _in_time(rows, own)
        out[own] = out.max(initial=-1) + 1 + order[visit] // length
    return out


def _in_time(rows: Rows, own: Array) -> tuple[Integers, Integers]:
    """Of each of a session's rows its visit, and of each visit its number in the order of time."""
    _, visit = np.unique(rows.unit[own], return_inverse=True)
    count = np.bincount(visit)
    time = np.bincount(visit, rows.constants["time"][own]) / count
    return visit, np.argsort(np.argsort(time, kind="stable"))


def _means(rows: Rows, residual: Array, session: int) -> Array:
    """Means ``(V, 3)`` over a session's visits in the order of time, in standard deviations; visits that count."""
    own = (rows.session == session) & rows.used[:, :3].all(axis=1)
    if not own.any():
        return np.zeros((0, 3))
    visit, order = _in_time(rows, own)
    white = (rows.in_noise_axes(residual)[:, :3] / rows.sigma[:, :3])[own]
    count = np.bincount(visit)
    means = np.stack([np.bincount(visit, white[:, k]) / count for k in range(3)], axis=1)
    return means[np.argsort(order)]
