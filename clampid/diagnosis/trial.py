"""A candidate on trial: what it brings on rows that its fit has not seen, and which of its places pay."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from clampid.accuracy import Floor, cross_validated, predicted, rms_of, size_of
from clampid.diagnosis.confirm import held_out_p
from clampid.fit import Estimate
from clampid.fitted_stage import FittedStage
from clampid.noise import Noise
from clampid.slots import Slot, Term
from clampid.stages.experiment import experiment
from clampid.stages.rows import Array, Rows

__all__ = ["HeldOut", "Refit", "held_out", "pruned"]

Refit = Callable[[Sequence[Term], FittedStage, Mapping[Slot, float]], FittedStage]


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
    """

    rms: float
    rows: Rows
    residual: Array
    floor: Floor
    noise: Noise

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

    def p_above(self, other: HeldOut, noise: Noise, seed: int) -> float:
        """One-sided p of how far these errors lie above another model's on the same rows.

        Of logs, where noise lasts: half of the rate each for errors as they are, which only what acts slowly or
        everywhere lowers by more than that noise, and for whitened ones, which see what is brief. The noise is to be
        that of the larger model: what an effect leaves in a model without it looks like noise that lasts.
        """
        p = held_out_p(self.squares, other.squares, self.rows.unit, seed)
        if self.rows.stage == "poses":
            return p
        white = held_out_p(self.white_squares(noise), other.white_squares(noise), self.rows.unit, seed)
        return min(2.0 * min(p, white), 1.0)


def held_out(estimate: Estimate, verification: Rows | None, floor: Floor, seed: int) -> HeldOut:
    """Errors of an estimate on a verification table, or else by cross-validation in five parts of whole folds."""
    count = len(estimate.slots)
    if verification is not None:
        trial = experiment(verification, estimate.experiment.effects, estimate.slots)
        rows, residual = verification, predicted(trial, estimate.theta[:count])
    else:
        rows, residual = cross_validated(estimate, estimate.experiment.rows, seed)
    return HeldOut(rms_of(rows, residual, floor), rows, residual, floor, estimate.noise)


def pruned(
    trial: FittedStage, new: Sequence[Term], before: Sequence[Term], refit: Refit
) -> tuple[FittedStage, list[Term]]:
    """Drop the places of a new effect that do not pay for their parameters (Wald's statistic against BIC)."""
    if len(new) < 2:
        return trial, list(new)
    estimate = trial.estimate
    rows = max(len(estimate.whitened.residual), 2)
    assumed = estimate.experiment.prior_std() <= estimate.experiment.sizes()
    kept = []
    for term in new:
        index = [k for k, s in enumerate(estimate.slots) if s.effect == term.effect and s.place == term.place]
        if not index:
            continue
        theta, covariance = estimate.theta[index], estimate.covariance[np.ix_(index, index)]
        cost = len(index) * float(np.log(rows))
        if assumed[index].all():  # what the rows narrowed the prior by
            prior = estimate.experiment.prior_std()[index]
            cost = -float(np.linalg.slogdet(covariance / np.outer(prior, prior))[1])
        if float(theta @ np.linalg.pinv(covariance, hermitian=True) @ theta) > cost:
            kept.append(term)
    if not kept or len(kept) == len(new):
        return trial, list(new)
    return refit([*before, *kept], trial, {}), kept
