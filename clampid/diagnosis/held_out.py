"""Errors of held-out rows, and tests whether those of one model are larger than those of another."""

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
"""False-alarm rate: probability that the held-out error falls significantly by an effect that does not exist."""


@dataclass(frozen=True)
class HeldOut:
    """Errors of held-out rows.

    Attributes
    ----------
    rms
        In the stage's unit.
    rows, residual
        The rows ``(N,)`` and their residuals ``(N, m)``, SI.
    floor
        The noise floor.
    noise
        Of the estimate's own residuals.
    block
        Of poses: how many consecutive visits a test flips together.
    """

    rms: float
    rows: Rows
    residual: Array
    floor: Floor
    noise: Noise
    block: int = 1

    @property
    def squares(self) -> Array:
        """Squared errors ``(N,)``, m² or in units of the log's noise; zero for rows that do not count."""
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
        """One-sided p of these errors being larger than another model's on the same rows.

        Noise of logs is correlated in time. So half of the rate is for plain errors, which slow effects lower
        significantly, and half for whitened errors, which brief effects lower. The noise must be that of the larger
        model: in a model without an effect, that effect looks like correlated noise.
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
    """The p of a fall by the better of two tests: on a verification table, or by cross-validation."""
    return min(2.0 * min(verified, crossed), 1.0)
