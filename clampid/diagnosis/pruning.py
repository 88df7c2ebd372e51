"""Selection by BIC: places of a new effect, earlier effects beside it, other effects instead of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from clampid.fitting.noise import Noise
from clampid.fitting.solve import Estimate
from clampid.identification.fitted_stage import FittedStage
from clampid.slots import Slot, Term
from clampid.stages.fit_problem import parameter_of
from clampid.stages.rows import Array, Rows

__all__ = ["Refit", "bic_gap", "needless", "pays", "pruned"]

Refit = Callable[[Sequence[Term], FittedStage, Mapping[Slot, float]], FittedStage]


def pruned(
    trial: FittedStage, new: Sequence[Term], before: Sequence[Term], refit: Refit
) -> tuple[FittedStage, list[Term]]:
    """Drop the places of a new effect that do not pay for their parameters (Wald's statistic against BIC).

    That statistic assumes a linear model. A friction that selects flanks may have a large standard error and still be
    needed. So if the fit without all rejected places loses more than their BIC cost, they are dropped one by one, as
    long as the loss is below the cost.

    Places where the estimate lies beyond its bounds, such as a clearance below zero, are dropped first: an impossible
    value explains nothing. No place may be left.
    """
    new = list(new)
    while possible := [t for t in new if not _impossible(trial.estimate, t)]:
        if len(possible) == len(new):
            break
        trial, new = refit([*before, *possible], trial, {}), possible
    if not possible:
        return trial, []
    if len(new) < 2:
        return trial, new
    estimate = trial.estimate
    cost = _costs(estimate, new)
    lacks = {term: of_term - _wald(estimate, _of(estimate, term)) for term, of_term in cost.items()}
    gone = sorted((t for t in lacks if lacks[t] >= 0), key=lambda t: -lacks[t])
    if len(gone) == len(cost):
        return trial, list(new)
    found, kept = trial, [t for t in new if t in cost]
    if len(kept) < len(new):  # no row determines some of them
        found = refit([*before, *kept], trial, {})
    one_by_one = [[term] for term in gone] if len(gone) > 1 else []
    for dropped in (gone, *one_by_one):
        fewer = [t for t in kept if t not in dropped]
        if len(fewer) == len(kept):
            continue
        slim = refit([*before, *fewer], found, {})
        if _loss(slim.estimate, estimate) <= sum(cost[t] for t in cost if t not in fewer):
            found, kept = slim, fewer
    return found, kept


def needless(trial: FittedStage, terms: Sequence[Term], refit: Refit) -> FittedStage | None:
    """The fit without some terms of a model if BIC does not justify their parameters; else None.

    As for the places of a new effect, if Wald's statistic does not justify them, the fit without decides.
    """
    estimate = trial.estimate
    if pays(estimate, terms):
        return None
    cost = sum(_costs(estimate, terms).values())
    slim = refit([t for t in trial.model.terms if t not in terms], trial, {})
    return slim if _loss(slim.estimate, estimate) <= cost else None


def pays(estimate: Estimate, terms: Sequence[Term]) -> bool:
    """Whether BIC justifies the parameters of some terms of a fit, by Wald's statistic."""
    cost = sum(_costs(estimate, terms).values())
    return _wald(estimate, [k for term in terms for k in _of(estimate, term)]) >= cost


def bic_gap(fits: Sequence[tuple[Estimate, Sequence[Term]]], noise: Noise) -> Array:
    """BIC of each of some fits of the same rows, less that of the best ``(fits,)``: twice the log of the odds.

    The BIC is the sum of their squared residuals in units of one noise, the cost of the parameters of the terms in
    which they differ, and the squares of these parameters over their priors, where there are any.
    """
    found, rows = [], fits[0][0].problem.rows  # those that one of them counts, for all
    for estimate, terms in fits:
        index = [k for term in terms for k in _of(estimate, term)]
        prior = estimate.problem.prior_std()[index]
        assumed = prior <= estimate.problem.sizes()[index]
        off = np.where(assumed, estimate.theta[index] / prior, 0.0)
        found.append(_squares(estimate, rows, noise) + sum(_costs(estimate, terms).values()) + float(off @ off))
    return np.array(found) - min(found)


def _wald(estimate: Estimate, own: Sequence[int]) -> float:
    """Wald's statistic of some amplitudes against zero, in units of twice the log-likelihood."""
    effects, robot = estimate.problem.effects, estimate.problem.rows.robot
    index = [k for k in own if not parameter_of(estimate.slots[k], effects, robot).shape]
    theta, covariance = estimate.theta[index], estimate.covariance[np.ix_(index, index)]
    return float(theta @ np.linalg.pinv(covariance, hermitian=True) @ theta)


def _of(estimate: Estimate, term: Term) -> list[int]:
    return [k for k, s in enumerate(estimate.slots) if s.effect == term.effect and s.place == term.place]


def _impossible(estimate: Estimate, term: Term) -> bool:
    """Whether all amplitudes of a term that a fit has lie beyond their bounds."""
    index = [k for k in _of(estimate, term) if not estimate.problem.shapes()[k]]
    return bool(index) and bool(np.all(estimate.beyond_bounds()[index]))


def _costs(estimate: Estimate, terms: Sequence[Term]) -> dict[Term, float]:
    """BIC cost of the parameters of each term that a fit has, in units of twice the log-likelihood."""
    rows = max(len(estimate.whitened.residual), 2)
    assumed = estimate.problem.prior_std() <= estimate.problem.sizes()
    out = {}
    for term in terms:
        index = _of(estimate, term)
        if not index:
            continue
        out[term] = len(index) * float(np.log(rows))
        if assumed[index].all():  # what the rows narrowed the prior by
            prior, covariance = estimate.problem.prior_std()[index], estimate.covariance[np.ix_(index, index)]
            out[term] = -float(np.linalg.slogdet(covariance / np.outer(prior, prior))[1])
    return out


def _loss(fewer: Estimate, full: Estimate) -> float:
    """Increase of the squared residual of a fit with fewer parameters, in units of the full fit's noise."""
    return _squares(fewer, full.problem.rows, full.noise) - full.point.cost


def _squares(estimate: Estimate, rows: Rows, noise: Noise) -> float:
    """Squared residual of a fit over the rows that count in ``rows``, in units of that noise."""
    white = noise.whiten(rows, estimate.residual, np.zeros((*estimate.residual.shape, 0))).residual
    return float(white @ white)
