"""Errors of a fitted log on fitted and held-out rows: `clampid.fitting.accuracy` by passes over the log's windows."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from clampid.fitting.accuracy import FOLDS, QUIET_S, StageErrors
from clampid.fitting.fit_log import LogFit, LogNoise, LogPrior, residuals, summed
from clampid.fitting.moments import Moments, minimise
from clampid.stages.log_design import LogDesign
from clampid.stages.rows import Array, Bools, Integers, Rows

__all__ = ["cross_fitted", "log_errors", "parts_of"]

LEAST_TRIPLES = 20  # triples of rows from which noise is estimated
_NONE = np.zeros(0, dtype=np.int64)


@dataclass
class _Squares:
    """Sums of squares of the motors' residuals ``(n,)``, Nm², and their numbers ``(n,)``."""

    squares: Array
    count: Array
    rows: int = 0

    @staticmethod
    def none(n: int) -> _Squares:
        """Sums over no rows, for n motors."""
        return _Squares(np.zeros(n), np.zeros(n))

    def add(self, motor: int, values: Array) -> None:
        """Add residuals ``(k,)``, Nm, of one motor."""
        self.squares[motor] += float(values @ values)
        self.count[motor] += len(values)

    def rms(self, floor: Array) -> float:
        """Root mean square in units of the motors' noise ``floor`` ``(n,)``, Nm."""
        total = float(self.count.sum())
        return float(np.sqrt(np.sum(self.squares / floor**2) / total)) if total else float("nan")


@dataclass
class _Floor:
    """Sums of squared second differences of residuals, for the noise floor; see `accuracy.noise_floor`."""

    lag: int
    n: int
    squares: Array = field(init=False)
    count: Array = field(init=False)
    run: Integers = field(init=False)
    last: Array = field(init=False)

    def __post_init__(self) -> None:
        self.squares, self.count = np.zeros(self.n), np.zeros(self.n)
        self.run, self.last = np.zeros(0, dtype=np.int64), np.zeros((0, self.n))

    def add(self, run: Integers, residual: Array) -> None:
        """Add consecutive rows: runs ``(k,)``, residuals ``(k, n)``, Nm, NaN where a number does not count."""
        self.run, self.last = np.r_[self.run, run], np.vstack([self.last, residual])
        lag = self.lag
        if len(self.run) <= 2 * lag:
            return
        bent = self.last[lag:-lag] - 0.5 * (self.last[2 * lag :] + self.last[: -2 * lag])
        bent[self.run[2 * lag :] != self.run[: -2 * lag]] = np.nan
        self.count += np.isfinite(bent).sum(axis=0)
        self.squares += np.nansum(bent**2, axis=0)
        self.run, self.last = self.run[-2 * lag :], self.last[-2 * lag :]


def log_errors(
    design: LogDesign, fit: LogFit, prior: LogPrior, folds: Rows, kept: Bools, some_held_out: bool, seed: int
) -> StageErrors:
    """Errors on fitted and held-out rows (folds held out, else cross-validation), in units of the motors' noise.

    Parameters
    ----------
    design, fit, prior
        The log, its fit, and the prior of that.
    folds
        One row for each fold ``(F,)``.
    kept
        Which folds were fitted ``(F,)``.
    some_held_out
        Whether the other folds are held-out rows; else cross-validation is used.
    seed
        For the division into parts.
    """
    if some_held_out:
        white = summed(design, ~kept, _NONE, LogNoise(np.ones(design.n)))[0]
        theta = _with_offsets(design, white, fit.moments.at, prior, ~kept)[None]
        part = np.zeros(len(kept), dtype=np.int64)
    else:
        part = parts_of(folds, kept, seed)
        theta = cross_fitted(design, fit, prior, kept, part)
    floor = _Floor(max(1, round(QUIET_S / max(design.facts.spacing, 1e-9))), design.n)
    fitted, test = _Squares.none(design.n), _Squares.none(design.n)
    for found in residuals(design, np.ones_like(kept) if some_held_out else kept, fit.outliers, fit.moments.at):
        block = found[0].block
        table, tested = np.full((block.stop - block.first, design.n), np.nan), np.zeros(block.stop - block.first, bool)
        for r in found:
            own = np.arange(r.own, len(r.row))
            own, out = (own[kept[r.fold[own]]], own[~kept[r.fold[own]]]) if some_held_out else (own, own)
            table[r.row[own] - block.first, r.motor] = r.values[own]
            fitted.add(r.motor, r.values[own])
            test.add(r.motor, r.at(theta, part)[out])
            tested[r.row[out] - block.first] = True
        of_fit = kept[block.fold]
        floor.add(block.run[of_fit], table[of_fit])
        test.rows += int(tested.sum())
    noise = np.minimum(_noise_floor(floor, fitted), design.facts.known_noise)
    return StageErrors(fitted.rms(noise), test.rms(noise), noise_floor=1.0, heldout_rows=test.rows)


def _noise_floor(floor: _Floor, fitted: _Squares) -> Array:
    """The noise floor of the motors ``(n,)``, Nm."""
    bent, all_of_it = floor.squares / np.maximum(floor.count, 1) / 1.5, fitted.squares / np.maximum(fitted.count, 1)
    spread = np.sqrt(np.where(floor.count > LEAST_TRIPLES, bent, all_of_it))
    return np.asarray(np.maximum(np.where(fitted.count > 0, spread, 1.0), 1e-12))


def parts_of(folds: Rows, kept: Bools, seed: int) -> Integers:
    """Number (0 to 4) of the cross-validation part of each fold ``(F,)``; 0 for folds that are not fitted.

    ``folds``: one row for each fold; ``kept`` ``(F,)``: which are fitted.
    """
    inside = folds.take(np.flatnonzero(kept))
    order = inside.shuffled_folds(seed)
    place = np.argsort(order)
    out = np.zeros(len(kept), dtype=np.int64)
    out[kept] = (place % FOLDS)[np.searchsorted(np.sort(order), inside.fold)]
    return out


def cross_fitted(design: LogDesign, fit: LogFit, prior: LogPrior, kept: Bools, part: Integers) -> Array:
    """Parameters ``(parts, P + K)``, SI, of fits without each part, with offsets fitted to that part."""
    alike = fit.part is not None and np.array_equal(part[kept], fit.part[kept])
    sums = fit.sums if alike else summed(design, kept, fit.outliers, fit.noise, part)
    theta = []
    for k in range(int(part[kept].max()) + 1):
        chosen = kept & (part == k)
        out = sums[k]
        train = sum((m for p, m in sums.items() if p != k), Moments.none(design.at))
        if not train.count:
            train = train + out
        found = fit.moments.at
        at = minimise(train, found, prior.precision, prior.mean, prior.size, prior.free(found)).at
        theta.append(_with_offsets(design, out, at, prior, chosen))
    return np.array(theta)


def _with_offsets(design: LogDesign, moments: Moments, theta: Array, prior: LogPrior, folds: Bools) -> Array:
    """Parameters ``(P + K,)`` with offsets fitted to the held-out rows, as in `accuracy.predicted`."""
    count = len(design.chain.slots)
    full: Array = np.r_[theta[:count], np.zeros(len(theta) - count)]
    if not folds[design.offset_keys[:, 0]].any():
        return full
    size = prior.size
    precision = np.diag(np.r_[1e12 / size[:count] ** 2, 1e-2 / size[count:] ** 2])
    return np.asarray(minimise(moments, full, precision, full, size).at)
