"""A candidate on trial: what it brings on rows that its fit has not seen, and which of its places pay."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from clampid.accuracy import Floor, cross_validated, predicted, rms_of, size_of
from clampid.fit import Estimate
from clampid.fitted_stage import FittedStage
from clampid.noise import Noise
from clampid.slots import Slot, Term
from clampid.stages.experiment import experiment
from clampid.stages.rows import Array, Integers, Rows

__all__ = ["HeldOut", "Refit", "held_out", "pruned"]

Refit = Callable[[Sequence[Term], FittedStage, Mapping[Slot, float]], FittedStage]


@dataclass(frozen=True)
class HeldOut:
    """Squared errors of held-out rows, with the units that share their noise.

    Attributes
    ----------
    rms
        In the stage's unit.
    squares
        ``(N,)``: of poses in m²; of logs prewhitened as the evidence is, since noise that lasts hides what falls.
    """

    rms: float
    squares: Array
    unit: Integers


def held_out(estimate: Estimate, verification: Rows | None, floor: Floor, noise: Noise, seed: int) -> HeldOut:
    """Errors of an estimate on a verification table, or else by cross-validation in five parts of whole folds.

    Parameters
    ----------
    noise
        The same for all estimates that are compared, of all rows of the stage.
    """
    count = len(estimate.slots)
    if verification is not None:
        trial = experiment(verification, estimate.experiment.effects, estimate.slots)
        rows, residual = verification, predicted(trial, estimate.theta[:count])
    else:
        rows, residual = cross_validated(estimate, estimate.experiment.rows, seed)
    if rows.stage == "poses":
        size, counts = size_of(rows, residual, floor)
        squares = np.where(counts, size**2, 0.0)
    else:
        white = noise.whiten(rows, residual, np.zeros((*residual.shape, 0)))
        squares = np.bincount(white.entry, white.residual**2, minlength=len(rows))
    return HeldOut(rms_of(rows, residual, floor), squares, rows.unit)


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
