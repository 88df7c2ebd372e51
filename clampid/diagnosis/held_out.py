"""Errors of rows that a fit has not seen, and whether one model's lie above another's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clampid.diagnosis.confirm import held_out_p
from clampid.diagnosis.drift import blocks_of_visits
from clampid.diagnosis.folds import Folds
from clampid.fitting.accuracy import Floor, cross_validated, predicted, rms_of, size_of
from clampid.fitting.fit import without_outlying
from clampid.fitting.noise import Noise
from clampid.fitting.solve import Estimate
from clampid.stages.rows import Array, Rows

__all__ = ["HELD_OUT_RATE", "HeldOut", "either_p", "held_out_of"]

HELD_OUT_RATE = 0.05
"""Chance of a fall of the held-out error that passes for one, of an effect that is not there."""


@dataclass(frozen=True)
class HeldOut:
    """Errors of rows that a fit has not seen.

    Attributes
    ----------
    rms
        In the stage's unit.
    rows, residual
        The rows ``(N,)`` and their residuals ``(N, m)``, SI.
    floor
        What noise alone leaves.
    noise
        Of the estimate's own residuals.
    block
        Of poses: how many consecutive visits are one to a test.
    """

    rms: float
    rows: Rows
    residual: Array
    floor: Floor
    noise: Noise
    block: int = 1

    @property
    def squares(self) -> Array:
        """Squared errors ``(N,)``, m² or SI over the log's noise, zero of what does not count."""
        size, counts = size_of(self.rows, self.residual, self.floor)
        squares = np.where(counts, size**2, 0.0)
        return np.asarray(squares if squares.ndim == 1 else squares.sum(axis=1))

    def white_squares(self, noise: Noise) -> Array:
        """Of a log: squared errors ``(N,)`` whitened by that noise, in units of it."""
        white = noise.whiten(self.rows, self.residual, np.zeros((*self.residual.shape, 0)))
        return np.asarray(np.bincount(white.entry, white.residual**2, minlength=len(self.rows)), dtype=float)

    def exceed(self, other: HeldOut) -> bool:
        """Whether these errors are larger than another model's, squares over the rows that count in both."""
        both = (self.rows.used & other.rows.used).any(axis=1)
        return bool(np.sum((self.squares - other.squares)[both]) > 0.0)

    def p_above(self, other: HeldOut, noise: Noise, seed: int) -> float:
        """One-sided p of how far these errors lie above another model's on the same rows.

        Of logs, where noise lasts: half of the rate each for errors as they are, which only what acts slowly or
        everywhere lowers by more than that noise, and for whitened ones, which see what is brief. The noise is to be
        that of the larger model: what an effect leaves in a model without it looks like noise that lasts.
        """
        both = (self.rows.used & other.rows.used).any(axis=1)  # single wrong rows are each fit's own finding
        p = held_out_p(both * self.squares, both * other.squares, blocks_of_visits(self.rows, self.block), seed)
        if self.rows.kind.points:
            return p
        white = held_out_p(self.white_squares(noise), other.white_squares(noise), self.rows.unit, seed)
        return min(2.0 * min(p, white), 1.0)


def held_out_of(
    estimate: Estimate,
    verification: Rows | None,
    floor: Floor,
    seed: int,
    block: int = 1,
    folds: Folds | None = None,
) -> HeldOut:
    """Errors of an estimate on a verification table, or else by cross-validation in five parts.

    The parts consist of whole folds of the rows, or are ``folds``.
    """
    count = len(estimate.slots)
    if verification is not None:
        residual = predicted(estimate.problem.with_rows(verification), estimate.theta[:count])
        rows = without_outlying(verification, residual, estimate.problem.rows, estimate.residual)
    elif folds is not None:
        rows, residual = cross_validated(estimate, folds.of(estimate.problem.rows), seed)
        rows = folds.judging(rows)
    else:
        rows, residual = cross_validated(estimate, estimate.problem.rows, seed)
    return HeldOut(rms_of(rows, residual, floor), rows, residual, floor, estimate.noise, block)


def either_p(verified: float, crossed: float) -> float:
    """The p of a fall that one of two tests shows: on a verification table, or on parts of the rows of the fit."""
    return min(2.0 * min(verified, crossed), 1.0)
