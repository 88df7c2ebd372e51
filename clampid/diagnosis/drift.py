"""Test for correlated residuals of consecutive visits: then visits are not independent, and time is a suspect.

Residuals' means over each visit, in the order of time, are tested for correlation at ten lags, and the clearest is
judged by ten times its p-value (Bonferroni). If they are correlated, the null distribution flips blocks of
consecutive visits of that length, and effects of time cannot be distinguished from drift. Where readings are known to
wander, their noise contains that level already; blocks are then needed only if what is left without it is correlated.
A missing effect may be what makes visits alike. So what the best significant probe explains is left out, too.
The variance at each lag is that of Ljung, Box, On a measure of lack of fit in time series models, Biometrika 65, 1978.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from clampid.display import number
from clampid.evidence.score import Scored
from clampid.evidence.space import Space
from clampid.fitting.noise import Whitened
from clampid.fitting.solve import Estimate
from clampid.fitting.wander import Level, in_time
from clampid.stages.rows import Array, Integers, Rows

__all__ = ["Drift", "blocks_of_visits", "drift_beside", "drift_of"]

LAGS = 10
DRIFT_FALSE_ALARMS = 0.01  # chance of a warning where visits are independent
MIN_BLOCKS = 20  # blocks: of fewer, flips of signs say little


@dataclass(frozen=True)
class Drift:
    """Residuals of consecutive visits are correlated.

    Attributes
    ----------
    p
        Chance of such a correlation at any of the lags in independent visits.
    correlation, lag
        The clearest correlation, and between visits how far apart.
    block
        Visits after which it is mostly forgotten.
    clocked
        Whether ``time_s`` is a clock; it is none where it only counts rows.
    """

    p: float
    correlation: float
    block: int
    lag: int = 1
    clocked: bool = True

    @property
    def sentence(self) -> str:
        """For people."""
        apart = "consecutive visits" if self.lag == 1 else f"visits {self.lag} apart"
        found = (
            f"Residuals of {apart} are correlated ({self.correlation:.2f}, p = {number(self.p, 2)} over {LAGS} lags)"
        )
        if not self.clocked:
            return (
                f"{found} in the order of the rows; time_s only counts them and is no clock. If this is the order of "
                "measurement, robot or instrument have drifted; to be sure, record times and measure a second run in "
                "another order."
            )
        return (
            f"{found}: robot or instrument have drifted. Without a second run in another order, effects of time or "
            "temperature are not separable from it."
        )


def drift_of(estimate: Estimate, level: Level | None = None) -> Drift | None:
    """The drift in the residual of a pose fit, or None where none is significant.

    ``level``: by how much readings are known to wander; then the drift that is left without.
    """
    rows = estimate.problem.rows
    white = replace(estimate.noise, level=level).whiten(rows, estimate.residual, np.zeros((*rows.measured.shape, 0)))
    return _drift(rows, white, white.residual)


def drift_beside(estimate: Estimate, space: Space, s: Scored) -> Drift | None:
    """The drift that a candidate leaves in the residual of a pose fit, by the noise of its score.

    ``space``: the residual on which it was scored.
    """
    explained = s.directions(space.basis) @ s.amplitude
    return _drift(estimate.problem.rows, estimate.whitened, (space.residual - explained)[: space.rows])


def _drift(rows: Rows, white: Whitened, left: Array) -> Drift | None:
    """The drift in whitened numbers ``(M,)`` of a table, in the order of ``white``."""
    residual = np.zeros(rows.measured.shape)
    residual[white.entry, white.channel] = left
    parts = [_means(rows, residual, s) for s in np.unique(rows.session)]
    parts = [p for p in parts if len(p) > 4 * LAGS]
    if not parts:
        return None
    products, variance, count = np.zeros(LAGS), np.zeros(LAGS), 0
    lag = np.arange(1, LAGS + 1)
    for means in parts:
        n = len(means)
        total = np.sum(means**2, axis=0)
        varying = total > 0.0
        lagged = np.array([np.sum(means[k:] * means[:-k], axis=0) for k in range(1, LAGS + 1)])[:, varying]
        rho = lagged / total[varying]
        products += n * np.sum(rho, axis=1)
        variance += rho.shape[1] * n * (n - lag) / (n + 2)  # of independent visits rho has (n - k) / n (n + 2)
        count += n * int(varying.sum())
    if not count:
        return None
    correlation, z = products / count, products / np.sqrt(variance)
    best = int(np.argmax(z))
    p = min(1.0, LAGS * float(stats.norm.sf(z[best])))  # the clearest of so many lags: Bonferroni
    if p > DRIFT_FALSE_ALARMS:
        return None
    visits, first = sum(map(len, parts)), float(np.clip(correlation[0], 0.0, 0.99))
    lasts = max(int(np.ceil((1.0 + first) / (1.0 - first))), best + 1)
    clocked = not all(_counts(rows, s) for s in np.unique(rows.session))
    return Drift(p, float(correlation[best]), max(1, min(lasts, visits // MIN_BLOCKS)), best + 1, clocked)


def _counts(rows: Rows, session: int) -> bool:
    """Whether the times of a session's rows are their numbers."""
    time = np.sort(rows.constants.time[rows.session == session])
    return len(time) > 1 and bool(np.all(np.diff(time) == 1.0))


def blocks_of_visits(rows: Rows, length: int) -> Integers:
    """The block ``(N,)`` of each row: so many consecutive visits of a session. One visit: the rows' own units."""
    if length <= 1:
        return rows.unit
    out = np.zeros(len(rows), dtype=np.int64)
    for s in np.unique(rows.session):
        own = rows.session == s
        visit, order = in_time(rows, np.flatnonzero(own))
        out[own] = out.max(initial=-1) + 1 + order[visit] // length
    return out


def _means(rows: Rows, white: Array, session: int) -> Array:
    """Means ``(V, 3)`` over a session's visits in the order of time, of whitened residuals; visits that count."""
    own = (rows.session == session) & rows.used[:, :3].all(axis=1)
    if not own.any():
        return np.zeros((0, 3))
    visit, order = in_time(rows, np.flatnonzero(own))
    white = white[own, :3]
    count = np.bincount(visit)
    means = np.stack([np.bincount(visit, white[:, k]) / count for k in range(3)], axis=1)
    return means[np.argsort(order)]
